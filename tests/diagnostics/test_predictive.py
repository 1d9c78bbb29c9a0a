"""Misfit of draws: one for exact ones, and a microscope that is not what was told is caught."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior import models
from posterior.diagnostics import misfit

SIDE, DRAWS = 64, 4


def gamma_posterior(full_well, y, key, shape=4.0, mean=0.3):
    """Exact draws of the pixels of `y`, each Gamma(shape) before and shape + counts after."""
    counts = y * full_well
    unit = jax.random.gamma(key, shape + counts, (DRAWS, *y.shape))
    return np.asarray(unit / (shape / mean + full_well))


@pytest.mark.parametrize("full_well", [5, 100])
def test_exact_draws_have_none_and_half_the_light_is_caught(x64, full_well):
    """Without a full well in reach: residuals of n pixels leave a relative error of (2/n)^(1/2),
    and more where an electron is many standard deviations."""
    keys = jax.random.split(jax.random.key(0), 3)
    truth = 0.3 * jax.random.gamma(keys[0], 4.0, (SIDE, SIDE)) / 4.0
    counts = jax.random.poisson(keys[1], full_well * truth).astype(float)
    well = int(counts.max()) + 1
    y = np.asarray(counts) / well
    likelihood = models.LinearLikelihood(models.Identity((SIDE, SIDE)), models.Poisson(well))
    draws = gamma_posterior(full_well, np.asarray(counts) / full_well, keys[2])
    draws = draws * full_well / well
    kurtosis = float(np.mean((counts - full_well * truth) ** 4)) / float(np.mean(full_well * truth))
    bound = 4 * np.sqrt(kurtosis / np.mean(full_well * truth)) / SIDE
    assert abs(misfit(likelihood, y, draws) - 1) < bound
    assert misfit(likelihood, y, 0.5 * draws) > 1 + bound


def test_wrong_optics_are_caught():
    """Draws of a blurred picture that say nothing of the blur: its data are far from them."""
    shape = (32, 32)
    key_object, key_data = jax.random.split(jax.random.key(1))
    truth = jax.random.uniform(key_object, shape)
    camera = models.Poisson(1000)
    y = models.LinearLikelihood(models.Blur(shape, np.ones((3, 3)) / 9), camera).simulate(
        key_data, truth
    )
    sharp = models.LinearLikelihood(models.Identity(shape), camera)
    assert misfit(sharp, np.asarray(y), truth[None]) > 10


def test_a_complex_gaussian_recording(x64):
    """Of flat priors a draw is the data plus noise, and has a residual of the noise."""
    likelihood = models.LinearLikelihood(models.Fourier((SIDE, SIDE)), models.Gaussian(0.1))
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((DRAWS + 1, 2, SIDE, SIDE)) * 0.1
    y = jnp.asarray(noise[0, 0] + 1j * noise[0, 1])
    draws = [likelihood.optics.adjoint(y + n[0] + 1j * n[1]) for n in noise[1:]]
    assert abs(misfit(likelihood, y, np.stack(draws)) - 1) < 4 / SIDE


@pytest.mark.parametrize("camera", [models.Poisson(10_000, 8), models.Poisson(100)], ids=str)
def test_dark_and_saturated_pixels_do_not_count(x64, camera):
    """At the truth, from far below an ADC step to far above the full well: still 1."""
    truth = jnp.geomspace(1e-6, 2.0, SIDE**2).reshape(SIDE, SIDE)
    likelihood = models.LinearLikelihood(models.Identity((SIDE, SIDE)), camera)
    y = likelihood.simulate(jax.random.key(0), truth)
    # The brightest hundred or so carry the sums.
    assert abs(misfit(likelihood, y, truth[None]) - 1) < 4 * np.sqrt(2 / 100)


def test_nothing_is_said_where_all_is_saturated():
    likelihood = models.LinearLikelihood(models.Identity((2,)), models.Poisson(4))
    assert np.isnan(misfit(likelihood, np.ones(2), np.full((1, 2), 50.0)))
