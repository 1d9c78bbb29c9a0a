"""The MMSE estimate against closed forms, and against the mean of draws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import posterior as ps
from posterior import diagnostics, estimators, models, samplers
from posterior.samplers.reverse import reverse_diffusion


def denoising(prior, sigma=0.3):
    likelihood = models.LinearLikelihood(models.Identity(prior.shape), models.Gaussian(sigma))
    problem = ps.Problem(likelihood, prior)
    return problem.condition(problem.simulate(jax.random.key(0))[1])


@pytest.mark.parametrize("dtype", [float, complex])
def test_a_gaussian_prior_gives_the_wiener_filter(x64, dtype):
    power = 1 / (0.1 + np.abs(np.fft.fftfreq(16)))
    post = denoising(models.GaussianField(power, 0.5, dtype=dtype))
    signal = np.asarray(post.prior.power)
    spectrum = np.fft.fft(np.asarray(post.y) - 0.5) * signal / (signal + 0.3**2)
    expected = 0.5 + np.fft.ifft(spectrum)
    expected = expected if dtype is complex else expected.real
    np.testing.assert_allclose(estimators.mmse(post), expected, rtol=1e-10)


@pytest.mark.parametrize("dtype", [pytest.param(float, marks=pytest.mark.slow), complex])
def test_draws_average_to_it(x64, dtype):
    """A prior of two far modes: the mean lies between them, where no draw does."""
    size = 2 if dtype is complex else 1
    means = np.array([[0.0] * size, [1.0] * size])
    covariances = np.broadcast_to(0.05 * np.eye(size), (2, size, size))
    prior = models.GaussianMixture([0.6, 0.4], means, covariances, (1,), dtype)
    likelihood = models.LinearLikelihood(models.Identity((1,)), models.Gaussian(0.5))
    y = np.full(1, 0.6 * (1 + 1j)) if dtype is complex else np.full(1, 0.6)
    post = ps.Problem(likelihood, prior).condition(y)
    draws = ps.sample(
        post, samplers.MALA(), jax.random.key(1), chains=8, draws=4000, thin=10, progress=False
    ).values
    for part in (np.real, np.imag) if dtype is complex else (np.real,):
        values = part(draws)
        error = float(diagnostics.mcse(values)[0])
        assert error < 0.02, "too few draws to tell"
        assert abs(values.mean() - part(estimators.mmse(post)[0])) < 4 * error


def counted(prior, y=None, camera=models.Poisson(50)):  # noqa: B008
    likelihood = models.LinearLikelihood(models.Identity(prior.shape), camera)
    problem = ps.Problem(likelihood, prior)
    return problem.condition(problem.simulate(jax.random.key(0))[1] if y is None else y)


def test_counts_give_the_conjugate_mean(x64):
    post = counted(models.PixelPrior.gamma(3.0, 20.0, (16,), perturbation="poisson"))
    expected = (np.asarray(post.y) * 50 + 3) / (50 + 20)
    np.testing.assert_allclose(estimators.mmse(post), expected, rtol=1e-5)


def test_of_a_code_that_hides_counts_it_is_the_mean_by_quadrature(x64):
    """Sixteen counts a code: off by as much as their mean, negative binomial, is off the middle,
    which is a tenth of what the least of them would be off.
    """
    camera = models.Poisson(240, bits=4)
    prior = models.PixelPrior.gamma(3.0, 8.0, (12,), perturbation="poisson")
    codes = np.arange(3, 15) / 15
    x = np.linspace(1e-4, 4, 40_000)[:, None]
    weight = scipy.stats.gamma(3.0, scale=1 / 8).pdf(x)
    weight = weight * np.exp(np.asarray(camera.log_prob(codes, x)))
    mean = np.sum(weight * x, axis=0) / np.sum(weight, axis=0)
    least, most = np.asarray(camera.electrons_between(codes))
    counts = least + np.arange(16)[:, None]
    assert np.all(counts[-1] == most)
    share = scipy.stats.nbinom(3, 8 / 248).pmf(counts)
    expected = np.sum(share * counts, axis=0) / np.sum(share, axis=0)
    off = (least + most) / 2 - expected
    found = np.asarray(estimators.mmse(counted(prior, codes, camera)))
    np.testing.assert_allclose(found - off / 248, mean, rtol=1e-6)
    assert np.all(np.abs(off) < (expected - least) / 10)


@pytest.mark.slow
def test_draws_of_a_network_average_to_its_estimate():
    """64 draws of the shipped denoiser of counts: a network is consistent only as far as it knows.

    Over the whole picture their mean is off by a tenth of the spread of a draw.
    """
    prior = models.ScorePrior.load("nuclei", (32, 32), "poisson")
    rows, columns = np.mgrid[:32, :32]
    light = 0.08 + 0.5 / (1 + np.exp(np.hypot(rows - 16, columns - 14) - 8))
    post = counted(prior, np.random.default_rng(0).poisson(50 * light) / 50)
    draws = ps.sample(
        post, samplers.Thickening(levels=32), jax.random.key(1), chains=64, draws=1, progress=False
    ).values[:, 0]
    difference = draws.mean(axis=0) - np.asarray(estimators.mmse(post))
    spread = np.sqrt(np.mean(draws.var(axis=0, ddof=1)))
    assert np.sqrt(np.mean(difference**2)) < (0.3 + 1 / 8) * spread
    assert abs(difference.mean()) < 0.1 * spread


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.05, 0.2])
def test_reverse_diffusion_from_a_noisy_picture_averages_to_its_estimate(sigma):
    """Under Gaussian noise, of the shipped network: but for the error of the mean of 64 draws.

    A network is consistent as far as it knows: that leaves 0.21 and 0.22 of the spread of a draw,
    of which 0.25 are allowed. Draws that believe in 1.3 times the noise are further off.
    """
    prior = models.ScorePrior.load("nuclei", (32, 32))
    rows, columns = np.mgrid[:32, :32]
    light = 0.08 + 0.5 / (1 + np.exp(np.hypot(rows - 16, columns - 14) - 8))
    y = jnp.asarray(light + sigma * np.random.default_rng(0).standard_normal((32, 32)), float)
    keys, level = jax.random.split(jax.random.key(1), 64), jnp.asarray(sigma, y.dtype)
    estimate = np.asarray(prior.denoise(y, level))

    @jax.jit
    def drawn(level):
        return jax.vmap(lambda key: reverse_diffusion(key, prior, y, level, 16))(keys)

    def inconsistency(draws):
        """Squared, over the variance of a draw, less what the mean of so many is off by chance."""
        off, variance = draws.mean(axis=0) - estimate, np.mean(draws.var(axis=0, ddof=1))
        return np.mean(off**2) / variance - 1 / len(draws)

    right, wrong = (inconsistency(np.asarray(drawn(s * level))) for s in (1.0, 1.3))
    print(f"sigma {sigma}: off by {right**0.5:.3f} of the spread, by {wrong**0.5:.3f} if wrong")
    assert right < 0.25**2 < wrong


@pytest.mark.parametrize(
    "likelihood, sentence",
    [
        (
            models.LinearLikelihood(models.Matrix(np.eye(4)), models.Gaussian(0.1)),
            "Identity optics",
        ),
        (
            models.LinearLikelihood(models.Identity((4,)), models.Poisson(100)),
            "give one with the poisson",
        ),
        (
            models.LinearLikelihood(models.Identity((4,)), models.PoissonGaussian(100, 2.0)),
            "Gaussian noise or counts",
        ),
    ],
)
def test_other_problems_are_refused(likelihood, sentence):
    prior = models.GaussianPrior(np.full(4, 0.5), 0.01, (4,))
    post = ps.Problem(likelihood, prior).condition(np.full(4, 0.5))
    with pytest.raises(ValueError, match=sentence):
        estimators.mmse(post)
