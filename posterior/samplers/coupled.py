"""Moves under the exact likelihood of an image that is tied to another by a normal coupling."""

import jax
import jax.numpy as jnp

from ..models.annealing import component_sd
from ..models.optics import Identity
from ..models.realview import normal_like, real_score, real_size
from ..problem import Posterior

# Longest drift of a proposal, in standard deviations of its noise.
_LONGEST_DRIFT = 2.0


def coupled_moves(
    key: jax.Array,
    posterior: Posterior,
    u: jax.Array,
    x: jax.Array,
    rho: jax.Array,
    moves: int,
    step_size: float,
) -> tuple[jax.Array, jax.Array]:
    """u after `moves` MALA steps on p(y | u) N(u; x, rho^2), and their mean acceptance.

    `rho` is an annealing level: rho/2 per real component of complex objects. `step_size` is in
    units of the curvature of both factors. Under Identity optics each pixel has a Metropolis test
    of its own; under others the image has one, and the step shrinks as n^(-1/3) with its n real
    dimensions (Roberts and Rosenthal 1998).
    """
    likelihood, y = posterior.likelihood, posterior.y
    complex_object = jnp.iscomplexobj(x)
    variance = component_sd(rho, complex_object) ** 2
    pixelwise = isinstance(likelihood.optics, Identity)
    # One log-density a pixel where the pixels are independent, one in all otherwise.
    gather = (lambda a: a) if pixelwise else jnp.sum
    curvature = likelihood.curvature(complex_object, y, 0.0, "convolved")
    h = step_size / (1 / variance + curvature)
    if not pixelwise:
        h = h * real_size(x.shape, x.dtype) ** (-1 / 3)
    h = h.astype(variance.dtype)

    def evaluate(u: jax.Array) -> tuple[jax.Array, jax.Array]:
        def log_prob(u: jax.Array) -> tuple[jax.Array, jax.Array]:
            recorded = likelihood.camera.log_prob(y, likelihood.expected(u))
            coupled = _square(u - x) / (2 * variance)
            values = gather(recorded) - gather(coupled)
            return jnp.sum(values), values

        (_, values), gradient = jax.value_and_grad(log_prob, has_aux=True)(u)
        return values, _drift(real_score(gradient), h)

    def move(carry: tuple, key: jax.Array) -> tuple[tuple, jax.Array]:
        u, value, drift = carry
        key_noise, key_accept = jax.random.split(key)
        noise = normal_like(key_noise, u)
        proposed = u + (drift + jnp.sqrt(2 * h) * noise).astype(u.dtype)
        new_value, new_drift = evaluate(proposed)
        back = (u - proposed - new_drift) / jnp.sqrt(2 * h)
        log_ratio = new_value - value + gather(_square(noise) - _square(back)) / 2
        # A NaN ratio (a proposal where the density is undefined) is a rejection.
        rate = jnp.where(jnp.isnan(log_ratio), 0.0, jnp.exp(jnp.minimum(log_ratio, 0.0)))
        accepted = jax.random.uniform(key_accept, rate.shape, rate.dtype) < rate
        new = (proposed, new_value, new_drift)
        carry = tuple(jnp.where(accepted, a, b) for a, b in zip(new, carry))
        return carry, jnp.mean(rate)

    keys = jax.random.split(key, moves)
    (u, _, _), rates = jax.lax.scan(move, (u, *evaluate(u)), keys)
    return u, jnp.mean(rates)


def _drift(score: jax.Array, h: jax.Array) -> jax.Array:
    """h score, cut at a few standard deviations of the noise (Roberts and Tweedie 1996).

    Photon counts have a score without bound in the dark, where uncut proposals are all refused.
    """
    drift = h * score
    return drift / jnp.maximum(1.0, jnp.abs(drift) / (_LONGEST_DRIFT * jnp.sqrt(2 * h)))


def _square(x: jax.Array) -> jax.Array:
    return jnp.square(x.real) + jnp.square(x.imag) if jnp.iscomplexobj(x) else jnp.square(x)
