"""Do the draws explain the recording? A posterior of the wrong microscope is sure of itself too."""

import jax
import jax.numpy as jnp
import numpy as np

from ..models.likelihood import Likelihood


def misfit(likelihood: Likelihood, y: np.ndarray, draws: np.ndarray) -> float:
    """Squared residuals of the recording over the variance of its noise: 1 where all is right.

    `draws` (draws, *shape) of the posterior given `y`. The sum over pixels of (y - E[y | draw])^2,
    over the sum of the variances of y given the draw, averaged over draws: a posterior predictive
    check (Gelman, Meng and Stern 1996) whose expectation is 1, for draws and truth are
    exchangeable. Above it where the optics, the noise or the prior are not what they were; an error
    of the optics that the object can absorb is not seen. Left out, by what is expected there and
    not by what was recorded, are pixels within 4 sd of the full well, and those whose noise is
    below the ADC's; nan if none is left.
    """
    return float(np.mean([_misfit_of(likelihood, jnp.asarray(y), jnp.asarray(o)) for o in draws]))


@jax.jit
def _misfit_of(likelihood: Likelihood, y: jax.Array, o: jax.Array) -> jax.Array:
    camera, expected = likelihood.camera, likelihood.expected(o)
    light = jnp.maximum(expected.real, 0.0) if camera.counting else jnp.zeros(y.shape)
    parts = 2 if jnp.iscomplexobj(expected) else 1
    variance = parts * (camera.sigma0**2 * light + camera.read_variance)
    seen = (variance >= 2 * camera.adc_variance) & (
        light + 4 * jnp.sqrt(variance) < camera.saturation
    )
    residual = jnp.abs(y - expected) ** 2
    return jnp.sum(jnp.where(seen, residual, 0.0)) / jnp.sum(jnp.where(seen, variance, 0.0))
