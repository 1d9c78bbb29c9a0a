"""Files that are there whole or not at all."""

import os
from collections.abc import Callable


def replace_whole(path: str | os.PathLike, write: Callable[[str], object]) -> None:
    """Let `write(partial path)` finish before `path` gets the new contents."""
    partial = f"{os.fspath(path)}.part"
    write(partial)
    os.replace(partial, path)
