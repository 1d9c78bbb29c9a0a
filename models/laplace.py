"""Independent draws of a posterior under a mixture prior, by importance from Laplace's normals."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from .likelihood import Likelihood
from .priors import GaussianMixture
from .realview import from_real

_NEWTON, _PART = 15, 250
_FRACTIONS = 2.0 ** -jnp.arange(6)


class Weighted(NamedTuple):
    """Proposed objects (n, *shape) and their log-weights (n,), up to a constant."""

    objects: jax.Array
    log_weights: jax.Array

    def effective(self) -> jax.Array:
        """How many draws they are worth, (sum w)^2 / sum w^2 (Kong 1992)."""
        w = jax.nn.softmax(self.log_weights)
        return 1 / jnp.sum(w**2)

    def resampled(self, key: jax.Array, count: int) -> jax.Array:
        """`count` of them (count, *shape) by their weights, with replacement.

        NaN where no proposal has any weight.
        """
        w = jax.nn.softmax(self.log_weights)
        chosen = self.objects[jax.random.choice(key, len(w), (count,), p=w)]
        return jnp.where(jnp.isfinite(jax.nn.logsumexp(self.log_weights)), chosen, jnp.nan)


def laplace(
    key: jax.Array,
    likelihood: Likelihood,
    prior: GaussianMixture,
    y: jax.Array,
    count: int,
    freedom: float = 20.0,
    starts: int = 1,
) -> Weighted:
    """`count` proposals for the posterior of `y`, weighed by it.

    Of each component times the likelihood the maximum is sought by Newton's method, from the
    component's mean and `starts` - 1 draws of it. At every end stands a Student's t of `freedom`
    degrees with the curvature there, weighed by Laplace's evidence (Tierney and Kadane 1986); ends
    that coincide leave it exact, for the density of all is divided by. Exact as `count` grows; look
    at `effective`, which a posterior with more maxima than were found makes small, or misleads. For
    some ten unknowns to a hundred: Hessians are dense. Traceable.
    """
    shape, dtype = prior.shape, prior.dtype
    means = prior.means
    if prior.eigenvectors is None:
        vectors = jnp.broadcast_to(jnp.eye(means.shape[1]), (*means.shape, means.shape[1]))
    else:
        vectors = prior.eigenvectors
    variances = jnp.broadcast_to(prior.variances, means.shape)

    def component(k: jax.Array, v: jax.Array) -> jax.Array:
        """Log of weight times density of component k, times the likelihood."""
        scatter = jnp.sum((vectors[k].T @ (v - means[k])) ** 2 / variances[k])
        volume = jnp.sum(jnp.log(2 * jnp.pi * variances[k]))
        seen = likelihood.log_prob(from_real(v, shape, dtype), y)
        return prior.log_weights[k] - 0.5 * (scatter + volume) + seen

    def fitted(k: jax.Array, start: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Maximum, root of the covariance there, and Laplace's log-evidence."""

        def improve(v: jax.Array, _: None) -> tuple[jax.Array, None]:
            root = _covariance_root(jax.hessian(lambda v: component(k, v))(v), variances[k])
            step = root @ (root.T @ jax.grad(lambda v: component(k, v))(v))
            tried = v + _FRACTIONS[:, None].astype(v.dtype) * step
            values = jax.vmap(lambda v: component(k, v))(tried)
            best = jnp.argmax(jnp.where(jnp.isnan(values), -jnp.inf, values))
            return jnp.where(values[best] > component(k, v), tried[best], v), None

        v, _ = jax.lax.scan(improve, start, None, length=_NEWTON)
        root = _covariance_root(jax.hessian(lambda v: component(k, v))(v), variances[k])
        return v, root, component(k, v) + jnp.linalg.slogdet(root)[1]

    n = means.shape[1]
    key, key_starts = jax.random.split(key)
    away = jax.random.normal(key_starts, (starts, *means.shape), means.dtype)
    away = jnp.einsum("kij,skj->ski", vectors, jnp.sqrt(variances) * away.at[0].set(0.0))
    components = jnp.tile(jnp.arange(len(means)), starts)
    modes, roots, evidence = jax.vmap(fitted)(components, (means + away).reshape(-1, n))
    # A component that was not fitted proposes nothing.
    found = jnp.isfinite(evidence) & jnp.all(jnp.isfinite(roots), axis=(1, 2))
    modes = jnp.where(found[:, None], modes, 0.0)
    roots = jnp.where(found[:, None, None], roots, jnp.eye(means.shape[1], dtype=roots.dtype))
    evidence = jnp.where(found, evidence, -jnp.inf)
    inverses = jnp.linalg.inv(roots)
    volumes = jnp.linalg.slogdet(roots)[1]
    key_mode, key_normal, key_scale = jax.random.split(key, 3)
    chosen = jax.random.categorical(key_mode, evidence, shape=(count,))
    normal = jax.random.normal(key_normal, (count, n), means.dtype)
    scale = jnp.sqrt(freedom / (2 * jax.random.gamma(key_scale, freedom / 2, (count, 1))))
    proposed = modes[chosen] + jnp.einsum("cij,cj->ci", roots[chosen], normal) * scale

    def log_weight(v: jax.Array) -> jax.Array:
        distances = jnp.sum(jnp.einsum("kij,kj->ki", inverses, v - modes) ** 2, axis=1)
        # Student's t, without the constants that all share.
        log_t = -0.5 * (freedom + n) * jnp.log1p(distances / freedom) - volumes
        x = from_real(v, shape, dtype)
        target = prior.log_prob(x) + likelihood.log_prob(x, y)
        value = target - jax.nn.logsumexp(jax.nn.log_softmax(evidence) + log_t)
        return jnp.where(jnp.isnan(value), -jnp.inf, value)

    objects = jax.vmap(lambda v: from_real(v, shape, dtype))(proposed)
    # In parts: all at once, of many recordings, would not stay in the cache.
    return Weighted(objects, jax.lax.map(log_weight, proposed, batch_size=_PART))


def _covariance_root(hessian: jax.Array, variances: jax.Array) -> jax.Array:
    """R with R R^T the inverse of -hessian, where that is positive; else the prior's widest."""
    curvature, vectors = jnp.linalg.eigh(-(hessian + hessian.T) / 2)
    return vectors / jnp.sqrt(jnp.maximum(curvature, 1 / jnp.max(variances)))
