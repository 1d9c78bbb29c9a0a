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

_LEAST_ELECTRONS = 10


class Recording(NamedTuple):
    """Fourier intensities `y` (2h, 2w), normalised, of a picture of (h, w), and their camera.

    `irradiance`: full wells for an intensity of 1; `seeds`: what keys are made of; `scout`: the
    prior, by name, whose denoiser searches where annealing starts. Numbers and
    NumPy's arrays: whoever only judges answers computes nothing on an accelerator.
    """

    y: np.ndarray
    full_well: int
    bits: int | None
    irradiance: float
    alpha: float
    prior: str
    seeds: tuple[int, int]
    draws: int
    scout: str

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
        """Squared residuals of the roots of the counts over their variance, objects (n, h, w).

        1 where all is right. Every pixel weighs alike, where in a sum of counts the zero frequency
        would be nearly all. Left out, by what is expected there, are pixels of less than 10
        electrons, whose roots are skew, and those whose noise is below the ADC's; nan if none is
        left. NumPy alone, as all that judges answers.
        """
        camera = self.camera
        field = np.fft.fft2(objects, s=self.y.shape, norm="ortho")
        light = self.irradiance * np.abs(field) ** 2
        variance = camera.sigma0**2 * light + camera.read_variance
        seen = (light * self.full_well >= _LEAST_ELECTRONS) & (variance >= 2 * camera.adc_variance)
        apart = np.sqrt(self.y) - np.sqrt(light)
        squares = apart[seen] ** 2 * 4 * light[seen] / variance[seen]
        return float(squares.mean()) if squares.size else float("nan")


@cache
def loaded(prior: str, shape: tuple[int, ...]) -> Prior:
    """The learned prior of that name."""
    return ScorePrior.load(prior, shape)
