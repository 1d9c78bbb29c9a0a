"""Do the draws explain the recording? A posterior of the wrong microscope is sure of itself too."""

import jax
import jax.numpy as jnp
import numpy as np

from ..models.likelihood import Likelihood


def misfit(likelihood: Likelihood, y: np.ndarray, draws: np.ndarray) -> float:
    """Squared residuals of the recording over the variance of its noise: 1 where all is right.

    `draws` (draws, *shape) of the posterior given `y`. The sum over all pixels below the full well
    of (y - E[y | draw])^2, over the sum of the variances of y given the draw, averaged over draws:
    a posterior predictive check (Gelman, Meng and Stern 1996) whose expectation is 1, for draws and
    truth are exchangeable. Above it where the optics, the noise or the prior are not what they
    were; optimism about many pixels at once is not seen. An error of the optics that the object
    can absorb is not either.
    """
    return float(np.mean([_misfit_of(likelihood, jnp.asarray(y), jnp.asarray(o)) for o in draws]))


@jax.jit
def _misfit_of(likelihood: Likelihood, y: jax.Array, o: jax.Array) -> jax.Array:
    camera, expected = likelihood.camera, likelihood.expected(o)
    seen = y < camera.saturation if camera.counting else jnp.ones(y.shape, bool)
    light = jnp.maximum(expected.real, 0.0) if camera.counting else jnp.zeros(y.shape)
    parts = 2 if jnp.iscomplexobj(expected) else 1
    variance = parts * (camera.sigma0**2 * light + camera.read_variance)
    residual = jnp.abs(y - expected) ** 2
    return jnp.sum(jnp.where(seen, residual, 0.0)) / jnp.sum(jnp.where(seen, variance, 0.0))
