"""Every system answers every recording once: stored, resumed, and timed in a process of its own."""

import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..diagnostics.shards import Shard, Shards
from ..sampling import NonFiniteError


class Answer(NamedTuple):
    """What a system said of n recordings: images (n, draws, *shape), one draw of an estimate.

    `seconds`: of each recording (n,); the first one compiles. `memory`: bytes, the largest that its
    process held. `refusal`: why it does not apply ("" if it does); the rest is empty then.
    """

    images: np.ndarray
    seconds: np.ndarray
    memory: int
    refusal: str = ""


def measure(
    folder: str | os.PathLike,
    identity: dict[str, object],
    systems: list[str],
    conditions: list[str],
    count: int,
    work: Callable[[str, str, int], np.ndarray],
) -> Iterator[tuple[str, str, int, Answer | None]]:
    """Yields (system, condition, answers so far, Answer when all `count` are there).

    `work(system, condition, index)` returns images (draws, *shape); it is called in a fresh process
    for each system and condition, and must be picklable. A ValueError of it is the system's
    refusal, as are weights that are not there and an answer that is infinite or NaN. Every answer
    is one file of `folder`, which a run that was stopped goes on from, and `identity` says what the
    answers depend on: a folder of another identity raises ValueError, as does a process that dies.
    """
    owner = json.dumps(identity, sort_keys=True)
    for condition in conditions:
        for system in systems:
            shards = Shards(Path(folder) / f"{condition}-{system}", f"{owner} {system} {condition}")
            found = shards.found(count)
            for i, shard in _computed(system, condition, set(range(count)) - set(found), work):
                found[i] = shard
                if "refusal" not in shard:
                    # A refusal is not kept: what it lacks may be there the next time.
                    shards.put(i, shard)
                    yield system, condition, len(found), None
            yield system, condition, count, _gathered(found)


def _computed(
    system: str, condition: str, missing: set[int], work: Callable[[str, str, int], np.ndarray]
) -> Iterator[tuple[int, Shard]]:
    """The missing answers one by one, up to the first refusal."""
    if not missing:
        return
    # A process forked from one that runs JAX may hang.
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=fresh) as pool:
        for i in sorted(missing):
            try:
                shard = pool.submit(_timed, work, system, condition, i).result()
            except BrokenProcessPool as error:
                raise ValueError(
                    f"the process of {system} at {condition} ended: out of memory, or killed; what "
                    "was done is kept, and the same command goes on"
                ) from error
            yield i, shard
            if "refusal" in shard:
                return


def _timed(
    work: Callable[[str, str, int], np.ndarray], system: str, condition: str, index: int
) -> Shard:
    began = time.perf_counter()
    try:
        images = np.asarray(work(system, condition, index))
    except (ValueError, NonFiniteError, FileNotFoundError) as error:
        return {"refusal": np.asarray(f"recording {index}: {error}")}
    if not np.all(np.isfinite(images)):
        return {"refusal": np.asarray(f"recording {index}: the answer is not finite")}
    seconds = time.perf_counter() - began
    return {"images": images, "seconds": np.asarray(seconds), "memory": np.asarray(_peak_memory())}


def _peak_memory() -> int:
    """Bytes that this process held at most; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _gathered(found: dict[int, Shard]) -> Answer:
    shards = [found[i] for i in sorted(found)]
    for shard in shards:
        if "refusal" in shard:
            return Answer(np.empty(0), np.empty(0), 0, str(shard["refusal"]))
    return Answer(
        np.stack([shard["images"] for shard in shards]),
        np.array([float(shard["seconds"]) for shard in shards]),
        max(int(shard["memory"]) for shard in shards),
    )
