"""The object that a picture shows, brought to the kind and the size of an application."""

import numpy as np

from ..images import fit_to, to_grey, to_unit_range
from .applications import APPLICATIONS, LEAST_SIDE, PTYCHOGRAPHY


def complex_object(grey: np.ndarray) -> np.ndarray:
    """A thin specimen from a grey picture p in 0..1: amplitude 0.3 + 0.7 p, phase of its mirror.

    phase = pi/2 (p mirrored left-right - 1/2), from -pi/4 to pi/4.
    """
    phase = np.pi / 2 * (grey[:, ::-1] - 0.5)
    return (0.3 + 0.7 * grey) * np.exp(1j * phase)


def object_of(name: str, picture: np.ndarray, size: int | None) -> np.ndarray:
    """The object, real or complex, that a picture shows to an application."""
    if size is not None and size < LEAST_SIDE:
        raise ValueError(f"size {size}: give {LEAST_SIDE} or more")
    if not np.iscomplexobj(picture):
        return _object_of_grey(name, to_grey(to_unit_range(picture)), size)
    if name != PTYCHOGRAPHY:
        raise ValueError(f"the picture is complex: {name} is of real objects, save its modulus")
    if picture.ndim != 2:
        raise ValueError(f"a complex object of shape {picture.shape}: give (height, width)")
    return picture if size is None else fit_to(picture, size)


def _object_of_grey(name: str, grey: np.ndarray, size: int | None) -> np.ndarray:
    if grey.min() == grey.max():
        raise ValueError(f"the picture has the value {grey.max():.3g} everywhere: give another")
    grey = fit_to(grey, min(APPLICATIONS[name].size, *grey.shape) if size is None else size)
    return complex_object(grey) if name == PTYCHOGRAPHY else grey
