"""The optics of an application."""

import math

import numpy as np

from ..models.optics import Fourier, FourierPtychography, Identity, Optics
from .applications import DENOISING, PHASE_RETRIEVAL, PTYCHOGRAPHY

LEDS = tuple(side**2 for side in range(3, 16, 2))  # square grids with an LED in the middle
_LEDS = 49
_PITCH = 0.64  # of the pupil's radius: neighbouring pupils share 60 % of their area


def aperture_grid(size: int, leds: int = _LEDS) -> tuple[np.ndarray, float]:
    """Centres (leds, 2) and radius, in Fourier samples, of the largest synthetic aperture.

    A square grid of pupils, of 9 to 225, whose neighbours share about 60 % of their area, inside
    the band of an object of `size` and of its camera (upsampling 4; 2 under 64). Raises ValueError
    for other numbers of LEDs, for a size that is too small for them, or that the upsampling does
    not divide.
    """
    upsampling = upsampling_of(size)
    if leds not in LEDS:
        raise ValueError(f"leds {leds}: give one of {', '.join(map(str, LEDS))}, a square grid")
    if size < 16 or size % upsampling:
        raise ValueError(f"size {size}: {PTYCHOGRAPHY} needs a multiple of {upsampling}, from 16")
    side = math.isqrt(leds)
    reach = side // 2
    largest = min((size // 2 - 1) / (1 + reach * _PITCH), size / upsampling / 2 - 0.1)
    pitch = math.floor(_PITCH * largest)
    if pitch < 1:
        needed = math.ceil(2 * (reach + 1 / _PITCH) + 2)
        raise ValueError(
            f"size {size}: {side}x{side} LEDs lie less than a Fourier sample apart, give "
            f"{needed} or more, or fewer --leds"
        )
    offsets = pitch * (np.arange(side) - reach)
    centres = np.stack(np.meshgrid(offsets, offsets, indexing="ij"), -1).reshape(-1, 2)
    return centres, pitch / _PITCH


def upsampling_of(size: int) -> int:
    """Object pixels for one of the camera, along an axis, in simulated ptychography."""
    return 4 if size >= 64 else 2


def optics_of(
    name: str, shape: tuple[int, ...], oversampling: int | None, leds: int | None = None
) -> Optics:
    """The optics of an application for an object of `shape`; `leds` None: 49."""
    if leds is not None and name != PTYCHOGRAPHY:
        raise ValueError(f"leds {leds} are for {PTYCHOGRAPHY}: leave them out")
    if oversampling is not None and name != PHASE_RETRIEVAL:
        raise ValueError(f"oversampling {oversampling} is for {PHASE_RETRIEVAL}: leave it out")
    if name == DENOISING:
        return Identity(shape)
    if name == PHASE_RETRIEVAL:
        return Fourier(shape, oversampling=2 if oversampling is None else oversampling)
    if shape[0] != shape[1]:
        raise ValueError(f"an object of shape {shape}: {PTYCHOGRAPHY} needs a square, give --size")
    centres, radius = aperture_grid(shape[0], _LEDS if leds is None else leds)
    return FourierPtychography.from_radius(shape, centres, radius, upsampling_of(shape[0]))
