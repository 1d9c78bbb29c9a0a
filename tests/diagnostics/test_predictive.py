"""Misfit of draws: one for exact ones, and a microscope that is not what was told is caught."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior import models
from posterior.diagnostics import misfit, predicted, predictive_ranks, uniformity
from posterior.models.gallery import gamma_poisson

SIDE, DRAWS, RECORDINGS = 256, 2, 50


def ratio_error(light):
    """Sd of the misfit at the truth: (n - l)^2 of Poisson counts has the variance 2 l^2 + l."""
    return np.sqrt(np.sum(2 * light**2 + light)) / np.sum(light)


def gamma_pixels(exposure, key):
    """Counts of pixels that are Gamma(4) of mean 0.3, and exact draws of their light, electrons."""
    keys = jax.random.split(key, 3)
    light = exposure * 0.3 * jax.random.gamma(keys[0], 4.0, (SIDE, SIDE)) / 4
    counts = jax.random.poisson(keys[1], light)
    posterior = jax.random.gamma(keys[2], 4 + counts, (DRAWS, SIDE, SIDE))
    return np.asarray(light), np.asarray(counts), np.asarray(posterior) / (4 / 0.3 / exposure + 1)


@pytest.mark.parametrize("exposure", [5, 100])
def test_exact_draws_have_none_and_ten_per_cent_are_caught(x64, exposure):
    """Of noise: a camera of a tenth more electrons, which the same recording is far from."""
    light, counts, draws = gamma_pixels(exposure, jax.random.key(0))
    bound = 4 * ratio_error(light)
    assert bound < 0.05

    def found(full_well):
        camera = models.Poisson(full_well)
        likelihood = models.LinearLikelihood(models.Identity((SIDE, SIDE)), camera)
        return misfit(likelihood, counts / well, draws / well)

    well = 20 * counts.max()
    assert abs(found(well) - 1) < bound
    assert found(round(1.1 * well)) > 1 + bound
    assert found(round(0.9 * well)) < 1 - bound


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
    """Of a flat prior a draw is the data plus noise, and has a residual of the noise."""
    optics = models.Fourier((SIDE, SIDE))
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((DRAWS + 1, 2, SIDE, SIDE)) * 0.1
    y = jnp.asarray(noise[0, 0] + 1j * noise[0, 1])
    draws = np.stack([optics.adjoint(y + n[0] + 1j * n[1]) for n in noise[1:]])
    bound = 4 * np.sqrt(2 / (2 * DRAWS * SIDE**2))
    right, wrong = (
        misfit(models.LinearLikelihood(optics, models.Gaussian(sigma)), y, draws)
        for sigma in (0.1, 0.11)
    )
    assert abs(right - 1) < bound and wrong < 1 - bound


@pytest.mark.parametrize("camera", [models.Poisson(10_000, 8), models.Poisson(100)], ids=str)
def test_dark_and_saturated_pixels_do_not_count(x64, camera):
    """At the truth, from far below an ADC step to far above the full well: still 1."""
    truth = jnp.geomspace(1e-6, 2.0, SIDE**2).reshape(SIDE, SIDE)
    likelihood = models.LinearLikelihood(models.Identity((SIDE, SIDE)), camera)
    keys = jax.random.split(jax.random.key(0), RECORDINGS)
    found = [misfit(likelihood, likelihood.simulate(key, truth), truth[None]) for key in keys]
    counted = truth[truth + 4 * camera.sigma0 * jnp.sqrt(truth) < 1] * camera.full_well
    bound = 4 * ratio_error(counted) / np.sqrt(RECORDINGS)
    assert bound < 0.05
    assert abs(np.mean(found) - 1) < bound


def test_nothing_is_said_where_all_is_saturated():
    likelihood = models.LinearLikelihood(models.Identity((2,)), models.Poisson(4))
    assert np.isnan(misfit(likelihood, np.ones(2), np.full((1, 2), 50.0)))


# ---- a second exposure ---------------------------------------------------------------------------

KNOWN = gamma_poisson(size=400)


def exposures(noise_as_believed=True):
    """Ranks of first and second exposure of 400 pixels, independent of each other, 49 draws."""
    keys = jax.random.split(jax.random.key(2), 5)
    x = KNOWN.prior.sample(keys[0])
    first = KNOWN.likelihood.simulate(keys[1], x)
    # Three electrons of read noise beside seven photons.
    camera = KNOWN.likelihood.camera if noise_as_believed else models.PoissonGaussian(50, 3.0)
    second = models.LinearLikelihood(KNOWN.likelihood.optics, camera).simulate(keys[2], x)
    draws = KNOWN.exact(keys[3], first, 49)
    return [predictive_ranks(KNOWN.likelihood, y, draws, keys[4]) for y in (first, second)]


def test_a_second_exposure_is_one_more_prediction():
    first, second = exposures()
    assert uniformity(second) > 0.001
    # What the draws have seen lies in the middle of what they predict.
    assert uniformity(first) < 1e-6 and first.std() < second.std()


def test_noise_that_is_not_as_believed_is_caught_by_a_second_exposure():
    assert uniformity(exposures(noise_as_believed=False)[1]) < 1e-4


def test_predictions_are_recordings_of_the_draws():
    draws = np.array([np.full(400, 0.1), np.full(400, 0.4)])
    found = predicted(KNOWN.likelihood, draws, jax.random.key(0))
    assert found.shape == (2, 400)
    np.testing.assert_allclose(found * 50, np.round(found * 50), atol=1e-4)
    error = np.sqrt(draws[:, 0] / 50 / 400)
    assert np.all(np.abs(found.mean(axis=1) - draws[:, 0]) < 4 * error)
