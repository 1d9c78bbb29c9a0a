"""Mixture of Gaussians: multimodal, and exact at every annealing level."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..realview import real_size
from .base import Prior, check_finite, checked_shape, is_complex_kind


class GaussianMixture(Prior):
    """Mixture of K Gaussians over the real view of an object.

    Convolved with the annealing error, a mixture is again one, with s^2 I added to every
    covariance (s: sd per real component), so log-density and score are exact at every sigma.

    Parameters: `weights` (K,), positive, normalised here; `means` (K, n); `covariances` (K, n, n),
    symmetric and positive semi-definite, or (K,), variances of isotropic components, whose cost
    grows with n and not with n^2; n = size of `shape`, doubled for `dtype=complex`. A singular
    covariance has a density only at sigma > 0. Raises ValueError on anything else.
    """

    log_weights: jax.Array
    means: jax.Array
    eigenvectors: jax.Array | None
    variances: jax.Array
    shape: tuple[int, ...] = eqx.field(static=True)
    complex_valued: bool = eqx.field(static=True)
    perturbation: str = eqx.field(static=True, default="gaussian")

    def __init__(
        self,
        weights: np.ndarray,
        means: np.ndarray,
        covariances: np.ndarray,
        shape: tuple[int, ...],
        dtype: type = float,
    ):
        self.shape = checked_shape(shape)
        self.complex_valued = is_complex_kind(dtype)
        self.perturbation = "gaussian"
        weights, means, covariances = (
            np.asarray(a, dtype=float) for a in (weights, means, covariances)
        )
        check_finite(weights=weights, means=means, covariances=covariances)
        n = real_size(self.shape, np.dtype(dtype))
        _check_shapes(weights, means, covariances, n)
        if covariances.ndim == 1:
            variances, vectors = covariances[:, None], None
            _check_semidefinite(covariances[:, None, None], variances)
        else:
            variances, vectors = np.linalg.eigh(covariances)
            _check_semidefinite(covariances, variances)
        self.log_weights = jnp.asarray(np.log(weights / weights.sum()))
        self.means = jnp.asarray(means)
        self.eigenvectors = None if vectors is None else jnp.asarray(vectors)
        self.variances = jnp.asarray(np.maximum(variances, 0.0))

    @property
    def scale(self) -> jax.Array:
        """Root mean square deviation per real component, spread of the means included."""
        weights = jnp.exp(self.log_weights)
        centre = weights @ self.means
        within = weights @ jnp.mean(self.variances, axis=1)
        between = weights @ jnp.mean((self.means - centre) ** 2, axis=1)
        return jnp.sqrt(within + between)

    def sample(self, key: jax.Array) -> jax.Array:
        """One object: a component by weight, then a normal draw of it."""
        key_component, key_normal = jax.random.split(key)
        k = jax.random.categorical(key_component, self.log_weights)
        noise = jax.random.normal(key_normal, self.means.shape[1:], self.means.dtype)
        noise = jnp.sqrt(self.variances[k]) * noise
        rotated = noise if self.eigenvectors is None else self.eigenvectors[k] @ noise
        return self._to_object(self.means[k] + rotated)

    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Log-density of object + annealing error at `x`; exact."""
        variances = self.variances + self._component_sd(sigma) ** 2
        v = self._to_vector(x)
        if self.eigenvectors is None:
            scatter = _squared_distances(v, self.means) / variances[:, 0]
            volume = v.size * jnp.log(2 * jnp.pi * variances[:, 0])
        else:
            whitened = jnp.einsum("kij,ki->kj", self.eigenvectors, v - self.means)
            scatter = jnp.sum(whitened**2 / variances, axis=1)
            volume = jnp.sum(jnp.log(2 * jnp.pi * variances), axis=1)
        return jax.nn.logsumexp(self.log_weights - 0.5 * (scatter + volume))


def _squared_distances(v: jax.Array, means: jax.Array) -> jax.Array:
    """|v - means|^2, (K,), by products with a matrix, which batches of objects share.

    About the nearest of the means, so that none of the distances that matter is a difference of
    large numbers.
    """
    norms = jnp.sum(means**2, axis=1)
    nearest = jax.lax.stop_gradient(jnp.argmin(norms - 2 * means @ v))
    rest = v - means[nearest]
    across = means @ rest
    between = jnp.sum((means[:, None] - means) ** 2, axis=2)[nearest]
    return rest @ rest - 2 * (across - across[nearest]) + between


def _check_shapes(weights: np.ndarray, means: np.ndarray, covariances: np.ndarray, n: int) -> None:
    k = weights.size
    if weights.ndim != 1 or k == 0 or not np.all(weights > 0):
        raise ValueError(f"weights {weights.tolist()}: give a list of positive numbers")
    if means.shape != (k, n):
        raise ValueError(
            f"means of shape {means.shape}: this object wants ({k}, {n}), "
            "a row for each weight in the real view (Re then Im for complex objects)"
        )
    if covariances.shape not in ((k,), (k, n, n)):
        raise ValueError(
            f"covariances of shape {covariances.shape}: expected ({k}, {n}, {n}), or ({k},)"
        )


def _check_semidefinite(covariances: np.ndarray, variances: np.ndarray) -> None:
    scale = np.abs(covariances).max()
    asymmetry = np.abs(covariances - np.swapaxes(covariances, -1, -2)).max()
    if asymmetry > 1e-5 * scale:
        raise ValueError(f"covariance is not symmetric (largest difference {asymmetry:.3g})")
    if variances.min() < -1e-5 * scale:
        raise ValueError(
            f"covariance has the negative eigenvalue {variances.min():.3g}: "
            "it must be positive semi-definite"
        )
