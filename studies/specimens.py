"""Complex objects that no network saw: windows of the measured reference objects."""

import os
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

COLOURS = ("red", "green")
# Columns of the references from here on are in no training set; those before are cut into blocks.
_FIRST_HELD_OUT, _BLOCK = 384, 128
_PERCENTILE = 99.5


class Window(NamedTuple):
    """Where an object lies in the reference of a colour."""

    colour: str
    row: int
    column: int


def specimens(
    folder: str | os.PathLike, card: dict[str, Any], part: str, count: int, side: int
) -> np.ndarray:
    """`count` objects (count, side, side), complex64, in the units of the prior.

    `folder` holds bloodsmear_{red,green}_epie_reference.npz. `part`: "test", columns 384 to 511,
    which the training pictures of complex-cells leave out (a prior trained on them knows the
    answers); or "validation", the blocks of 128 pixels that the prior's `card` lists, to choose
    settings on. Windows do not overlap and come in an order of chance, the same for every count.
    Both colours show one specimen (their amplitudes correlate by 0.93 at the same place), so that
    no place is taken twice before all are. Raises ValueError where there are fewer windows, or a
    card lists no blocks; FileNotFoundError without the files.
    """
    windows = _held_out(side) if part == "test" else _listed(card, side)
    if count > len(windows):
        raise ValueError(
            f"{count} objects of {side} x {side}: the {part} part has {len(windows)}, take fewer "
            "(--objects) or smaller ones (--size)"
        )
    references = {colour: reference(folder, colour) for colour in COLOURS}
    cut = [references[w.colour][w.row :, w.column :][:side, :side] for w in windows[:count]]
    return np.stack(cut)


def reference(folder: str | os.PathLike, colour: str) -> np.ndarray:
    """A reference object (512, 512), complex64, in the units that complex-cells was trained in.

    Over the 99.5th percentile of the amplitude of what was trained on, and turned to a real mean.
    """
    path = Path(folder) / f"bloodsmear_{colour}_epie_reference.npz"
    with np.load(path, allow_pickle=False) as file:
        whole = file["obj"]
    seen = whole[:, :_FIRST_HELD_OUT]
    scale = np.percentile(np.abs(seen), _PERCENTILE) * np.exp(1j * np.angle(seen.mean()))
    return (whole / scale).astype(np.complex64)


def _held_out(side: int) -> list[Window]:
    places = [
        (row, column)
        for row in range(0, 512 - side + 1, side)
        for column in range(_FIRST_HELD_OUT, 512 - side + 1, side)
    ]
    order = np.random.default_rng(5).permutation(len(places))
    rounds = (COLOURS, COLOURS[::-1])
    return [
        Window(colours[i % 2], *places[place])
        for colours in rounds
        for i, place in enumerate(order)
    ]


def _listed(card: dict[str, Any], side: int) -> list[Window]:
    """Windows of the blocks named COLOUR-rROWcCOLUMN.npy, one of each block in turn."""
    names = card["data"].get("validation", [])
    names = names if isinstance(names, list) else []
    found = [re.fullmatch(r"(red|green)-r(\d)c(\d)\.npy", name) for name in names]
    blocks = [(m[1], _BLOCK * int(m[2]), _BLOCK * int(m[3])) for m in found if m]
    if not blocks:
        raise ValueError(
            f"the card of {card['name']} lists no validation blocks of the references: use "
            "--part test"
        )
    inside = [
        (i, j) for i in range(0, _BLOCK - side + 1, side) for j in range(0, _BLOCK - side + 1, side)
    ]
    return [Window(colour, r + i, c + j) for i, j in inside for colour, r, c in blocks]
