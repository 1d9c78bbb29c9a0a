"""Exact posteriors of all data at once, and samplers of them with one fault each."""

import jax
import jax.numpy as jnp
import numpy as np

import posterior as ps
from posterior import models

DRAWS = 50


class GaussianCase:
    """A linear-Gaussian problem of `size` unknowns: its posterior is written down for every y."""

    def __init__(self, size=64, rows=48, noise=0.3, seed=0):
        rng = np.random.default_rng(seed)
        self.matrix = rng.standard_normal((rows, size)) / np.sqrt(size)
        root = rng.standard_normal((size, size)) / np.sqrt(size)
        self.prior = 0.5 * np.eye(size) + root @ root.T
        self.size, self.noise = size, noise
        self.problem = ps.Problem(
            models.LinearLikelihood(models.Matrix(self.matrix), models.Gaussian(noise)),
            models.GaussianPrior(np.zeros(size), self.prior, (size,)),
        )

    def posterior(self, noise=None):
        """The matrix that makes its mean of y, and its covariance."""
        precision = (self.noise if noise is None else noise) ** -2
        h = self.matrix
        covariance = np.linalg.inv(np.linalg.inv(self.prior) + precision * h.T @ h)
        return precision * covariance @ h.T, covariance

    def drawer(self, temperature=1.0, noise=None, marginals=False, count=DRAWS):
        """Independent draws, of a temperature, of a believed noise, or without correlations."""
        gain, covariance = self.posterior(noise)
        covariance = np.diag(np.diag(covariance)) if marginals else covariance
        root = np.sqrt(temperature) * np.linalg.cholesky(covariance)

        def draw(key, posterior):
            n = jax.random.normal(key, (1, count, self.size))
            return gain @ posterior.y + n @ root.T

        return draw

    def of_the_prior(self, key, posterior):
        """Draws that have never seen the recording."""
        return jax.vmap(posterior.prior.sample)(jax.random.split(key, DRAWS))[None]

    def of_other_data(self, key, posterior):
        """Draws of the posterior of a recording of another object."""
        key, other = jax.random.split(key)
        y = self.problem.simulate(other)[1]
        return self.drawer()(key, self.problem.condition(y))

    def langevin(self, noise=1.0, step=0.1, steps=60):
        """Preconditioned Langevin whose noise is sqrt(2 step) times `noise`, from the mean."""
        gain, covariance = self.posterior()
        root = np.linalg.cholesky(covariance)

        def draw(key, posterior):
            mean = gain @ posterior.y

            def move(x, key):
                n = jax.random.normal(key, x.shape) @ root.T
                return x + step * (mean - x) + noise * jnp.sqrt(2 * step) * n, None

            start = jnp.broadcast_to(mean, (1, DRAWS, self.size))
            return jax.lax.scan(move, start, jax.random.split(key, steps))[0]

        return draw


class MixtureCase:
    """Two modes that the measurement does not tell apart; a draw may know only one of them."""

    def __init__(self, size=8, apart=3.0, noise=0.5):
        means = np.zeros((2, size))
        means[1, -1] = apart
        eye = np.eye(size)
        self.matrix, self.noise, self.means = eye[:-1], noise, means
        self.problem = ps.Problem(
            models.LinearLikelihood(models.Matrix(self.matrix), models.Gaussian(noise)),
            models.GaussianMixture(np.array([0.7, 0.3]), means, np.stack([eye, eye]), (size,)),
        )

    def drawer(self, lost=False):
        """Independent draws; with `lost` of the first mode alone."""
        shrink = 1 / (1 + self.noise**2)
        sd = np.append(np.full(len(self.matrix), np.sqrt(1 - shrink)), 1.0)

        def draw(key, posterior):
            key_mode, key_noise = jax.random.split(key)
            mode = (jax.random.uniform(key_mode, (1, DRAWS)) < (0.0 if lost else 0.3)).astype(int)
            seen = jnp.append(shrink * posterior.y, 0.0)
            n = jax.random.normal(key_noise, (1, DRAWS, len(sd)))
            return seen + jnp.asarray(self.means)[mode] + sd * n

        return draw
