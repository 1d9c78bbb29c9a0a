"""Real objects among complex ones, against a complex Gaussian prior with hardly any Im."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from posterior import models, samplers
from posterior.models.priors import RealAmongComplex

SHAPE = (3, 4)
N = 12


def covariance():
    rng = np.random.default_rng(0)
    factor = rng.standard_normal((N, N)) / 4
    return factor @ factor.T + 0.05 * np.eye(N)


def test_it_is_the_limit_of_a_complex_gaussian_without_an_imaginary_part(x64):
    real = models.GaussianPrior(np.full(N, 0.5), covariance(), SHAPE)
    both = np.zeros((2 * N, 2 * N))
    both[:N, :N], both[N:, N:] = covariance(), 1e-14 * np.eye(N)
    mean = np.r_[np.full(N, 0.5), np.zeros(N)]
    thin = models.GaussianPrior(mean, both, SHAPE, complex)
    prior = RealAmongComplex(real)
    rng = np.random.default_rng(1)
    x = jnp.asarray(rng.standard_normal(SHAPE) + 1j * rng.standard_normal(SHAPE))
    for sigma in (0.1, 1.0):
        np.testing.assert_allclose(prior.log_prob(x, sigma), thin.log_prob(x, sigma), rtol=1e-9)
        np.testing.assert_allclose(prior.score(x, sigma), thin.score(x, sigma), rtol=1e-7)
        np.testing.assert_allclose(prior.denoise(x, sigma), thin.denoise(x, sigma), atol=1e-9)
    np.testing.assert_allclose(prior.scale, thin.scale, rtol=1e-9)
    np.testing.assert_array_equal(prior.sample(jax.random.key(0)).imag, 0)


@pytest.mark.slow
def test_a_complex_sampler_draws_the_real_posterior():
    """Of y = |H o|^2, H real and positive enough to know the sign: means and widths of MALA's."""
    real = models.GaussianPrior(np.full(N, 0.8), 0.05**2, SHAPE)
    matrix = np.eye(N) + 0.05 * np.random.default_rng(2).random((N, N)) * (1 + 1j)
    likelihood = models.IntensityLikelihood(models.Matrix(matrix, SHAPE), models.Poisson(1000), 0.4)
    problem = ps.Problem(likelihood, real)
    _, y = problem.simulate(jax.random.key(0))
    settings = {"chains": 200, "draws": 1, "progress": False}
    sampler = samplers.AnnealedLangevin(levels=60, steps=6, sigma_min=0.004)
    among = ps.Problem(likelihood, RealAmongComplex(real)).condition(y)
    drawn = ps.sample(among, sampler, jax.random.key(1), **settings).values[:, 0]
    assert np.abs(drawn.imag).std() < 0.004
    exact = ps.sample(
        problem.condition(y), samplers.MALA(), jax.random.key(2), chains=4, draws=1000, thin=5,
        progress=False,
    ).values.reshape(-1, *SHAPE)  # fmt: skip
    sd = exact.std(axis=0)
    off = (drawn.real.mean(axis=0) - exact.mean(axis=0)) / sd
    # Two hundred independent draws a pixel, and twice that for the annealing's own error.
    assert np.abs(off).max() < 8 / np.sqrt(200)
    ratio = np.mean(drawn.real.var(axis=0) / sd**2)
    assert abs(ratio - 1) < 4 * np.sqrt(2 / (200 * N)) + 0.1


def test_other_priors_are_refused():
    with pytest.raises(ValueError, match="give one of real objects"):
        RealAmongComplex(models.GaussianPrior(0.0, 1.0, SHAPE, complex))
