"""The optics of an application."""

import math

import numpy as np

from ..models.optics import Fourier, FourierPtychography, Identity, Optics
from .applications import DENOISING, PHASE_RETRIEVAL, PTYCHOGRAPHY

GRID = 7  # LEDs a side
_PITCH = 0.64  # of the pupil's radius: neighbouring pupils share 60 % of their area


def aperture_grid(size: int) -> tuple[np.ndarray, float]:
    """Centres (49, 2) and radius, in Fourier samples, of the largest synthetic aperture.

    A 7x7 grid of pupils whose neighbours share about 60 % of their area, inside the band of an
    object of `size` and of its camera (upsampling 4; 2 under 64). Raises ValueError for a size that
    is too small, or that the upsampling does not divide.
    """
    upsampling = upsampling_of(size)
    if size < 16 or size % upsampling:
        raise ValueError(f"size {size}: {PTYCHOGRAPHY} needs a multiple of {upsampling}, from 16")
    reach = GRID // 2
    largest = min((size // 2 - 1) / (1 + reach * _PITCH), size / upsampling / 2 - 0.1)
    pitch = max(1, math.floor(_PITCH * largest))
    offsets = pitch * (np.arange(GRID) - reach)
    centres = np.stack(np.meshgrid(offsets, offsets, indexing="ij"), -1).reshape(-1, 2)
    return centres, pitch / _PITCH


def upsampling_of(size: int) -> int:
    """Object pixels for one of the camera, along an axis, in simulated ptychography."""
    return 4 if size >= 64 else 2


def optics_of(name: str, shape: tuple[int, int], oversampling: int | None) -> Optics:
    """The optics of an application for an object of `shape`."""
    if oversampling is not None and name != PHASE_RETRIEVAL:
        raise ValueError(f"oversampling {oversampling} is for {PHASE_RETRIEVAL}: leave it out")
    if name == DENOISING:
        return Identity(shape)
    if name == PHASE_RETRIEVAL:
        return Fourier(shape, oversampling=2 if oversampling is None else oversampling)
    if shape[0] != shape[1]:
        raise ValueError(f"an object of shape {shape}: {PTYCHOGRAPHY} needs a square, give --size")
    centres, radius = aperture_grid(shape[0])
    return FourierPtychography.from_radius(shape, centres, radius, upsampling_of(shape[0]))
