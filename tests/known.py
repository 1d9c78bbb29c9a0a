"""Problems with a known posterior, and the errors that a finite run may have."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats

import posterior as ps
from posterior import models
from posterior.estimators import calibrate, maximum_likelihood
from posterior.estimators.calibration import NOMINAL


def real_view(values):
    """Draws (chains, draws, *shape) as real vectors (chains, draws, n)."""
    flat = np.asarray(values).reshape(*values.shape[:2], -1)
    if np.iscomplexobj(flat):
        return np.concatenate([flat.real, flat.imag], axis=-1)
    return flat


def linear_gaussian(size, rows, dtype, seed=0, noise=0.3):
    """A Posterior, and its exact mean and covariance in the real view."""
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, size)) / np.sqrt(size)
    n = size
    if dtype is complex:
        matrix = (matrix + 1j * rng.standard_normal((rows, size)) / np.sqrt(size)) / np.sqrt(2)
        n = 2 * size
    root = rng.standard_normal((n, n)) / np.sqrt(n)
    covariance = 0.5 * np.eye(n) + root @ root.T
    mean = rng.standard_normal(n)
    prior = models.GaussianPrior(mean, covariance, (size,), dtype)
    likelihood = models.LinearLikelihood(models.Matrix(matrix), models.Gaussian(noise))
    problem = ps.Problem(likelihood, prior)
    _, y = problem.simulate(jax.random.key(seed))
    h, data = matrix, np.asarray(y)
    if dtype is complex:
        h = np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])
        data = np.concatenate([y.real, y.imag])
    exact_covariance = np.linalg.inv(np.linalg.inv(covariance) + h.T @ h / noise**2)
    exact_mean = exact_covariance @ (np.linalg.solve(covariance, mean) + h.T @ data / noise**2)
    return problem.condition(y), exact_mean, exact_covariance


BATCHES = 25


def batch_error(x):
    """Monte-Carlo standard error of the mean of x (chains, draws, ...), by batch means.

    Each chain is cut into 25 batches, long against its autocorrelation (Flegal and Jones 2010).
    """
    length = x.shape[1] // BATCHES
    batches = x[:, : BATCHES * length].reshape(-1, length, *x.shape[2:]).mean(axis=1)
    return batches.std(axis=0, ddof=1) / np.sqrt(len(batches))


def largest_z(count, chains=4):
    """What the largest of `count` such z exceeds once in 2000 correct runs (Bonferroni)."""
    return scipy.stats.t(chains * BATCHES - 1).isf(0.0005 / (2 * count))


def check_mean(values, mean):
    """The mean of draws (chains, draws, n) is `mean` (n,), within Monte-Carlo error."""
    z = (values.mean((0, 1)) - mean) / batch_error(values)
    assert np.abs(z).max() < largest_z(z.size, len(values)), np.abs(z).max()


def check_moments(values, mean, covariance):
    """Every mean and every covariance is right, within Monte-Carlo error.

    The products of deviations from the exact mean have the covariance as their expectation.
    """
    draws = real_view(values)
    check_mean(draws, mean)
    rest = draws - mean
    rows, columns = np.triu_indices(len(mean))
    bound = largest_z(len(rows), len(values))
    for part in np.array_split(np.arange(len(rows)), max(1, len(rows) // 256)):
        products = rest[..., rows[part]] * rest[..., columns[part]]
        exact = covariance[rows[part], columns[part]]
        z = (products.mean((0, 1)) - exact) / batch_error(products)
        assert np.abs(z).max() < bound, np.abs(z).max()


def grid_posterior(post, half_width=1.6, points=801):
    """One complex pixel on a grid: its points (m,), and their exact probabilities (m,)."""
    axis = jnp.linspace(-half_width, half_width, points)
    grid = (axis[:, None] + 1j * axis[None, :]).ravel()
    log_prob = jax.jit(jax.vmap(lambda o: post.log_prob(o[None])))
    values = np.concatenate([log_prob(part) for part in jnp.split(grid, points)])
    weight = np.exp(values - values.max())
    return np.asarray(grid), weight / weight.sum()


def with_nominal_microscope(stack, upsampling):
    """Quasi-Newton that believes a stack's microscope; object and brightness of the LEDs in turns.

    As `estimators.calibrate` gives it.
    """
    found = calibrate(stack, upsampling, rounds=0, progress=False)
    o = found.object
    for _ in range(4):
        likelihood, y = NOMINAL.likelihood(stack, upsampling, o)
        o = np.asarray(maximum_likelihood(likelihood, y, o).object)
    return found._replace(object=o, dispersion=np.full(len(stack.led_na), np.nan))
