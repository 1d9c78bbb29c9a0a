"""Do the draws explain the recording? A posterior of the wrong microscope is sure of itself too."""

import jax
import jax.numpy as jnp
import numpy as np

from ..models.likelihood import Likelihood
from .ranks import randomised_ranks


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


def predicted(likelihood: Likelihood, draws: np.ndarray, key: jax.Array) -> np.ndarray:
    """A recording (L, *data_shape) of each of the draws (L, *shape): the posterior predictive."""
    keys = jax.random.split(key, len(draws))
    return np.asarray(_recorded(likelihood, jnp.asarray(draws), keys))


def predictive_ranks(
    likelihood: Likelihood, second: np.ndarray, draws: np.ndarray, key: jax.Array
) -> np.ndarray:
    """Where each pixel of a second exposure lies among those that the draws predict, in (0, 1).

    `draws` (L, *shape) of the posterior given the first exposure; `second`, of the likelihood's
    data shape, of the same object under the same optics and camera. If object and noise are as
    believed each rank is uniform: the probability integral transform of counts, made continuous at
    random (Czado, Gneiting and Held 2009). Pixels share the draws: test one a recording
    (`uniformity`), or their share in the tails by image. Ranks of the first exposure itself crowd
    in the middle, for the draws have seen it. Complex recordings have no ranks: raises ValueError.
    """
    key_predicted, key_ties = jax.random.split(key)
    others = predicted(likelihood, draws, key_predicted)
    seed = np.asarray(jax.random.key_data(key_ties))
    return randomised_ranks(np.asarray(second)[None], others[None], np.random.default_rng(seed))[0]


@jax.jit
def _recorded(likelihood: Likelihood, draws: jax.Array, keys: jax.Array) -> jax.Array:
    return jax.vmap(likelihood.simulate)(keys, draws)


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
