"""Frechet distances of pictures: closed forms, the null, and faults that are caught."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import binom, kstest

from posterior import models
from posterior.diagnostics import (
    bottleneck_features,
    frechet_distance,
    frechet_from_truths,
    frechet_of_halves,
    haar_bands,
)
from posterior.diagnostics.fidelity import frechet_of_moments

SIDE = 32


def fields(rng, count, power):
    """Stationary Gaussian fields (count, SIDE, SIDE) of a power spectrum."""
    white = rng.standard_normal((count, SIDE, SIDE))
    return np.fft.ifft2(np.sqrt(power) * np.fft.fft2(white)).real


def wiener(rng, count, draws):
    """Truths of a field under white noise of sd 0.3, and draws of their exact posteriors."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE), np.fft.fftfreq(SIDE)))
    power, noise = 0.05 / (0.05 + frequency) ** 2, 0.3
    truths = fields(rng, count, power)
    y = truths + noise * rng.standard_normal(truths.shape)
    gain = power / (power + noise**2)
    means = np.fft.ifft2(gain * np.fft.fft2(y)).real
    rest = fields(rng, count * draws, gain * noise**2).reshape(count, draws, SIDE, SIDE)
    return truths, means[:, None] + rest, means


def test_of_moments_is_the_closed_form_of_gaussians():
    """Commuting covariances: the sum of squared differences of means and of sds."""
    rng = np.random.default_rng(0)
    axes = np.linalg.qr(rng.standard_normal((5, 5)))[0]
    sds, others = rng.uniform(0.1, 2, (2, 5))
    means = rng.standard_normal((2, 5))
    covariances = [axes * s**2 @ axes.T for s in (sds, others)]
    exact = np.sum((means[0] - means[1]) ** 2) + np.sum((sds - others) ** 2)
    found = frechet_of_moments(means[0], covariances[0], means[1], covariances[1])
    np.testing.assert_allclose(found, exact, rtol=1e-9)


def test_the_distance_is_that_of_all_samples_in_units_of_the_truths():
    rng = np.random.default_rng(1)
    truths, draws = rng.uniform(size=(4, 16, 24)), rng.normal(0.4, 0.5, (4, 3, 16, 24))
    a, b = (haar_bands(x).reshape(-1, 10) for x in (truths, draws.reshape(-1, 16, 24)))
    sd = a.std(axis=0, ddof=1)
    found = frechet_from_truths(truths, draws, rng).value
    np.testing.assert_allclose(found, frechet_distance(a / sd, b / sd), rtol=1e-6)


def test_haar_bands_keep_the_energy_and_tell_directions():
    """A patch has 48, 12 and 3 details and its mean; stripes are in the band of their direction."""
    rng = np.random.default_rng(2)
    x = rng.uniform(size=(2, 8, 16))
    found = haar_bands(x)
    assert found.shape == (2, 2, 10)
    coefficients = np.repeat([16, 4, 1], 3)
    energy = found[..., :9] ** 2 @ coefficients + 64 * found[..., 9] ** 2
    np.testing.assert_allclose(energy, (x.reshape(2, 8, 2, 8) ** 2).sum((1, 3)), rtol=1e-9)
    stripes = np.tile([1.0, 0.0], (8, 4))[None]
    across_columns, across_rows = (
        haar_bands(stripes)[0, 0],
        haar_bands(stripes.swapaxes(1, 2))[0, 0],
    )
    np.testing.assert_allclose(across_columns, [0, 1, *[0] * 7, 0.5], atol=1e-12)
    np.testing.assert_allclose(across_rows, [1, 0, *[0] * 7, 0.5], atol=1e-12)


def test_colours_are_samples_beside_each_other():
    x = np.random.default_rng(3).uniform(size=(2, 16, 16, 3))
    found = haar_bands(x)
    assert found.shape == (2, 3 * 4, 10)
    np.testing.assert_allclose(found[:, 4:8], haar_bands(x[..., 1]))


def test_exact_draws_are_at_the_floor():
    """p is uniform over studies of 6 pictures and 4 draws; the value is the floor on average."""
    rng = np.random.default_rng(4)
    found = [frechet_from_truths(*wiener(rng, 6, 4)[:2], rng) for _ in range(150)]
    # In steps of 1/100, which a test for continuous numbers does not mind.
    assert kstest([f.p for f in found], "uniform").pvalue > 0.001
    over = np.array([f.value - f.floor for f in found])
    assert abs(over.mean()) < 4 * over.std(ddof=1) / np.sqrt(len(over))


@pytest.mark.slow
def test_false_alarms_of_pictures_are_as_many_as_stated():
    """400 studies of 6 pictures and 4 draws: p < 5 % within the binomial interval of 99 %."""
    rng = np.random.default_rng(9)
    studies = (wiener(rng, 6, 4)[:2] for _ in range(400))
    alarms = sum(frechet_from_truths(*study, rng).p < 0.05 for study in studies)
    low, high = binom(400, 0.05).interval(0.99)
    print(f"{alarms} of 400 alarms at 5 %, {low:g} to {high:g} are allowed")
    assert low <= alarms <= high


@pytest.mark.parametrize("fault", ["mean", "blurred", "noisy"])
def test_faults_are_caught_at_eight_pictures(fault):
    """Posterior means, which are too smooth; draws a little blurred; draws with noise added."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        truths, draws, means = wiener(rng, 8, 8)
        wrong = {
            "mean": means[:, None],
            "blurred": gaussian_filter(draws, (0, 0, 0.4, 0.4), mode="wrap"),
            "noisy": draws + 0.3 * rng.standard_normal(draws.shape),
        }[fault]
        found = frechet_from_truths(truths, wrong, rng)
        assert found.p < 0.05 and found.value > 2 * found.floor
        exact = frechet_from_truths(truths, draws, rng)
        assert found.value > exact.value


def test_it_cannot_see_which_draw_is_of_which_recording():
    rng = np.random.default_rng(6)
    truths, draws, _ = wiener(rng, 8, 4)
    found, moved = (frechet_from_truths(truths, d, rng) for d in (draws, np.roll(draws, 1, axis=0)))
    np.testing.assert_allclose(moved.value, found.value, rtol=1e-9)


def test_halves_are_closer_the_more_pictures_there_are():
    """Biased, and the bias falls about as 1 / n."""
    rng = np.random.default_rng(7)
    truths = wiener(rng, 128, 1)[0]
    few, many = (frechet_of_halves(truths[:n], rng) for n in (8, 128))
    assert 0 < many < few / 4


def test_features_of_a_network_catch_blur_and_batches_do_not_matter():
    prior = models.ScorePrior.load("nuclei", (SIDE, SIDE))
    features = bottleneck_features(prior)
    rng = np.random.default_rng(8)
    truths = np.clip(0.2 + 0.1 * wiener(rng, 20, 1)[0], 0, 1)
    found = features.of(truths)
    assert found.shape[0] == 20 and found.shape[1] == (SIDE // 8) ** 2
    np.testing.assert_allclose(features.of(truths[17:18]), found[17:18], atol=1e-4)
    blurred = gaussian_filter(truths, (0, 1, 1))[:, None]
    assert frechet_from_truths(truths, blurred, rng, features).p < 0.05


def test_bad_input_is_refused_in_a_sentence():
    x = np.zeros((3, 16, 16))
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="2 pictures or more"):
        frechet_from_truths(x[:1], x[:1, None], rng)
    with pytest.raises(ValueError, match="draws of shape"):
        frechet_from_truths(x, x, rng)
    with pytest.raises(ValueError, match="4 relabellings"):
        frechet_from_truths(x, x[:, None], rng, relabellings=4)
    with pytest.raises(ValueError, match="8 x 8 or larger"):
        haar_bands(x[:, :4])
    with pytest.raises(ValueError, match="no halves"):
        frechet_of_halves(x[:1], rng)
    with pytest.raises(ValueError, match="0 everywhere: their features have no sd"):
        frechet_from_truths(x, x[:, None], rng)
    with pytest.raises(ValueError, match="0 everywhere"):
        frechet_of_halves(x, rng)
    for wrong, message in ((x + 1j, "complex pictures"), (x + np.nan, "768 of 768 values")):
        with pytest.raises(ValueError, match=message):
            haar_bands(wrong)
        with pytest.raises(ValueError, match=message):
            frechet_of_halves(wrong, rng)
        with pytest.raises(ValueError, match=message):
            frechet_from_truths(x + rng.random(x.shape), wrong[:, None], rng)
    complex_prior = models.ScorePrior.load("complex-cells", (SIDE, SIDE))
    with pytest.raises(ValueError, match="complex objects: use the Haar bands"):
        bottleneck_features(complex_prior)
