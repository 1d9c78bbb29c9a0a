"""Errors of a picture's mean that all its noises share, on denoisers whose errors are known."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior.diagnostics.shared_errors import shared_errors
from posterior.models import ScorePrior
from posterior.models.thinning import thickened

SIDE, COUNT = 8, 64
PATCHES = np.random.default_rng(0).gamma(2, 0.2, (COUNT, SIDE, SIDE, 1)).astype("float32")
SIGMAS = (0.05, 0.2)


def denoiser(perturbation, denoise, channels=1):
    shape = (SIDE, SIDE) if channels == 1 else (SIDE, SIDE, channels)
    return SimpleNamespace(
        perturbation=perturbation, complex_valued=False, shape=shape, denoise=denoise
    )


@pytest.mark.parametrize("perturbation", ["gaussian", "poisson"])
def test_noise_itself_shares_nothing(perturbation):
    """24 noises of 64 pictures at eight levels, each within 3.5 of its sd of 0.007; with 16 black
    pictures among them as well.
    """
    levels = np.geomspace(0.02, 0.4, 8)
    itself = denoiser(perturbation, lambda z, sigma: z)
    found = shared_errors(itself, PATCHES, levels)
    assert all(abs(f) < 3.5 * np.sqrt(2 / COUNT) / 24 for f in found.values())
    assert 0.3 < np.std(list(found.values())) / (np.sqrt(2 / COUNT) / 24) < 2
    dark = np.concatenate([PATCHES, np.zeros_like(PATCHES[:16])])
    (found,) = shared_errors(itself, dark, levels[:1]).values()
    assert abs(found) < 3.5 * np.sqrt(2 / COUNT) / 24


# Of a bias of 3 sd, which meets the noise: 3.5 of them are 6 %.
NINE = 3.5 * (2 * 3 / np.sqrt(24 * COUNT) + np.sqrt(2 / COUNT) / 24)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("perturbation", ["gaussian", "poisson"])
def test_a_bias_is_its_square_over_the_noise(perturbation, channels):
    """Of three sd of the noise of a picture's mean, nine; colours are one picture."""

    def biased(z, sigma):
        variance = sigma**2 * (z.mean() if perturbation == "poisson" else 1.0)
        return z + 3 * jnp.sqrt(variance / z.size)

    patches = np.repeat(PATCHES, channels, axis=-1)
    for found in shared_errors(denoiser(perturbation, biased, channels), patches, SIGMAS).values():
        assert abs(found - 9) < NINE


def test_a_bias_of_each_picture_is_found_where_they_cancel():
    """Half of the pictures too bright, half too dark: no mean of all is off."""
    middle = np.median(PATCHES.mean((1, 2, 3)))

    def uneven(z, sigma):
        return z + jnp.where(z.mean() > middle, 3, -3) * sigma / SIDE

    (found,) = shared_errors(denoiser("gaussian", uneven), PATCHES, (0.01,)).values()
    assert abs(found - 9) < NINE


def test_where_means_are_not_known_it_refuses():
    prior = ScorePrior.load("nuclei", (64, 64), "signal")
    with pytest.raises(ValueError, match="no network knows"):
        shared_errors(prior, PATCHES, SIGMAS)
    prior = ScorePrior.load("complex-cells", (64, 64))
    with pytest.raises(ValueError, match="complex objects"):
        shared_errors(prior, PATCHES, SIGMAS)


def test_what_cannot_be_asked_is_refused():
    itself = denoiser("poisson", lambda z, sigma: z)
    with pytest.raises(ValueError, match=r"shape \(64, 8, 8\): give \(n, 8, 8, 1\)"):
        shared_errors(itself, PATCHES[..., 0], SIGMAS)
    with pytest.raises(ValueError, match="light that is counted is 0 or more"):
        shared_errors(itself, -PATCHES, SIGMAS)
    with pytest.raises(ValueError, match="not finite"):
        shared_errors(itself, np.where(PATCHES > 1, np.nan, PATCHES), SIGMAS)
    with pytest.raises(ValueError, match="noises 1: give 2"):
        shared_errors(itself, PATCHES, SIGMAS, noises=1)
    assert shared_errors(itself, np.zeros_like(PATCHES), (0.1,)) == {"0.1": 0.0}


def test_the_same_seed_finds_the_same():
    prior = denoiser("gaussian", lambda z, sigma: 0.9 * z)
    first, again, other = (shared_errors(prior, PATCHES, SIGMAS, seed) for seed in (0, 0, 1))
    assert first == again != other
    assert first.keys() == {"0.05", "0.2"}


def test_thickening_adds_up_a_bias_at_every_level_as_stated():
    """Pictures of one pixel, with a bias of a share f of the noise's variance: draws end 2 f^(1/2)
    of their sd off, but for what is left of it at the last level, here a fiftieth of the first.
    """
    share, pixels, first, last = 0.09, 5000, 0.02, 0.0004
    light = jnp.ones(pixels)

    def biased(z, sigma):
        return z + sigma * jnp.sqrt(share * z)

    keys = jax.random.split(jax.random.key(0))
    counts = jax.random.poisson(keys[0], light / first**2).astype("float32")
    sigmas = jnp.geomspace(first, last, 400).astype("float32")
    draws = thickened(keys[1], biased, counts, sigmas)
    off = np.asarray((draws - counts * first**2) / first)
    expected = np.sqrt(share) * (2 - last / first)
    assert abs(off.std() - 1) < 0.03
    assert abs(off.mean() - expected) < 3.5 / np.sqrt(pixels)
