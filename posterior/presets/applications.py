"""The three applications, what they take by default, and what is asked of one."""

from typing import Any, NamedTuple

import numpy as np

from ..problem import Problem

DENOISING, PHASE_RETRIEVAL, PTYCHOGRAPHY = "denoising", "phase-retrieval", "ptychography"
LEAST_SIDE = 4  # pixels of an object or a recording


class Application(NamedTuple):
    """What an application takes where the user says nothing; `size` in pixels, 0 bits: no ADC."""

    size: int
    full_well: int
    bits: int
    sampler: str


APPLICATIONS = {
    DENOISING: Application(128, 100, 8, "mala"),
    PHASE_RETRIEVAL: Application(64, 1_000_000, 16, "mala"),
    PTYCHOGRAPHY: Application(64, 1000, 10, "mala"),
}


class Question(NamedTuple):
    """A problem and its recording `y`; `truth` is the object, where it is known.

    `irradiance` is None for denoising and measured stacks; `prior` names the pictures that the
    prior was fitted to, each with the SHA-256 of what was fitted; `microscope` is what the images
    of a measured stack told of theirs, None otherwise.
    """

    problem: Problem
    y: np.ndarray
    truth: np.ndarray | None
    irradiance: float | None
    prior: dict[str, str]
    microscope: dict[str, Any] | None = None
