"""Checkpoints: a folder from which a run that was killed at any moment goes on bit-identically.

`run.json` says whose run it is; `state.eqx` is the latest state, replaced atomically;
`draws-NNNNNN.npz` are the draws between one state and the next. Draws newer than the state are
rewritten when the run goes on.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .files import replace_whole


class Checkpoint:
    """The folder of one run. Raises ValueError if it belongs to another run."""

    def __init__(self, path: str | os.PathLike, fingerprint: str):
        self.path = Path(path)
        if self.path.exists() and not self.path.is_dir():
            raise ValueError(f"checkpoint {self.path} is a file: give the path of a folder")
        manifest = self.path / "run.json"
        if manifest.exists():
            if json.loads(manifest.read_text())["fingerprint"] != fingerprint:
                raise ValueError(
                    f"checkpoint {self.path} is of another run (data, sampler, start, key or "
                    "settings differ): give another folder, or delete this one"
                )
        elif self.path.exists() and any(self.path.iterdir()):
            raise ValueError(f"checkpoint {self.path} is a folder of other things: give a new one")
        else:
            self.path.mkdir(parents=True, exist_ok=True)
            text = json.dumps({"fingerprint": fingerprint})
            replace_whole(manifest, lambda part: Path(part).write_text(text))

    def save(self, state: Any, shards: int, new: dict[str, np.ndarray] | None) -> None:
        """Write the draws since the last save, if any, as shard `shards` - 1; then the state."""
        if new is not None:
            replace_whole(self._shard(shards - 1), lambda part: _save_arrays(part, new))
        tree = (np.asarray(shards), state)
        replace_whole(self.path / "state.eqx", lambda part: eqx.tree_serialise_leaves(part, tree))

    def load(self, like: Any) -> tuple[Any, int] | None:
        """The latest state, in the structure of `like`, and its number of shards; or None."""
        file = self.path / "state.eqx"
        if not file.exists():
            return None
        shards, state = eqx.tree_deserialise_leaves(file, (np.asarray(0), like))
        return state, int(shards)

    def shards(self, count: int) -> list[dict[str, np.ndarray]]:
        """The draws of the first `count` shards."""
        found = []
        for i in range(count):
            with np.load(self._shard(i)) as shard:
                found.append(dict(shard))
        return found

    def _shard(self, index: int) -> Path:
        return self.path / f"draws-{index:06d}.npz"


def fingerprint(*parts: Any) -> str:
    """A hash of structures, settings and array contents."""
    digest = hashlib.sha256()
    for part in parts:
        leaves, structure = jax.tree.flatten(part)
        digest.update(str(structure).encode())
        for leaf in leaves:
            if isinstance(leaf, jax.Array) and jax.dtypes.issubdtype(
                leaf.dtype, jax.dtypes.prng_key
            ):
                leaf = jax.random.key_data(leaf)
            if eqx.is_array_like(leaf):
                array = np.asarray(leaf)
                digest.update(f"{array.dtype}{array.shape}".encode())
                digest.update(array.tobytes())
            else:
                digest.update(repr(leaf).encode())
    return digest.hexdigest()


def _save_arrays(path: str, arrays: dict[str, np.ndarray]) -> None:
    # NumPy adds .npz to a path that does not end in it.
    with open(path, "wb") as file:
        np.savez(file, **arrays)
