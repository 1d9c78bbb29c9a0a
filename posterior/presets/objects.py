"""The object that a picture shows, brought to the kind and the size of an application."""

import numpy as np

from ..images import fit_to, to_grey, to_unit_range
from .applications import APPLICATIONS, DENOISING, LEAST_SIDE


def complex_object(grey: np.ndarray) -> np.ndarray:
    """A thin specimen from a grey picture p in 0..1: amplitude 0.3 + 0.7 p, phase of its mirror.

    phase = pi/2 (p mirrored left-right - 1/2), from -pi/4 to pi/4.
    """
    phase = np.pi / 2 * (grey[:, ::-1] - 0.5)
    return (0.3 + 0.7 * grey) * np.exp(1j * phase)


def object_of(
    name: str, picture: np.ndarray, size: int | None, complex_valued: bool, in_colour: bool = False
) -> np.ndarray:
    """The object that a picture shows to an application: complex, or real, (h, w, 3) in colour."""
    if size is not None and size < LEAST_SIDE:
        raise ValueError(f"size {size}: give {LEAST_SIDE} or more")
    if not np.iscomplexobj(picture):
        picture = to_unit_range(picture)
        picture = picture[..., :3] if in_colour else to_grey(picture)
        picture = _fitted(name, picture, size)
        return complex_object(picture) if complex_valued else picture
    refuse_complex(name, complex_valued)
    if picture.ndim != 2:
        raise ValueError(f"a complex object of shape {picture.shape}: give (height, width)")
    return picture if size is None else fit_to(picture, size)


def refuse_complex(name: str, complex_valued: bool) -> None:
    """Refuse a complex picture where objects are real."""
    if complex_valued:
        return
    if name == DENOISING:
        raise ValueError(f"the picture is complex: {name} is of real objects, save its modulus")
    raise ValueError(
        "the picture is complex and the prior of real objects: give a prior of complex ones, as "
        "--prior complex-cells, or save the modulus"
    )


def _fitted(name: str, picture: np.ndarray, size: int | None) -> np.ndarray:
    if picture.min() == picture.max():
        raise ValueError(f"the picture has the value {picture.max():.3g} everywhere: give another")
    own = min(APPLICATIONS[name].size, *picture.shape[:2])
    return fit_to(picture, own if size is None else size)
