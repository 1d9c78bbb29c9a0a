"""The pictures of a study: those that its prior's card says it was not trained on."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..train import Preparation, prepare

# Places looked at in each picture, for the one with the most contrast.
_PLACES = 8


def held_out(
    card: dict[str, Any], folder: str | os.PathLike, part: str, count: int, side: int
) -> np.ndarray:
    """One patch of each picture: of eight places, the one with the most contrast.

    float32 (count, side, side), or (count, side, side, 3) of a prior in colour.

    `part`: "test" or "validation", as the prior's `card` lists them; files lie in `folder`, and are
    prepared as for training. The same patches for the same card. Raises ValueError for a card
    without such a list or with too short a one, for complex objects, and for a picture that is too
    small; OSError for a missing file.
    """
    names = card["data"].get(part, [])
    if not isinstance(names, list) or len(names) < count:
        held = len(names) if isinstance(names, list) else 0
        raise ValueError(
            f"the card of {card['name']} lists {held} {part} pictures, not {count}: take fewer "
            "(--pictures), or a prior that was trained with more held out"
        )
    how, rng = Preparation(**card["preparation"]), np.random.default_rng(5)
    return np.stack([_patch(Path(folder) / name, how, side, rng) for name in names[:count]])


def _patch(path: Path, how: Preparation, side: int, rng: np.random.Generator) -> np.ndarray:
    if how.objects == "complex":
        raise ValueError(f"{path}: the study is of pictures, the prior of complex objects")
    picture = prepare(path, how)
    rows, columns = picture.shape[0] - side + 1, picture.shape[1] - side + 1
    if min(rows, columns) < 1:
        raise ValueError(f"{path} is {picture.shape[:2]}: smaller than {side} x {side}")
    picture = picture[..., 0] if how.objects == "grey" else picture
    corners = rng.integers(0, (rows, columns), (_PLACES, 2))
    return max((picture[i : i + side, j : j + side] for i, j in corners), key=np.std)
