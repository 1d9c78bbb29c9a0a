"""The posterior mean of a picture under Gaussian noise or counting, straight from the prior.

A picture with Gaussian noise is the annealed variable itself, at the level of that noise, so
E[x | y] = y + s^2 score(y), s^2 the variance per real component (Miyasawa, Tweedie). Counts are
that of the poisson perturbation, whose prior is its denoiser. With a network it is the MMSE
denoiser that the paper compares with; draws must average to it.
"""

import jax
import jax.numpy as jnp

from ..models.camera import Gaussian, Poisson
from ..models.likelihood import LinearLikelihood
from ..models.optics import Identity
from ..problem import Posterior


def mmse(posterior: Posterior) -> jax.Array:
    """E[x | y], shape and dtype of the object, for y = x + Gaussian noise, or counts of x.

    Exact for an analytic prior, and as good as its network for a learned one. Gaussian noise has
    the camera's sigma per real component, the level 2 sigma for a complex object (eq:part_complex).
    Counts need a Poisson camera and a prior with the poisson perturbation. Of an ADC's code that
    hides counts the middle one is taken; at the full well the least, where the estimate is too
    dark.
    Raises ValueError for other optics, other cameras, or a prior with another perturbation.
    """
    likelihood, prior = posterior.likelihood, posterior.prior
    if not (isinstance(likelihood, LinearLikelihood) and isinstance(likelihood.optics, Identity)):
        raise ValueError(
            "the MMSE estimate is for the picture itself: use LinearLikelihood with Identity "
            "optics, or the mean of draws"
        )
    needed = {Gaussian: "gaussian", Poisson: "poisson"}.get(type(likelihood.camera))
    if needed is None:
        raise ValueError(
            f"camera {type(likelihood.camera).__name__}: the MMSE estimate is for Gaussian noise "
            "or counts (Gaussian, Poisson), use the mean of draws"
        )
    if prior.perturbation != needed:
        raise ValueError(
            f"the prior has the {prior.perturbation!r} perturbation: give one with the {needed}"
        )
    if needed == "poisson":
        sigma = likelihood.camera.sigma0
        least, most = likelihood.camera.electrons_between(posterior.y.astype(prior.dtype))
        counts = jnp.where(jnp.isinf(most), least, (least + most) / 2)
        return prior.denoise(counts * sigma**2, sigma)
    sigma = likelihood.camera.sigma
    y = posterior.y.astype(prior.dtype)
    level = jnp.asarray(2 * sigma if prior.complex_valued else sigma, y.real.dtype)
    return prior.denoise(y, level)
