"""A folder of shards: the batches of one campaign, each in a file of its own, in any order."""

import os
import uuid
from pathlib import Path

import numpy as np

Shard = dict[str, np.ndarray]


class Shards:
    """`shard-NNNNNN.npz` holds batch N and the name of its owner; it is there whole or not at all.

    Any number of processes may write one folder at once: those of one campaign write the same
    shards, and those of another are refused. Raises ValueError for a folder that holds anything
    else, or shards of another owner.
    """

    def __init__(self, folder: str | os.PathLike, owner: str):
        self.folder, self.owner = Path(folder), owner
        if self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"{self.folder} is a file: give the path of a folder")
        self.folder.mkdir(parents=True, exist_ok=True)
        for path in self.folder.iterdir():
            if path.name.startswith("."):
                continue
            if _index(path) is None:
                raise ValueError(
                    f"{self.folder} holds {path.name}, which is no campaign's: give a new folder"
                )
            self._read(path, contents=False)

    def found(self, count: int) -> dict[int, Shard]:
        """Those of the first `count` shards that are there. Raises ValueError for a damaged one."""
        paths = {i: self._path(i) for i in range(count)}
        return {i: self._read(path) for i, path in paths.items() if path.exists()}

    def put(self, index: int, shard: Shard) -> None:
        """Write a shard; a process that is killed meanwhile leaves a hidden file, never half a one.

        Raises ValueError where another campaign has written it since.
        """
        path = self._path(index)
        if path.exists():
            self._read(path, contents=False)
        # A name of its own: another process may be writing the same shard.
        part = path.with_name(f".{path.stem}.{uuid.uuid4().hex}")
        with open(part, "wb") as file:
            np.savez(file, owner=np.asarray(self.owner), **shard)
        os.replace(part, path)

    def _path(self, index: int) -> Path:
        return self.folder / f"shard-{index:06d}.npz"

    def _read(self, path: Path, contents: bool = True) -> Shard:
        try:
            with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as file:
                shard = {name: file[name] for name in (file.files if contents else ["owner"])}
                owner = str(shard.pop("owner"))
        except Exception as error:
            raise ValueError(
                f"shard {path} is damaged: delete it, and the campaign computes it anew"
            ) from error
        if owner != self.owner:
            raise ValueError(
                f"{self.folder} is of another campaign (problem, sampler, quantities, key, "
                "settings or batch differ): give another folder, or delete this one"
            )
        return shard


def _index(path: Path) -> int | None:
    number = path.name.removeprefix("shard-").removesuffix(".npz")
    is_shard = path.name == f"shard-{number}.npz" and number.isdecimal()
    return int(number) if is_shard else None
