"""How bright the light is: chosen for a simulation, inferred from a recording."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from ..models.camera import Poisson
from ..models.optics import Fourier, Optics
from ..models.priors import GaussianField, Prior
from ..models.priors.learned import LearnedPrior

_HEADROOM = 4  # standard deviations of photon noise below the full well


def full_exposure(brightest: float, camera: Poisson) -> float:
    """Irradiance at which the brightest pixel (at irradiance 1) is expected just below full."""
    # e + k sigma0 sqrt(e) = 1 is quadratic in sqrt(e).
    half = _HEADROOM * camera.sigma0 / 2
    return (math.sqrt(half**2 + 1) - half) ** 2 / brightest


def irradiance_of(y: np.ndarray, optics: Optics, prior: Prior) -> float:
    """The energy of the data over the energy expected of the prior at irradiance 1."""
    total = float(np.sum(y, dtype=float))
    if total <= 0:
        raise ValueError("the recording is dark everywhere: there is nothing to reconstruct from")
    if isinstance(optics, Fourier) and isinstance(prior, GaussianField | LearnedPrior):
        return total / _mean_energy(prior)
    draws = jax.vmap(prior.sample)(jax.random.split(jax.random.key(0), 64))
    energy = jnp.sum(jnp.abs(jax.vmap(optics)(draws)) ** 2) / len(draws)
    return total / float(energy)


def _mean_energy(prior: GaussianField | LearnedPrior) -> float:
    """Expected sum of |object|^2."""
    channels = 2 if prior.complex_valued else 1
    if isinstance(prior, LearnedPrior):
        per_pixel = channels * (prior.statistics.mean**2 + prior.statistics.sd**2)
        return math.prod(prior.shape) * per_pixel
    return float(jnp.sum(jnp.abs(prior.mean) ** 2 + channels * prior.scale**2))


def prior_scale(o: np.ndarray, prior: GaussianField | LearnedPrior) -> float:
    """By what to multiply an object (*shape), so that its energy is the mean of the prior's."""
    return (_mean_energy(prior) / float(np.sum(np.abs(o) ** 2, dtype=float))) ** 0.5
