"""What a system of the phase-retrieval study is given."""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..estimators import hio
from ..models.camera import Poisson
from ..models.likelihood import IntensityLikelihood
from ..models.optics import Fourier
from ..models.priors import Prior, ScorePrior
from ..problem import Posterior, Problem


class Recording(NamedTuple):
    """Fourier intensities `y` (2h, 2w), normalised, of a picture of (h, w), and their camera.

    `irradiance`: full wells for an intensity of 1; `seeds`: what keys are made of. Plain numbers
    and arrays, so that whoever only judges answers holds no accelerator.
    """

    y: np.ndarray
    full_well: int
    bits: int | None
    irradiance: float
    alpha: float
    prior: str
    seeds: tuple[int, int]
    draws: int

    @property
    def camera(self) -> Poisson:
        """Photon counts, behind an ADC if there are bits."""
        return Poisson(self.full_well, self.bits)

    @property
    def likelihood(self) -> IntensityLikelihood:
        """Of the padded picture's transform."""
        shape = tuple(n // 2 for n in self.y.shape)
        return IntensityLikelihood(Fourier(shape, oversampling=2), self.camera, self.irradiance)

    def posterior(self) -> Posterior:
        """Under the learned prior of real pictures."""
        likelihood = self.likelihood
        prior = loaded(self.prior, likelihood.object_shape)
        return Problem(likelihood, prior).condition(self.y)

    def key(self, purpose: int) -> jax.Array:
        """A key of its own for every purpose."""
        seed, index = self.seeds
        key = jax.random.fold_in(jax.random.key(seed), index)
        return jax.random.fold_in(jax.random.fold_in(key, round(1000 * self.alpha)), purpose)

    def by_hio(self) -> jax.Array:
        """The solution of hybrid input-output, real and nonnegative: the same for every system."""
        return hio(self.likelihood, jnp.asarray(self.y), self.key(0)).object

    def misfit(self, objects: np.ndarray) -> float:
        """`diagnostics.misfit` of objects (n, h, w), in NumPy."""
        camera = self.camera
        field = np.fft.fft2(objects, s=self.y.shape, norm="ortho")
        light = self.irradiance * np.abs(field) ** 2
        variance = camera.sigma0**2 * light + camera.read_variance
        seen = variance >= 2 * camera.adc_variance
        seen &= light + 4 * np.sqrt(variance) < camera.saturation
        squares = np.where(seen, (self.y - light) ** 2, 0).sum((-2, -1))
        return float(np.mean(squares / np.where(seen, variance, 0).sum((-2, -1))))


@cache
def loaded(prior: str, shape: tuple[int, ...]) -> Prior:
    """The learned prior of that name."""
    return ScorePrior.load(prior, shape)
