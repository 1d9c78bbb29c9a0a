"""Problems with a known posterior, and the errors that a finite run may have."""

import jax
import jax.numpy as jnp
import numpy as np
import posterior as ps
from posterior import diagnostics, models


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
    h = np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])
    h = h if dtype is complex else matrix
    data = np.concatenate([y.real, y.imag]) if dtype is complex else np.asarray(y)
    exact_covariance = np.linalg.inv(np.linalg.inv(covariance) + h.T @ h / noise**2)
    exact_mean = exact_covariance @ (np.linalg.solve(covariance, mean) + h.T @ data / noise**2)
    return problem.condition(y), exact_mean, exact_covariance


def moment_z(values, mean, covariance):
    """Largest |z| of means, and of all products of deviations, against the exact moments.

    Errors are Monte-Carlo standard errors of the run itself, by ESS; the products of deviations
    from the exact mean have the covariance as their expectation.
    """
    draws = real_view(values)
    z_mean = (draws.mean((0, 1)) - mean) / diagnostics.mcse(draws)
    rest = draws - mean
    i, j = np.triu_indices(len(mean))
    z_covariance = []
    for part in np.array_split(np.arange(len(i)), max(1, len(i) // 256)):
        products = rest[..., i[part]] * rest[..., j[part]]
        error = diagnostics.mcse(products)
        z_covariance.append((products.mean((0, 1)) - covariance[i[part], j[part]]) / error)
    return np.abs(z_mean).max(), np.abs(np.concatenate(z_covariance)).max()


def grid_posterior(post, half_width=2.0, points=801):
    """One complex pixel on a grid: the points (m,), and their exact probabilities (m,)."""
    axis = jnp.linspace(-half_width, half_width, points)
    grid = (axis[:, None] + 1j * axis[None, :]).ravel()
    log_prob = jax.lax.map(lambda o: post.log_prob(o[None]), grid, batch_size=20_000)
    weight = np.exp(np.asarray(log_prob) - np.max(log_prob))
    return np.asarray(grid), weight / weight.sum()
