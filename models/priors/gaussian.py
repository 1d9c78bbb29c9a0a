"""A multivariate normal prior with a dense covariance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .base import Prior
from .mixture import GaussianMixture


class Gaussian(Prior):
    """Normal prior over the real view of an object; exact at every sigma.

    Parameters: `mean` (n,) and `covariance` (n, n) in the real view, or a scalar `mean` and a
    scalar `covariance` (a variance per real component). n = size of `shape`, doubled for
    `dtype=complex`. Raises ValueError if the covariance is not positive semi-definite.
    """

    mixture: GaussianMixture
    shape: tuple[int, ...] = eqx.field(static=True)
    complex_valued: bool = eqx.field(static=True)
    perturbation: str = eqx.field(static=True, default="gaussian")

    def __init__(
        self,
        mean: np.ndarray | float,
        covariance: np.ndarray | float,
        shape: tuple[int, ...],
        dtype: type = float,
    ):
        size = int(np.prod(shape)) * (2 if np.dtype(dtype).kind == "c" else 1)
        mean = np.asarray(mean, dtype=float)
        mean = np.full(size, mean) if mean.ndim == 0 else mean
        covariance = np.asarray(covariance, dtype=float)
        covariance = covariance * np.eye(size) if covariance.ndim == 0 else covariance
        # A Gaussian is the mixture of one component: one piece of linear algebra serves both.
        self.mixture = GaussianMixture([1.0], mean[None], covariance[None], shape, dtype)
        self.shape = self.mixture.shape
        self.complex_valued = self.mixture.complex_valued
        self.perturbation = "gaussian"

    @property
    def mean(self) -> jax.Array:
        """Mean of the real view, (n,)."""
        return self.mixture.means[0]

    @property
    def covariance(self) -> jax.Array:
        """Covariance of the real view, (n, n)."""
        vectors = self.mixture.eigenvectors[0]
        return (vectors * self.mixture.variances[0]) @ vectors.T

    @property
    def scale(self) -> jax.Array:
        """Root mean square deviation per real component."""
        return jnp.sqrt(self.mixture.variances.mean())

    def sample(self, key: jax.Array) -> jax.Array:
        """One object."""
        return self.mixture.sample(key)

    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Log-density of object + annealing error at `x`; exact."""
        return self.mixture.log_prob(x, sigma)
