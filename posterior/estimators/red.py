"""Regularisation by denoising: a picture that fits its recording and that a denoiser leaves alone.

Romano, Elad and Milanfar, SIAM J. Imaging Sciences 10, 1804 (2017), by proximal gradients (Reehorst
and Schniter, IEEE Trans. Computational Imaging 5, 52, 2019). With the denoiser E[x | x + noise] of
a prior and the weight 1 / noise variance, the regulariser's gradient, weight (x - D(x)), is minus
the score of the prior blurred by that noise: what is found is stationary under the posterior with
this prior, and its maximum where it has but one.
"""

import math
import operator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.annealing import component_sd
from ..models.camera import Camera, Gaussian, Poisson
from ..models.likelihood import LinearLikelihood
from ..models.optics import Identity
from ..problem import Posterior

_TINY = float(jnp.finfo(jnp.float32).tiny)


class Regularised(NamedTuple):
    """The picture that `red` found, shaped as the object, and how far it is from an end.

    `imbalance`: norm of the force that is left, over that of the recording alone; 0 at the end, and
    near 1 or above where the iterations have hardly left the recording.
    """

    object: jax.Array
    imbalance: jax.Array


def red(
    posterior: Posterior, level: float, weight: float | None = None, iterations: int = 300
) -> Regularised:
    """A picture where -d log p(y | x)/dx + `weight` (x - D(x)) = 0, D the prior's denoiser.

    - `posterior`: of the picture itself (`LinearLikelihood` with `Identity`) under a prior of the
      gaussian perturbation. Noise is `Gaussian`, or counts of a Poisson camera: where the ADC hides
      the count, the middle of its code is taken for it, and where the full well does, the full well
      (too dark).
    - `level`: annealing level of the denoiser, units of the picture.
    - `weight`: of the regulariser; None: 1 / noise variance of the level.

    Each of `iterations` denoises, then weighs what came out against the recording in closed form:
    one compiled computation, from the recording. Where the level is far below the noise it is slow;
    it converges if the denoiser's derivative is symmetric and between 0 and 1, as that of an exact
    one that does not expand. `imbalance` tells. Raises ValueError for other optics, cameras and
    perturbations, and for numbers that are not positive and finite.
    """
    likelihood, prior = posterior.likelihood, posterior.prior
    if not (isinstance(likelihood, LinearLikelihood) and isinstance(likelihood.optics, Identity)):
        raise ValueError(
            "regularisation by denoising is for the picture itself here: use LinearLikelihood with "
            "Identity optics, or maximum_posterior"
        )
    if not isinstance(likelihood.camera, (Gaussian, Poisson)):
        raise ValueError(
            f"camera {type(likelihood.camera).__name__}: regularisation by denoising is for "
            "Gaussian noise or counts (Gaussian, Poisson), use maximum_posterior"
        )
    if prior.perturbation != "gaussian":
        raise ValueError(
            f"the prior has the {prior.perturbation!r} perturbation: give one with the gaussian"
        )
    level = positive("level", level)
    if weight is None:
        weight = 1 / component_sd(level, prior.complex_valued) ** 2
    weight = positive("weight", weight)
    if operator.index(iterations) < 1:
        raise ValueError(f"iterations {iterations}: give a whole number, 1 or more")
    real = posterior.y.real.dtype
    return _iterated(posterior, jnp.asarray(level, real), jnp.asarray(weight, real), iterations)


def positive(name: str, value: float) -> float:
    """The number, if single precision holds it and its square."""
    value = float(value)
    if not math.sqrt(_TINY) < value < 1 / math.sqrt(_TINY):
        raise ValueError(f"{name} {value}: give a positive number, neither inf nor nearly nothing")
    return value


@eqx.filter_jit
def _iterated(
    posterior: Posterior, level: jax.Array, weight: jax.Array, iterations: int
) -> Regularised:
    camera, y = posterior.likelihood.camera, posterior.y

    def one(clean: jax.Array, _: None) -> tuple[jax.Array, None]:
        x = _explained(camera, y, clean, weight)
        return posterior.prior.denoise(x, level), None

    first = posterior.prior.denoise(y.astype(posterior.dtype), level)
    clean, _ = jax.lax.scan(one, first, length=iterations - 1)
    x = _explained(camera, y, clean, weight)
    # The recording pulls by weight (x - clean) there, the denoiser by weight (D(x) - x).
    left = jnp.linalg.norm(posterior.prior.denoise(x, level) - clean)
    return Regularised(x, left / jnp.maximum(jnp.linalg.norm(x - clean), _TINY))


def _explained(camera: Camera, y: jax.Array, v: jax.Array, weight: jax.Array) -> jax.Array:
    """The x with the least -log p(y | x) + weight |x - v|^2 / 2."""
    if isinstance(camera, Gaussian):
        precision = 1 / camera.sigma**2
        return (precision * y + weight * v) / (precision + weight)
    low, high = camera.electrons_between(y)
    counts = jnp.where(jnp.isfinite(high), (low + high) / 2, low)
    # The positive root of weight x^2 - (weight v - full well) x - counts = 0.
    half = (v - camera.full_well / weight) / 2
    root = jnp.hypot(half, jnp.sqrt(counts / weight))
    # The same number twice: each form loses its digits where the other is taken.
    return jnp.where(half > 0, half + root, counts / weight / jnp.maximum(root - half, _TINY))
