"""How far a score is from a gradient, and what its line integral is worth.

Along a straight line the integral of a gradient is the difference of the log-densities at its ends,
which is what a Metropolis test needs of a prior without a density. For a score network it depends
on the path; a loop shows by how much: round a closed path a gradient integrates to zero.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..realview import normal_like, to_real
from .base import Prior

_NODES = 8


class LoopCheck(NamedTuple):
    """`loop`: root mean square integral round a triangle, in nats, what a Metropolis test would be
    wrong by; `leg`: the same along one side; `asymmetry`: |J - J'| / |J + J'| (Frobenius), J the
    Jacobian of the score in the real view: 0 for a gradient, 1 for a matrix of independent entries.
    """

    loop: float
    leg: float
    asymmetry: float


def line_integral(
    prior: Prior, start: jax.Array, end: jax.Array, sigma: jax.Array | float, nodes: int = _NODES
) -> jax.Array:
    """Integral of the score from `start` to `end` (objects), by Gauss-Legendre with `nodes`.

    log p(end) - log p(start) at level `sigma`, if the score is a gradient; a real scalar.
    """
    points, weights = np.polynomial.legendre.leggauss(nodes)
    way = end - start

    def along(t: jax.Array) -> jax.Array:
        score = prior.score((start + t * way).astype(start.dtype), sigma)
        return jnp.sum(to_real(score) * to_real(way))

    values = jax.lax.map(along, jnp.asarray((1 + points) / 2, start.real.dtype))
    return jnp.sum(values * jnp.asarray(weights, values.dtype)) / 2


def loop_check(
    prior: Prior,
    key: jax.Array,
    sigma: jax.Array | float,
    start: jax.Array | None = None,
    size: float = 0.3,
    loops: int = 8,
) -> LoopCheck:
    """Measure loops and Jacobian near `start` (an object; None: draws of the prior, annealed).

    The sides of the triangles are random, of standard deviation `size` times the level's error in
    every pixel, about what a Metropolis step covers.
    """

    def one(key: jax.Array) -> tuple[jax.Array, ...]:
        keys = jax.random.split(key, 4)
        x = prior.sample(keys[0]) if start is None else jnp.asarray(start)
        step = jnp.asarray(sigma, x.real.dtype) / (2 if prior.complex_valued else 1)
        x = x + step * normal_like(keys[1], x)
        u, v = (normal_like(k, x) for k in keys[2:])
        a, b = x + size * step * u, x + size * step * v
        sides = jnp.stack([x, a, b]), jnp.stack([a, b, x])
        legs = jax.lax.map(lambda side: line_integral(prior, *side, sigma), sides)
        forward = _product(prior, x, sigma, v, u)
        backward = _product(prior, x, sigma, u, v)
        return legs[0], jnp.sum(legs), forward - backward, forward + backward

    legs, sums, odd, even = jax.lax.map(jax.jit(one), jax.random.split(key, loops))

    def size_of(values: jax.Array) -> float:
        return float(jnp.sqrt(jnp.mean(jnp.square(values))))

    return LoopCheck(size_of(sums), size_of(legs), size_of(odd) / max(size_of(even), 1e-30))


def require_gradient(
    prior: Prior, key: jax.Array, sigma: jax.Array | float, nats: float = 0.1, **options: object
) -> LoopCheck:
    """The check of `loop_check`; raises ValueError if a loop integrates to more than `nats`."""
    found = loop_check(prior, key, sigma, **options)
    if not found.loop <= nats:
        raise ValueError(
            f"at level {float(sigma):.3g} this score integrates to {found.loop:.3g} nats round a "
            f"loop, more than {nats:.3g}: it is not the gradient of a density, use an EnergyPrior "
            "where a Metropolis test decides"
        )
    return found


def _product(
    prior: Prior, x: jax.Array, sigma: jax.Array | float, left: jax.Array, right: jax.Array
) -> jax.Array:
    """left' J right, J the Jacobian of the score at x; by reverse mode, which every layer has."""

    def along(x: jax.Array) -> jax.Array:
        return jnp.sum(to_real(prior.score(x, sigma)) * to_real(left))

    return jnp.sum(to_real(jnp.conj(jax.grad(along)(x))) * to_real(right))
