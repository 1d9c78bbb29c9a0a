"""What thickening foretells of a longer exposure, under gamma priors of known E[x | counts]."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from posterior.diagnostics import (
    coverage,
    longer_exposure,
    randomised_ranks,
    spread_over_error,
    uniformity,
)
from posterior.diagnostics.regions import block_means, bright_areas, image_means
from posterior.models import ScorePrior

SIDE, SHAPE, SCALE = 8, 2.0, 0.1


def pictures(count, seed=0):
    gamma = np.random.default_rng(seed).gamma(SHAPE, SCALE, (count, SIDE, SIDE, 1))
    return gamma.astype("float32")


class Gamma(eqx.Module):
    """Independent gamma pixels; `wrong` moves the denoised picture at the level sigma."""

    wrong: Callable | None = eqx.field(static=True, default=None)
    shape: tuple[int, ...] = eqx.field(static=True, default=(SIDE, SIDE))
    perturbation: str = eqx.field(static=True, default="poisson")

    def denoise(self, z, sigma):
        exact = (SHAPE * sigma**2 + z) / (sigma**2 / SCALE + 1)
        return exact if self.wrong is None else self.wrong(exact, sigma)


def ranks(found, summary, seed=0):
    rng = np.random.default_rng(seed)
    return randomised_ranks(summary(found.truth), summary(found.draws), rng)


SUMMARIES = {
    "image mean": image_means,
    "bright area": lambda images: bright_areas(images, 0.2),
    "a pixel": lambda images: images[..., 3, 5],
}


def test_exact_denoising_foretells_it_at_the_nominal_rate():
    """Of 60 tests at 10 %, each of 40 pictures, 6 fail, within 3.5 sd, 2.3; there are some."""
    failed = dict.fromkeys(SUMMARIES, 0)
    for seed in range(60):
        found = longer_exposure(Gamma(), pictures(40, seed), 0.2, 0.1, seed, draws=19)
        for name, summary in SUMMARIES.items():
            failed[name] += uniformity(ranks(found, summary, seed)) < 0.1
    assert all(0 < count < 6 + 3.5 * np.sqrt(60 * 0.1 * 0.9) for count in failed.values()), failed


@pytest.mark.parametrize("before, after", [(0.2, 0.1), (0.05, 0.025)])
def test_exact_denoising_is_as_far_off_as_its_draws_spread(before, after):
    """Of 200 pictures, of 64 pixels each: pixels to 3 %, their coverage to 2 %."""
    found = longer_exposure(Gamma(), pictures(200), before, after, draws=19)
    assert abs(spread_over_error(found.draws, found.truth) - 1) < 0.03
    assert abs(coverage(found.draws, found.truth, 0.9, np.random.default_rng(0)).share - 0.9) < 0.02
    blocks = spread_over_error(block_means(found.draws), block_means(found.truth))
    assert abs(blocks - 1) < 3.5 / np.sqrt(2 * 200)


@pytest.mark.parametrize("steps, excess", [(8, 0.01), (4, 0.04)])
def test_few_steps_make_the_variance_too_large_as_stated(steps, excess):
    """Within 3.5 sd, 1.4 %, of the variance of 128,000 independent pixels."""
    found = longer_exposure(Gamma(), pictures(2000), 0.1, 0.05, steps=steps)
    ratio = spread_over_error(found.draws, found.truth) ** 2
    assert abs(ratio - 1 - excess) < 3.5 * np.sqrt(2 / (2000 * SIDE**2))


def test_what_all_pixels_share_is_found_in_their_mean_and_not_in_pixels():
    """At every level a bias of a whole sd of what the data leave of the picture's mean."""

    def shared(exact, sigma):
        return exact + sigma * np.sqrt(SHAPE * SCALE) / SIDE

    found = longer_exposure(Gamma(shared), pictures(100), 0.1, 0.05)
    assert uniformity(ranks(found, SUMMARIES["image mean"])) < 1e-4
    assert abs(spread_over_error(found.draws, found.truth) - 1) < 0.03


def test_rims_that_are_too_bright_or_too_dark_are_found_in_the_area_and_not_in_means():
    """Of pixels near 0.2, by a hundredth, in half of the pictures up; the rest down by as much."""

    def rims(exact, sigma):
        near = jnp.exp(-jnp.square((exact - 0.2) / 0.02) / 2)
        up = jnp.where(exact[:1, :1] > SHAPE * SCALE, 1, -1)
        return exact + 0.01 * up * (near - near.mean())

    found = longer_exposure(Gamma(rims), pictures(200), 0.05, 0.025)
    area, mean = SUMMARIES["bright area"], SUMMARIES["image mean"]
    assert spread_over_error(area(found.draws), area(found.truth)) < 0.9
    assert uniformity(ranks(found, area)) < 1e-3 < 0.05 < uniformity(ranks(found, mean))
    assert abs(spread_over_error(found.draws, found.truth) - 1) < 0.03


def test_what_cannot_be_asked_is_refused():
    gaussian = ScorePrior.load("nuclei", (64, 64))
    with pytest.raises(ValueError, match="gaussian perturbation: .* one of counts"):
        longer_exposure(gaussian, np.ones((2, 64, 64, 1)), 0.2, 0.1)
    for levels in ((0.1, 0.2), (0.1, 0.1), (0.1, 0.0), (np.nan, 0.1)):
        with pytest.raises(ValueError, match="give a level and a smaller one"):
            longer_exposure(Gamma(), pictures(2), *levels)
    with pytest.raises(ValueError, match="draws 1, steps 8: give 2 draws"):
        longer_exposure(Gamma(), pictures(2), 0.2, 0.1, draws=1)
    with pytest.raises(ValueError, match=r"give \(n, 8, 8, 1\)"):
        longer_exposure(Gamma(), pictures(2)[..., 0], 0.2, 0.1)
    with pytest.raises(ValueError, match="light that is counted is 0 or more"):
        longer_exposure(Gamma(), -pictures(2), 0.2, 0.1)
    with pytest.raises(ValueError, match="not finite"):
        longer_exposure(Gamma(), np.full((2, SIDE, SIDE, 1), np.nan), 0.2, 0.1)


def test_the_same_seed_finds_the_same_in_colour():
    colour = np.repeat(pictures(2), 3, axis=-1)
    asked = Gamma(shape=(SIDE, SIDE, 3))
    first, again, other = (longer_exposure(asked, colour, 0.2, 0.1, s, draws=3) for s in (0, 0, 1))
    assert first.draws.shape == (2, 3, SIDE, SIDE, 3) and first.truth.shape == (2, SIDE, SIDE, 3)
    np.testing.assert_array_equal(first.draws, again.draws)
    assert np.any(first.truth != other.truth)
