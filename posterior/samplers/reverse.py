"""Reverse diffusion: from the annealed object back to the object, by the prior's score alone."""

import jax
import jax.numpy as jnp
import numpy as np

from ..models.annealing import component_sd
from ..models.priors.base import Prior
from ..models.realview import normal_like


def reverse_diffusion(
    key: jax.Array, prior: Prior, x: jax.Array, sigma: jax.Array, steps: int
) -> jax.Array:
    """A draw of the object given the annealed `x` at level `sigma`, in so many steps; like `x`."""
    levels = reverse_levels(prior, sigma, steps)

    def advance(x: jax.Array, args: tuple) -> tuple[jax.Array, None]:
        return reverse_step(args[0], prior, x, args[1], args[2]), None

    keys = jax.random.split(key, steps)
    return jax.lax.scan(advance, x, (keys, levels[:-1], levels[1:]))[0]


def reverse_levels(prior: Prior, sigma: jax.Array, steps: int) -> jax.Array:
    """The levels (steps + 1,) from `sigma` to 0; none between the prior's finest and 0."""
    # A range of as many times as there are steps has about the least error on Gaussians.
    fractions = np.geomspace(1.0, 1 / steps, steps)
    levels = jnp.maximum(sigma * fractions.astype(sigma.dtype), jnp.minimum(sigma, prior.finest))
    return jnp.append(levels, 0.0).astype(sigma.dtype)


def reverse_step(
    key: jax.Array, prior: Prior, x: jax.Array, sigma: jax.Array, following: jax.Array
) -> jax.Array:
    """The annealed object at level `following`, drawn given `x` at level `sigma`; shaped as `x`.

    The annealing error is a Brownian motion in s^2, so that, with s and t the two levels and the
    object x_0 known too, x_t is normal about x_0 + (t/s)^2 (x - x_0) with variance
    t^2 (1 - (t/s)^2). Over the unknown x_0, of mean D(x) and covariance s^2 J, J the Jacobian of D
    (Tweedie's second order), the mean is x + (s^2 - t^2) score and the covariance
    (s^2 - t^2) (q^2 + (1 - q^2) J), q = t/s. Noise sqrt(s^2 - t^2) (q + (1 - q) J) n has it where
    J has eigenvalues 0 or 1, with an error of third order in 1 - q between; J n is a difference of
    two evaluations. Without it a pixel that the prior leaves free loses a third of its variance in
    eight steps. `following` = 0 gives D(x) + s J n.
    """
    q = following / sigma
    noise = component_sd(sigma, jnp.iscomplexobj(x)) * normal_like(key, x)
    clean = prior.denoise(x, sigma)
    # A network need not have a forward derivative: a difference over a tenth of the noise.
    spread = 10 * (prior.denoise(x + (0.1 * noise).astype(x.dtype), sigma) - clean)
    mean = clean + q**2 * (x - clean)
    return (mean + jnp.sqrt(1 - q**2) * (q * noise + (1 - q) * spread)).astype(x.dtype)
