"""The posterior mean of a picture under Gaussian noise, straight from the prior's score.

Miyasawa's and Tweedie's formula: a picture with Gaussian noise is the annealed variable itself, at
the level of that noise, so E[x | y] = y + s^2 score(y), s^2 the variance per real component.
With a network it is the MMSE denoiser that the paper compares with; draws must average to it.
"""

import jax
import jax.numpy as jnp

from ..models.camera import Gaussian
from ..models.likelihood import LinearLikelihood
from ..models.optics import Identity
from ..problem import Posterior


def mmse(posterior: Posterior) -> jax.Array:
    """E[x | y], shape and dtype of the object, for y = x + Gaussian noise.

    Exact for an analytic prior, and as good as its network for a learned one. The noise has the
    camera's sigma per real component, the level 2 sigma for a complex object (eq:part_complex).
    Raises ValueError for other optics, other cameras, or a prior with another perturbation.
    """
    likelihood, prior = posterior.likelihood, posterior.prior
    if not (isinstance(likelihood, LinearLikelihood) and isinstance(likelihood.optics, Identity)):
        raise ValueError(
            "the MMSE estimate is for the picture itself: use LinearLikelihood with Identity "
            "optics, or the mean of draws"
        )
    if not isinstance(likelihood.camera, Gaussian):
        raise ValueError(
            f"camera {type(likelihood.camera).__name__}: the MMSE estimate is for Gaussian noise, "
            "use the mean of draws"
        )
    if prior.perturbation != "gaussian":
        raise ValueError(
            f"the prior has the {prior.perturbation!r} perturbation: give one with the gaussian"
        )
    sigma = likelihood.camera.sigma
    y = posterior.y.astype(prior.dtype)
    level = jnp.asarray(2 * sigma if prior.complex_valued else sigma, y.real.dtype)
    return y + sigma**2 * prior.score(y, level)
