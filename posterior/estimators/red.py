"""Regularisation by denoising: a picture that fits its recording and that a denoiser leaves alone.

Romano, Elad and Milanfar, SIAM J. Imaging Sciences 10, 1804 (2017), by proximal gradients (Reehorst
and Schniter, IEEE Trans. Computational Imaging 5, 52, 2019). With the denoiser E[x | x + noise] of
a prior and the weight 1 / noise variance, it is the maximum of the posterior whose prior is blurred
by that noise: the regulariser's gradient, weight (x - D(x)), is minus the score there.
"""

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
    """The picture that `red` found, shaped as the object, and its last `change`.

    `change`: norm of the last step over that of the picture; what is large has not converged.
    """

    object: jax.Array
    change: jax.Array


def red(
    posterior: Posterior, level: float, weight: float | None = None, iterations: int = 300
) -> Regularised:
    """A picture where -d log p(y | x)/dx + `weight` (x - D(x)) = 0, D the prior's denoiser.

    - `posterior`: of the picture itself (`LinearLikelihood` with `Identity`) under a prior of the
      gaussian perturbation. Counts are those of a Poisson camera; where the ADC or the full well
      hides the count, the least possible one is taken. Other noise must be `Gaussian`.
    - `level`: annealing level of the denoiser, units of the picture.
    - `weight`: of the regulariser; None: 1 / noise variance of the level.

    Each of `iterations` denoises, then weighs what came out against the recording in closed form:
    one compiled computation. It converges for denoisers that do not expand; `change` tells. Raises
    ValueError for other optics, cameras and perturbations, and for numbers that are not positive.
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
    for name, value in (("level", level), ("weight", weight), ("iterations", iterations)):
        if value is not None and not value > 0:
            raise ValueError(f"{name} {value}: give a positive number")
    if weight is None:
        weight = 1 / component_sd(level, prior.complex_valued) ** 2
    real = posterior.y.real.dtype
    return _iterated(posterior, jnp.asarray(level, real), jnp.asarray(weight, real), iterations)


@eqx.filter_jit
def _iterated(
    posterior: Posterior, level: jax.Array, weight: jax.Array, iterations: int
) -> Regularised:
    camera, y = posterior.likelihood.camera, posterior.y

    def one(x: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        new = _explained(camera, y, posterior.prior.denoise(x, level), weight)
        size = jnp.maximum(jnp.linalg.norm(new), jnp.finfo(weight.dtype).tiny)
        return new, jnp.linalg.norm(new - x) / size

    x, changes = jax.lax.scan(one, y.astype(posterior.dtype), length=iterations)
    return Regularised(x, changes[-1])


def _explained(camera: Camera, y: jax.Array, v: jax.Array, weight: jax.Array) -> jax.Array:
    """The x with the least -log p(y | x) + weight |x - v|^2 / 2."""
    if isinstance(camera, Gaussian):
        precision = 1 / camera.sigma**2
        return (precision * y + weight * v) / (precision + weight)
    counts, _ = camera.electrons_between(y)
    # The positive root of weight x^2 - (weight v - full well) x - counts = 0.
    half = (v - camera.full_well / weight) / 2
    root = jnp.sqrt(half**2 + counts / weight)
    # The same number twice: each form loses its digits where the other is taken.
    return jnp.where(half > 0, half + root, counts / weight / jnp.maximum(root - half, _TINY))
