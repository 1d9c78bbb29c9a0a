"""Files that are there whole or not at all."""

import os
from collections.abc import Callable

import numpy as np


def replace_whole(path: str | os.PathLike, write: Callable[[str], object]) -> None:
    """Let `write(partial path)` finish before `path` gets the new contents."""
    partial = f"{os.fspath(path)}.part"
    write(partial)
    os.replace(partial, path)


def save_array(path: str | os.PathLike, array: np.ndarray) -> None:
    """Write `array` as an NPY file of exactly that name."""

    def write(part: str) -> None:
        # np.save adds a suffix to a name that has another.
        with open(part, "wb") as file:
            np.save(file, array)

    replace_whole(path, write)
