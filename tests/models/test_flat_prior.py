"""The flat prior: its posterior is the likelihood, exactly where that has a closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from known import batch_error, largest_z, real_view
from posterior import models, samplers

SIGMAS = [0.0, 0.3, 4.0]


def overdetermined(dtype, noise=0.3):
    """Least squares of 3 unknowns from 8 data: the posterior, its mean and covariance."""
    rng = np.random.default_rng(0)
    matrix = rng.standard_normal((8, 3)) / 2
    if dtype is complex:
        matrix = matrix + 1j * rng.standard_normal((8, 3)) / 2
    likelihood = models.LinearLikelihood(models.Matrix(matrix), models.Gaussian(noise))
    y = likelihood.simulate(jax.random.key(0), jnp.arange(3, dtype=dtype))
    posterior = ps.Problem(likelihood, models.FlatPrior(3, dtype)).condition(y)
    h, data = matrix, np.asarray(y)
    if dtype is complex:
        h = np.block([[h.real, -h.imag], [h.imag, h.real]])
        data = np.concatenate([data.real, data.imag])
    covariance = noise**2 * np.linalg.inv(h.T @ h)
    return posterior, covariance @ (h.T @ data) / noise**2, covariance


@pytest.mark.parametrize("dtype", [float, complex])
def test_the_posterior_is_the_likelihood(x64, dtype):
    """Its score at every level, and at none the density too."""
    posterior, _, _ = overdetermined(dtype)
    x = jnp.array([0.3, -1.0, 2.0], dtype)
    likelihood, y = posterior.likelihood, posterior.y
    for sigma in SIGMAS:
        alone = likelihood.annealed_score(x, y, sigma)
        np.testing.assert_array_equal(posterior.annealed_score(x, sigma), alone)
        assert posterior.prior.score(x, sigma).dtype == x.dtype
        np.testing.assert_array_equal(posterior.prior.denoise(x, sigma), x)
    np.testing.assert_array_equal(posterior.log_prob(x), posterior.log_likelihood(x))
    np.testing.assert_array_equal(posterior.score(x), likelihood.score(x, y))


@pytest.mark.slow
def test_mala_draws_the_distribution_of_least_squares(x64):
    posterior, mean, covariance = overdetermined(complex)
    start = jnp.zeros(3, complex)
    run = ps.sample(
        posterior, samplers.MALA(), jax.random.key(1), draws=3000, start=start, progress=False
    )
    x = real_view(run.values)
    z = (x.mean(axis=(0, 1)) - mean) / batch_error(x)
    assert np.abs(z).max() < largest_z(len(mean))
    squares = (x - mean) ** 2
    z = (squares.mean(axis=(0, 1)) - np.diag(covariance)) / batch_error(squares)
    assert np.abs(z).max() < largest_z(len(mean))


@pytest.mark.parametrize("path", ["split", "convolved"])
def test_annealing_without_a_prior_ends_in_least_squares(x64, path):
    """Each draw the end of a run of its own, so that the errors are of independent draws."""
    posterior, mean, covariance = overdetermined(complex)
    levels = {} if path == "split" else {"sigma_max": 2.0, "sigma_min": 0.01}
    sampler = samplers.AnnealedLangevin(levels=40, steps=5, path=path, **levels)
    chains = 1000
    run = ps.sample(
        posterior, sampler, jax.random.key(2), chains=chains, draws=1, start=jnp.zeros(3, complex),
        progress=False,
    )  # fmt: skip
    x = real_view(run.values)[:, 0]
    assert np.abs(x.mean(axis=0) - mean).max() < 4 * np.sqrt(covariance.max() / chains)
    ratio = x.var(axis=0, ddof=1) / np.diag(covariance)
    # 4 standard errors of a variance, and 3 % for the steps that are finite.
    assert np.abs(ratio - 1).max() < 4 * np.sqrt(2 / chains) + 0.03


def test_what_needs_a_distribution_is_refused():
    prior = models.FlatPrior((4, 4), complex)
    assert prior.shape == (4, 4) and prior.complex_valued and prior.stiffness == 0
    with pytest.raises(ValueError, match="no draws: give start="):
        prior.sample(jax.random.key(0))
    with pytest.raises(ValueError, match="this prior is for"):
        prior.score(jnp.zeros(3))
    with pytest.raises(ValueError, match="complex object"):
        models.FlatPrior(3).score(jnp.zeros(3, complex))
    posterior, _, _ = overdetermined(float)
    run = {"draws": 1, "progress": False}
    with pytest.raises(ValueError, match="no draws: give start="):
        ps.sample(posterior, samplers.MALA(), jax.random.key(0), **run)
    with pytest.raises(ValueError, match="no scale to anneal from"):
        start = jnp.zeros(3)
        ps.sample(posterior, samplers.AnnealedLangevin(), jax.random.key(0), start=start, **run)
