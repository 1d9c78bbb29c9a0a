"""Simulations by the hundred: an object, its recording, draws given it; in compiled batches."""

import os
from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import Progress

from ..checkpoint import Checkpoint, fingerprint
from ..problem import Posterior, Problem
from ..samplers.base import Sampler
from ..sampling import NonFiniteError
from ..whole_run import whole_run
from .quantities import Quantity

Drawer = Callable[[jax.Array, Posterior], jax.Array]

_BATCH = 32


class Settings(NamedTuple):
    """Of every run: as in `posterior.sample`."""

    chains: int = 1
    draws: int = 100
    warmup: int | None = None
    thin: int = 1


class Simulations(NamedTuple):
    """Quantities of the truths (n, Q), and of the draws given their recordings.

    `draws` is (n, chains, draws, Q); `names` are those of the Q quantities.
    """

    names: tuple[str, ...]
    truths: np.ndarray
    draws: np.ndarray


def simulate(
    problem: Problem,
    sampler: Sampler | Drawer,
    key: jax.Array,
    count: int,
    quantities: Mapping[str, Quantity],
    settings: Settings = Settings(),  # noqa: B008
    *,
    batch: int = _BATCH,
    folder: str | os.PathLike | None = None,
    progress: bool = True,
) -> Simulations:
    """`count` draws of the joint distribution, each with draws of its posterior by `sampler`.

    `sampler` may be a function (key, posterior) -> (chains, draws, *shape), traceable by JAX; then
    `settings` are not used. Simulation i depends on `fold_in(key, i)` alone, so that more of them
    go on where fewer ended. Only the quantities are held. `batch` of them run at a time: memory and
    speed, not results, beyond rounding. `folder`: killed at any moment, a campaign goes on from
    there and repeats nothing but the batch that was running.
    Raises ValueError for bad settings and a folder of another campaign, NonFiniteError with the
    number of the simulation that diverged.
    """
    for name, value in (("count", count), ("batch", batch)):
        if int(value) != value or value < 1:
            raise ValueError(f"{name} {value}: give a whole number, 1 or more")
    if not quantities:
        raise ValueError("no quantities: give {name: f(x, y)}, one or more")
    names, store = tuple(quantities), None
    pieces: list[dict[str, np.ndarray]] = []
    if folder is not None:
        parts = (names, _named(sampler), problem, key, tuple(settings), batch)
        store = Checkpoint(folder, fingerprint(*parts))
        found = store.load(np.asarray(0))
        pieces = store.shards(found[1]) if found else []
    with Progress(disable=not progress) as bar:
        task = bar.add_task("simulations", total=count)
        while (done := batch * len(pieces)) < count:
            bar.update(task, completed=done)
            keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(done + jnp.arange(batch))
            new = _batch(problem, sampler, tuple(quantities.values()), settings, keys)
            pieces.append(_ranked(*new, done, names))
            if store is not None:
                store.save(np.asarray(done + batch), len(pieces), pieces[-1])
        bar.update(task, completed=count)
    truths, draws = (np.concatenate([p[k] for p in pieces])[:count] for k in ("truths", "draws"))
    return Simulations(names, truths, draws)


@eqx.filter_jit
def _batch(
    problem: Problem,
    sampler: Sampler | Drawer,
    quantities: tuple[Quantity, ...],
    settings: Settings,
    keys: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    def one(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        key_joint, key_run = jax.random.split(key)
        x, y = problem.simulate(key_joint)
        posterior = problem.condition(y)

        def asked(x: jax.Array) -> jax.Array:
            return jnp.stack([f(x, posterior.y) for f in quantities])

        if isinstance(sampler, Sampler):
            run = settings._asdict()
            return asked(x), whole_run(sampler, posterior, key_run, **run, record=asked)
        return asked(x), jax.vmap(jax.vmap(asked))(sampler(key_run, posterior))

    return jax.vmap(one)(keys)


def _ranked(
    truths: jax.Array, draws: jax.Array, first: int, names: tuple[str, ...]
) -> dict[str, np.ndarray]:
    truths, draws = np.asarray(truths), np.asarray(draws)
    bad = np.isnan(truths) | np.isnan(draws).any(axis=(1, 2))
    if bad.any():
        i, q = np.argwhere(bad)[0]
        raise NonFiniteError(
            f"simulation {first + i}: {names[q]} is NaN: the run diverged (a smaller step), or the "
            "quantity is not defined for this object"
        )
    # A density of 0 has a rank too: the lowest.
    return {"truths": np.nan_to_num(truths), "draws": np.nan_to_num(draws)}


def _named(sampler: Sampler | Drawer) -> object:
    """What tells samplers apart in another process too: a function, by its name."""
    if isinstance(sampler, Sampler):
        return (repr(sampler), sampler)
    return getattr(sampler, "__qualname__", type(sampler).__qualname__)
