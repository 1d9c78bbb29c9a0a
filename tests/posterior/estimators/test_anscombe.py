"""Anscombe's transform: its noise, its exact inverse, and what a perfect denoiser makes of it."""

import numpy as np
import pytest
from scipy import stats

from posterior import models
from posterior.estimators import anscombe, anscombe_denoised, exact_unbiased_inverse

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


@pytest.mark.parametrize("camera", [models.Gaussian(0.1), models.PoissonGaussian(100, 0.01)])
def test_other_cameras_are_refused(camera):
    with pytest.raises(ValueError, match="give a Poisson camera"):
        anscombe_denoised(np.zeros((4, 4)), camera, lambda picture, sigma: picture)
