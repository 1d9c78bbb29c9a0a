"""Poisson denoising, the paper's Table 1: its systems and ours on the same recordings."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..models.camera import Poisson
from .systems import SYSTEMS, Recording


class Denoising(NamedTuple):
    """The study: `truths` (n, h, w[, 3]) in 0..1, and how each is recorded and answered.

    A condition is sigma_0 as text: a camera of 1/sigma_0^2 electrons at full light, in a well that
    holds `headroom` standard deviations of them more, with an ADC of `bits` (None: whole counts).
    Callable as the harness wants it.
    """

    truths: np.ndarray
    prior: str
    bits: int | None
    draws: int
    seed: int
    headroom: float = 0.0

    def __call__(self, system: str, condition: str, index: int) -> np.ndarray:
        return np.asarray(SYSTEMS[system].answer(self.recording(condition, index)))

    def recording(self, condition: str, index: int) -> Recording:
        """Of one truth: the same for every system, another for every condition and truth."""
        camera = camera_of(condition, self.bits, self.headroom)
        key = jax.random.fold_in(jax.random.key(self.seed), index)
        key_data, key_draws = jax.random.split(jax.random.fold_in(key, camera.full_well))
        y = camera.sample(key_data, jnp.asarray(self.truths[index]))
        return Recording(y, camera, self.prior, key_draws, self.draws)


def camera_of(condition: str, bits: int | None, headroom: float = 0.0) -> Poisson:
    """The camera of a condition. Raises ValueError unless its noise, bits and headroom are such."""
    well = electrons(condition)
    if not 0 <= headroom <= 100:
        raise ValueError(f"headroom {headroom}: give standard deviations of white, 0 to 100")
    return Poisson(well, bits, math.ceil(well + headroom * math.sqrt(well)))


def electrons(condition: str) -> int:
    """Electrons at full light. Raises ValueError unless it is a noise level of whole electrons."""
    try:
        well = 1 / float(condition) ** 2
    except (ValueError, ZeroDivisionError):
        well = 0.0
    if not 1 <= well < 2**23:
        raise ValueError(f"sigma_0 {condition}: the noise at full light, give a number in 0..1")
    return round(well)
