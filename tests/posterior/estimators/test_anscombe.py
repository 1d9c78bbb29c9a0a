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


def test_counts_together_with_their_mean_have_whiter_noise():
    """Of 1 count a pixel: variance 0.72 alone (1 is right), 0.91 with the mean beside."""
    found, counts = {}, np.arange(60)
    for share in (1.0, 0.25):
        roots = anscombe((share * counts + (1 - share)) / share**2)
        weights = stats.poisson.pmf(counts, 1.0)
        found[share] = weights @ roots**2 - (weights @ roots) ** 2
    assert found[1.0] < 0.75 and 0.9 < found[0.25] < 1


def test_a_second_round_takes_a_perfect_estimate_as_it_is():
    """What a perfect denoiser finds has no bias in any round, at half a count a pixel."""
    camera, brightness = models.Poisson(25), 0.02
    y = np.random.default_rng(1).poisson(25 * brightness, (800, 1000)) / 25
    asked = []

    def mean(picture, sigma):
        asked.append(picture.std() / sigma)
        return np.full_like(picture, picture.mean())

    found = anscombe_denoised(y, camera, mean, shares=(1.0, 0.5, 0.25))
    # The closed form of the first round is off by 0.03 electrons at most, which the later rounds
    # repeat: they hold the estimate for the truth.
    np.testing.assert_allclose(found, brightness, atol=0.035 / 25)
    # The noise it is told of is nearer to the noise there is.
    assert asked[0] < 0.7 and 0.9 < asked[2] < 1


@pytest.mark.slow
def test_rounds_help_where_photons_are_few_and_not_where_they_are_many():
    """On a real picture, with BM3D, at 2 and 100 electrons of full well."""
    bm3d = pytest.importorskip("bm3d").bm3d
    picture = data.camera()[100:228, 180:308] / 255
    gains = {2: [], 100: []}
    for full_well, found in gains.items():
        camera = models.Poisson(full_well)
        for seed in range(6):
            y = np.random.default_rng(seed).poisson(full_well * picture) / full_well
            one, three = (
                diagnostics.psnr(anscombe_denoised(y, camera, bm3d, shares), picture)
                for shares in ((1.0,), (1.0, 0.625, 0.25))
            )
            found.append(three - one)
    means = {full_well: np.mean(found) for full_well, found in gains.items()}
    errors = {full_well: stats.sem(found) for full_well, found in gains.items()}
    print(f"\ndB that three rounds gain, by full well: {means} +- {errors}")
    assert means[2] > 4 * errors[2] and means[100] < 4 * errors[100]


@pytest.mark.parametrize("shares", [(), (0.5,), (1.0, 0.0), (1.0, 1.2)])
def test_shares_that_are_none_are_refused(shares):
    with pytest.raises(ValueError, match="shares .*: begin with 1"):
        anscombe_denoised(np.zeros((4, 4)), models.Poisson(10), lambda p, s: p, shares)


@pytest.mark.parametrize("camera", [models.Gaussian(0.1), models.PoissonGaussian(100, 0.01)])
def test_other_cameras_are_refused(camera):
    with pytest.raises(ValueError, match="give a Poisson camera"):
        anscombe_denoised(np.zeros((4, 4)), camera, lambda picture, sigma: picture)
