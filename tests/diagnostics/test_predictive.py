"""Misfit of draws: one for exact ones, and a microscope that is not what was told is caught."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from posterior import models
from posterior.diagnostics import (
    misfit,
    normalised_residuals,
    predicted,
    predictive_ranks,
    reduced_chi_square,
    uniformity,
)
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


# ---- residuals about the mean prediction ---------------------------------------------------------


def exact_counts(exposure, count=8, side=128):
    """Counts of Gamma(4) pixels of mean 0.3, and exact draws of their light; electrons."""
    rng = np.random.default_rng(exposure)
    light = rng.gamma(4, 0.3 * exposure / 4, (side, side))
    counts = rng.poisson(light)
    return counts, rng.gamma(4 + counts, 1 / (4 / 0.3 / exposure + 1), (count, side, side))


def likelihood_of(counts, well):
    return models.LinearLikelihood(models.Identity(counts.shape), models.Poisson(well))


@pytest.mark.parametrize("exposure", [5, 100])
def test_residuals_about_the_mean_count_what_the_draws_have_followed(x64, exposure):
    """Of 5 photons a quarter of the noise, of 100 seven eighths; a tenth of noise is told."""
    counts, draws = exact_counts(exposure)
    well = 20 * int(counts.max())
    residual, left = counts - draws.mean(axis=0), draws.mean(axis=0) - draws.var(axis=0)
    bound = 4 * np.sqrt(np.sum((residual**2 - left) ** 2)) / left.sum()
    assert bound < 0.2

    def found(full_well):
        return reduced_chi_square(likelihood_of(counts, full_well), counts / well, draws / well)

    assert found(well) == pytest.approx(np.sum(residual**2) / left.sum(), rel=1e-9)
    assert abs(found(well) - 1) < bound
    assert found(round(1.1 * well)) > 1 + bound
    assert found(round(0.9 * well)) < 1 - bound
    mapped = normalised_residuals(likelihood_of(counts, well), counts / well, draws / well)
    np.testing.assert_allclose(mapped, residual / np.sqrt(draws.mean(axis=0)), rtol=1e-6, atol=1e-9)


def test_a_pixel_that_is_off_is_seen_in_the_map_and_a_saturated_one_is_left_out():
    counts, draws = exact_counts(5)
    counts[3, 4] += 40
    well = 4 * int(counts.max())
    draws[:, 7, 7] = well
    mapped = normalised_residuals(likelihood_of(counts, well), counts / well, draws / well)
    assert np.unravel_index(np.nanargmax(mapped), mapped.shape) == (3, 4)
    assert np.isnan(mapped[7, 7]) and np.isnan(mapped).sum() == 1


def test_residuals_of_a_complex_recording(x64):
    """Draws of a flat prior follow all of the noise: as much as their mean errs is left."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((5, 64, 64, 2)) @ (0.1, 0.1j)
    likelihood = models.LinearLikelihood(models.Identity((64, 64)), models.Gaussian(0.1))
    y, draws = noise[0], noise[0] + noise[1:]
    mapped = normalised_residuals(likelihood, y, draws)
    np.testing.assert_allclose(mapped, -noise[1:].mean(axis=0) / np.sqrt(0.02), rtol=1e-6)
    expected = np.mean(np.abs(noise[1:].mean(axis=0)) ** 2) / (0.02 - draws.var(axis=0).mean())
    assert reduced_chi_square(likelihood, y, draws) == pytest.approx(expected, rel=1e-9)


SMALL = models.LinearLikelihood(models.Identity((4,)), models.Gaussian(0.1))
DARK = models.LinearLikelihood(models.Identity((2,)), models.Poisson(4))
Y, OBJECTS = np.zeros(4), np.zeros((3, 4))


@pytest.mark.parametrize("statistic", [misfit, normalised_residuals, reduced_chi_square, "ranks"])
@pytest.mark.parametrize(
    "y, draws, message",
    [
        (np.full(4, np.nan), OBJECTS, "4 of 4 values of the recording are not finite: mask"),
        (Y, np.where(np.eye(3, 4) > 0, np.inf, 0), "3 of 12 values of the draws are not finite"),
        (Y[:1], OBJECTS, r"data of shape \(1,\): these optics record \(4,\)"),
        (Y + 0j, OBJECTS, "complex128 beside an expected signal of float32"),
        (Y, OBJECTS + 0j, "float64 beside an expected signal of complex64"),
        (Y, OBJECTS[0], r"draws of shape \(4,\) for objects of \(4,\)"),
        (Y, OBJECTS[:, :3], "for objects of"),
        (Y, OBJECTS[:0], "or more"),
    ],
)
def test_what_does_not_fit_is_refused(statistic, y, draws, message):
    with pytest.raises(ValueError, match=message):
        if statistic == "ranks":
            predictive_ranks(SMALL, y, draws, jax.random.key(0))
        else:
            statistic(SMALL, y, draws)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: predicted(SMALL, OBJECTS + np.nan, jax.random.key(0)), "12 of 12 values"),
        (lambda: predicted(SMALL, OBJECTS[0], jax.random.key(0)), "for objects of"),
        (
            lambda: predictive_ranks(SMALL, Y + 0j, OBJECTS + 0j, jax.random.key(0)),
            "complex recordings",
        ),
        (lambda: reduced_chi_square(SMALL, Y, OBJECTS[:1]), "2 or more"),
        (lambda: reduced_chi_square(SMALL, Y, np.eye(3, 4)), "no degree of freedom is left"),
    ],
)
def test_other_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_nothing_is_said_of_residuals_where_all_is_saturated():
    light = np.full((2, 2), 50.0)
    assert np.isnan(normalised_residuals(DARK, np.ones(2), light)).all()
    assert np.isnan(reduced_chi_square(DARK, np.ones(2), light))
    assert np.isnan(normalised_residuals(DARK, np.zeros(2), 0 * light)).all(), "no noise at all"


# ---- a second exposure ---------------------------------------------------------------------------

KNOWN = gamma_poisson(size=400)
MANY = gamma_poisson(size=10_000)


def exposures(noise_as_believed=True, known=KNOWN, count=49):
    """Ranks of first and second exposure of pixels, which are independent of each other."""
    keys = jax.random.split(jax.random.key(2), 5)
    x = known.prior.sample(keys[0])
    first = known.likelihood.simulate(keys[1], x)
    # Three electrons of read noise beside seven photons.
    camera = known.likelihood.camera if noise_as_believed else models.PoissonGaussian(50, 3.0)
    second = models.LinearLikelihood(known.likelihood.optics, camera).simulate(keys[2], x)
    draws = known.exact(keys[3], first, count)
    return [predictive_ranks(known.likelihood, y, draws, keys[4]) for y in (first, second)]


def test_a_second_exposure_is_one_more_prediction():
    first, second = exposures()
    assert uniformity(second) > 0.001
    # What the draws have seen lies in the middle of what they predict.
    assert uniformity(first) < 1e-6 and first.std() < second.std()


def test_noise_that_is_not_as_believed_is_caught_by_a_second_exposure():
    assert uniformity(exposures(noise_as_believed=False)[1]) < 1e-4


@pytest.mark.slow
def test_one_pixel_a_recording_gives_as_many_false_alarms_as_stated():
    """400 repetitions of 25 recordings; the pixels of MANY stand for recordings of one pixel."""
    ranks = exposures(known=MANY, count=19)[1].reshape(400, 25)
    alarms = sum(uniformity(u) < 0.05 for u in ranks)
    low, high = scipy.stats.binom(400, 0.05).interval(0.99)
    print(f"{alarms} of 400 alarms at 5 %, {low:g} to {high:g} are allowed")
    assert low <= alarms <= high


@pytest.mark.slow
@pytest.mark.parametrize("size", [100, 200])
def test_read_noise_that_is_not_believed_is_caught_in_most_repetitions(size):
    """Of so many recordings of one pixel, three electrons beside seven photons."""
    ranks = exposures(noise_as_believed=False, known=MANY, count=19)[1].reshape(-1, size)
    caught = np.mean([uniformity(u) < 0.05 for u in ranks])
    print(f"caught in {caught:.0%} of {len(ranks)} repetitions of {size} recordings")
    assert caught >= (0.95 if size == 200 else 0.7)


def test_predictions_are_recordings_of_the_draws():
    draws = np.array([np.full(400, 0.1), np.full(400, 0.4)])
    found = predicted(KNOWN.likelihood, draws, jax.random.key(0))
    assert found.shape == (2, 400)
    np.testing.assert_allclose(found * 50, np.round(found * 50), atol=1e-4)
    error = np.sqrt(draws[:, 0] / 50 / 400)
    assert np.all(np.abs(found.mean(axis=1) - draws[:, 0]) < 4 * error)
