"""A picture in colour: its three channels under the prior, or its luminance."""

import numpy as np

from .applications import DENOISING

COLOURS = ("planes", "luminance")


def in_colour(picture: np.ndarray) -> bool:
    """Whether a picture (h, w[, channels]) is RGB or RGBA, and more than grey saved as that."""
    if picture.ndim != 3 or picture.shape[-1] not in (3, 4):
        return False
    return bool(np.ptp(picture[..., :3], axis=-1).any())


def keeps_colour(name: str, picture: np.ndarray, channels: int, colour: str | None) -> bool:
    """Whether the object of a picture or a recording is (h, w, 3).

    `channels`: of the prior; one of three takes colours together, a grey one each by itself
    ("planes"), which `colour` has to say. Raises ValueError for what does not fit.
    """
    if colour not in (None, *COLOURS):
        raise ValueError(f"unknown colour {colour!r}: use one of {', '.join(COLOURS)}")
    if name != DENOISING:
        if colour == "planes":
            raise ValueError(f"colour planes: {name} is of one plane, leave it out")
        if colour is None and in_colour(picture):
            raise ValueError(
                f"the picture is in colour and {name} of one plane: say --colour luminance, or "
                "give a grey picture"
            )
        return False
    if channels == 3:
        if colour is not None:
            raise ValueError(f"colour {colour}: the prior takes three channels, leave it out")
        if picture.ndim != 3 or picture.shape[-1] not in (3, 4):
            raise ValueError(
                f"a picture of shape {picture.shape}, and the prior is in colour: give "
                "(height, width, 3), or a grey prior"
            )
        return True
    if colour is None and in_colour(picture):
        raise ValueError(
            "the picture is in colour and the prior of grey ones: say --colour planes (each "
            "channel by itself), --colour luminance, or give a prior in colour"
        )
    return colour == "planes" and in_colour(picture)
