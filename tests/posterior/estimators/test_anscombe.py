"""Anscombe's transform: its noise, its exact inverse, and what a perfect denoiser makes of it."""

import numpy as np
import pytest
from scipy import stats
from skimage import data

from posterior import diagnostics, models
from posterior.estimators import anscombe, anscombe_denoised, exact_unbiased_inverse
from posterior.estimators.anscombe import mean_of_roots

MEANS = np.concatenate([np.linspace(0.05, 5, 40), [10.0, 100.0, 1000.0]])


def transformed(power):
    """E[anscombe(N)^power] at each mean, by the sum over counts."""
    counts = np.arange(2000)[:, None]
    return np.sum(stats.poisson.pmf(counts, MEANS) * anscombe(counts) ** power, axis=0)


def test_the_inverse_is_that_of_the_mean_root():
    found = exact_unbiased_inverse(transformed(1))
    np.testing.assert_allclose(found, MEANS, atol=0.03)
    assert np.abs((transformed(1) / 2) ** 2 - 3 / 8 - MEANS)[-1] > 0.2  # the algebraic inverse


def test_the_noise_is_nearly_white():
    variance = transformed(2) - transformed(1) ** 2
    np.testing.assert_allclose(variance[MEANS >= 4], 1, atol=0.02)


def test_a_perfect_denoiser_finds_the_picture():
    """Of one brightness: its mean of roots is known to 1/sqrt(200,000)."""
    camera, brightness = models.Poisson(25), 0.06
    y = np.random.default_rng(0).poisson(25 * brightness, (400, 500)) / 25
    asked = []

    def mean(picture, sigma):
        asked.append(sigma * anscombe(25))
        return np.full_like(picture, picture.mean())

    found = anscombe_denoised(y, camera, mean)
    np.testing.assert_allclose(asked, 1)
    # The closed form errs by 0.03 electrons at most; the Monte-Carlo error is a tenth of that.
    np.testing.assert_allclose(found, brightness, atol=0.035 / 25)


@pytest.mark.parametrize("share", [0.25, 0.6, 1.0])
def test_roots_of_counts_and_their_mean_have_the_mean_of_all_counts(share):
    """Both sides of where the series begins, and far from it."""
    means = np.array([0.0, 0.3, 5.0, 49.9, 50.1, 120.0, 1000.0])
    counts = np.arange(3000)[:, None]
    roots = anscombe((share * counts + (1 - share) * means) / share**2)
    exact = np.sum(stats.poisson.pmf(counts, means) * roots, axis=0)
    np.testing.assert_allclose(mean_of_roots(means, share), exact, atol=1e-5)


def test_a_second_round_has_whiter_noise_and_no_bias():
    """Of half a count a pixel, and a perfect denoiser: what it is handed, and what comes out."""
    camera, brightness, shape = models.Poisson(25), 0.02, (800, 1000)
    y = np.random.default_rng(1).poisson(25 * brightness, shape) / 25
    asked = []

    def mean(picture, sigma):
        asked.append(picture.std() / sigma)
        return np.full_like(picture, picture.mean())

    found = anscombe_denoised(y, camera, mean, shares=(1.0, 0.5, 0.25))
    # Sums over counts: the noise it is told of, 1, is nearer to the noise there is.
    counts = np.arange(60)
    weights = stats.poisson.pmf(counts, 25 * brightness)
    for share, sd in zip((1.0, 0.5, 0.25), asked):
        roots = anscombe((share * counts + (1 - share) * 25 * brightness) / share**2)
        expected = np.sqrt(weights @ roots**2 - (weights @ roots) ** 2)
        assert abs(sd - expected) < 5 / np.sqrt(y.size) * expected
    assert asked[0] < 0.7 and 0.9 < asked[2] < 1
    # Within the noise of the mean, and what is left of the closed form's error in the first round.
    noise = np.sqrt(brightness / 25 / y.size)
    np.testing.assert_allclose(found, brightness, atol=4 * noise)


@pytest.mark.slow
def test_rounds_help_where_photons_are_few_and_not_where_they_are_many():
    """On a real picture, with BM3D, with 2 and 100 electrons in its brightest pixels."""
    bm3d = pytest.importorskip("bm3d").bm3d

    def brighter(root, sigma):
        # BM3D has thresholds of its own for values of about 1.
        return bm3d(root * 4, sigma * 4) / 4

    picture = data.camera()[100:228, 180:308] / 255 / 20  # far from the full well
    gains = {2: [], 100: []}
    for peak, found in gains.items():
        camera = models.Poisson(20 * peak)
        for seed in range(6):
            y = np.random.default_rng(seed).poisson(20 * peak * picture) / (20 * peak)
            one, three = (
                diagnostics.psnr(anscombe_denoised(y, camera, brighter, shares), picture, 1 / 20)
                for shares in ((1.0,), (1.0, 0.625, 0.25))
            )
            found.append(three - one)
    means = {peak: np.mean(found) for peak, found in gains.items()}
    errors = {peak: stats.sem(found) for peak, found in gains.items()}
    print(f"\ndB that three rounds gain, by peak: {means} +- {errors}")
    assert means[2] > 4 * errors[2] and means[100] < -4 * errors[100]


@pytest.mark.parametrize("shares", [(), (0.5,), (1.0, 0.0), (1.0, 1.2)])
def test_shares_that_are_none_are_refused(shares):
    with pytest.raises(ValueError, match="shares .*: begin with 1"):
        anscombe_denoised(np.zeros((4, 4)), models.Poisson(10), lambda p, s: p, shares)


@pytest.mark.parametrize(
    "camera",
    [models.Gaussian(0.1), models.PoissonGaussian(100, 0.01), models.Poisson(1000, bits=8)],
)
def test_other_cameras_are_refused(camera):
    with pytest.raises(ValueError, match="give Poisson"):
        anscombe_denoised(np.zeros((4, 4)), camera, lambda picture, sigma: picture)


@pytest.mark.parametrize(
    "y", [np.full((4, 4), 3.0), np.full((4, 4), -0.5), np.full((4, 4), np.nan)]
)
def test_what_no_camera_records_is_refused(y):
    with pytest.raises(ValueError):
        anscombe_denoised(y, models.Poisson(10), lambda picture, sigma: picture)


@pytest.mark.parametrize("returned", [np.zeros((4, 4, 1)), np.full((4, 4), np.nan)])
def test_what_is_no_picture_of_the_denoiser_is_refused(returned):
    with pytest.raises(ValueError, match="the denoiser returned"):
        anscombe_denoised(np.zeros((4, 4)), models.Poisson(10), lambda picture, sigma: returned)
