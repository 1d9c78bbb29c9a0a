"""Regularisation by denoising is the maximum of a posterior that is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from posterior import estimators, models

LEVEL = 0.2
POWER = 0.05 / (0.1 + np.abs(np.fft.fftfreq(16)))


def recorded(camera, dtype=float, y=None):
    prior = models.GaussianField(POWER, 0.5, dtype=dtype)
    problem = ps.Problem(models.LinearLikelihood(models.Identity((16,)), camera), prior)
    if y is None:
        # A picture, where the prior's own draws may lie below zero.
        x = 0.5 + 0.4 * np.sin(np.arange(16)) + (0.2j if dtype is complex else 0)
        y = problem.likelihood.simulate(jax.random.key(0), x)
    return problem.condition(y)


@pytest.mark.parametrize("dtype", [float, complex])
def test_of_gaussian_noise_it_is_the_wiener_filter_of_the_blurred_prior(x64, dtype):
    post = recorded(models.Gaussian(0.3), dtype)
    found = estimators.red(post, LEVEL)
    blurred = np.asarray(post.prior.power) + (LEVEL / (2 if dtype is complex else 1)) ** 2
    spectrum = np.fft.fft(np.asarray(post.y) - 0.5) * blurred / (blurred + 0.3**2)
    expected = 0.5 + np.fft.ifft(spectrum)
    expected = expected if dtype is complex else expected.real
    np.testing.assert_allclose(found.object, expected, atol=1e-9)
    assert found.imbalance < 1e-9


@pytest.mark.parametrize(("level", "far"), [(0.1, 1e-3), (0.02, 0.01), (1e-3, 0.2), (1e-4, 0.2)])
def test_what_has_hardly_left_the_recording_says_so(x64, level, far):
    """Far below the noise, steps are small whether or not there is far to go."""
    post = recorded(models.Gaussian(0.3))
    found = estimators.red(post, level)
    blurred = np.asarray(post.prior.power) + level**2
    spectrum = np.fft.fft(np.asarray(post.y) - 0.5) * blurred / (blurred + 0.3**2)
    expected = 0.5 + np.fft.ifft(spectrum).real
    error = np.linalg.norm(found.object - expected) / np.linalg.norm(expected)
    assert (error > far) == (level < 0.1) == (found.imbalance > 0.1)


@pytest.mark.parametrize("weight", [None, 10.0])
def test_of_counts_neither_the_recording_nor_the_denoiser_moves_it(x64, weight):
    post = recorded(models.Poisson(12))
    found = estimators.red(post, LEVEL, weight, iterations=5000)
    x = found.object
    assert found.imbalance < 1e-8
    pull = (1 / LEVEL**2 if weight is None else weight) * (post.prior.denoise(x, LEVEL) - x)
    force = np.asarray(post.likelihood.score(x, post.y) + pull)
    dark = np.asarray(x) < 1e-9
    assert 0 < dark.sum() < 8 and np.all(np.asarray(post.y)[dark] == 0)
    np.testing.assert_allclose(force[~dark], 0, atol=1e-6)
    assert np.all(force[dark] < 0), "light would make a dark pixel likelier"


def test_a_dark_recording_is_a_number():
    found = estimators.red(recorded(models.Poisson(1000), y=np.zeros(16)), LEVEL)
    assert np.all(np.isfinite(found.object)) and np.isfinite(found.imbalance)


def test_behind_an_adc_a_code_is_its_middle(x64):
    """The average over codes is that over counts: the lower ends would be half a code too dark."""
    camera = models.Poisson(100_000, bits=8)
    mean = 128.3 / 255
    y = camera.sample(jax.random.key(0), jnp.full((4096, 16), mean))
    prior = models.GaussianField(POWER, 0.5)
    problem = ps.Problem(models.LinearLikelihood(models.Identity((16,)), camera), prior)
    found = jax.vmap(lambda y: estimators.red(problem.condition(y), 0.5).object)(y)
    # The prior pulls by 1 / 0.5^2 towards its mean, beside a precision of 1e5 / mean.
    error = np.std(found) / np.sqrt(found.size)
    assert abs(np.mean(found) - mean) < 4 * error + 1e-6 < 1e-4


def test_a_full_well_counts_as_so_many_electrons(x64):
    post = recorded(models.Poisson(12), y=np.ones(16))
    found = estimators.red(post, LEVEL, 10.0, iterations=5000)
    x = found.object
    force = 12 / x - 12 + 10.0 * (post.prior.denoise(x, LEVEL) - x)
    np.testing.assert_allclose(force, 0, atol=1e-6)


def test_single_precision_keeps_faint_pixels():
    """Bright full wells subtract nearly equal numbers in the schoolbook form of the root."""
    y = np.full(16, 3e-5)
    found = estimators.red(recorded(models.Poisson(1_000_000), y=y), LEVEL)
    assert found.object.dtype == np.float32
    # The recording alone says 3e-5; the prior's pull changes it by weight / full well.
    np.testing.assert_allclose(found.object, 3e-5, rtol=1e-3)


def test_what_it_is_not_for_is_refused():
    post = recorded(models.Gaussian(0.1))
    for name, value in (("level", 0), ("level", np.inf), ("weight", -1), ("weight", 1e-39)):
        with pytest.raises(ValueError, match=f"{name} .*: give a positive number"):
            estimators.red(post, **({"level": 0.1} | {name: value}))
    with pytest.raises(ValueError, match="iterations 0: give a whole number"):
        estimators.red(post, LEVEL, iterations=0)
    with pytest.raises(TypeError, match="integer"):
        estimators.red(post, LEVEL, iterations=2.5)
    with pytest.raises(ValueError, match="camera PoissonGaussian: regularisation by denoising is"):
        estimators.red(recorded(models.PoissonGaussian(100, 1.0)), LEVEL)
    prior = models.GaussianField(POWER, 0.5)
    blur = models.LinearLikelihood(models.Matrix(np.eye(16)), models.Gaussian(0.1))
    with pytest.raises(ValueError, match="the picture itself here"):
        estimators.red(ps.Problem(blur, prior).condition(np.zeros(16)), LEVEL)
    counts = models.PixelPrior.gamma(3.0, 20.0, (16,), perturbation="poisson")
    likelihood = models.LinearLikelihood(models.Identity((16,)), models.Poisson(10))
    with pytest.raises(ValueError, match="'poisson' perturbation: give one with the gaussian"):
        estimators.red(ps.Problem(likelihood, counts).condition(np.zeros(16)), LEVEL)
