"""Simulations by the hundred: an object, its recording, draws given it; in compiled batches."""

import os
import time
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
from ..samplers.checks import check_run
from ..sampling import NonFiniteError
from ..whole_run import whole_run
from .quantities import Quantity

Drawer = Callable[[jax.Array, Posterior], jax.Array]

_BATCH = 32


class SamplerRefusal(ValueError):
    """A sampler's own reason not to run on a problem."""


class Settings(NamedTuple):
    """Of every run: as in `posterior.sample`."""

    chains: int = 1
    draws: int = 100
    warmup: int | None = None
    thin: int = 1


class Simulations(NamedTuple):
    """Quantities of the truths (n, Q), and of the draws given their recordings.

    `draws` is (n, chains, draws, Q); `names` are those of the Q quantities. `seconds`: of all
    batches, whichever process ran them, compilation included.
    """

    names: tuple[str, ...]
    truths: np.ndarray
    draws: np.ndarray
    seconds: float


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
    there and repeats nothing but the batch that was running. It belongs to what is computed, the
    constants of functions included.
    Raises ValueError for bad settings, quantities that are no real scalars or not defined for an
    object, draws of another shape and a folder of another campaign; NonFiniteError with the number
    of the simulation whose run diverged.
    """
    for name, value in (("count", count), ("batch", batch)):
        if int(value) != value or value < 1:
            raise ValueError(f"{name} {value}: give a whole number, 1 or more")
    if not quantities:
        raise ValueError("no quantities: give {name: f(x, y)}, one or more")
    check_run(settings.chains, settings.draws, settings.thin, settings.warmup)
    names, store = tuple(quantities), None
    pieces: list[dict[str, np.ndarray]] = []

    def arguments(done: int) -> tuple:
        keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(done + jnp.arange(batch))
        return problem, sampler, names, tuple(quantities.values()), settings, keys

    if folder is not None:
        program = _batch.lower(*arguments(0)).as_text()
        parts = (names, program, problem, quantities, key, batch)
        own = sampler if isinstance(sampler, Sampler) else None
        store = Checkpoint(folder, fingerprint(*parts, own))
        found = store.load(np.asarray(0))
        pieces = store.shards(found[1]) if found else []
    with Progress(disable=not progress) as bar:
        task = bar.add_task("simulations", total=count)
        while (done := batch * len(pieces)) < count:
            bar.update(task, completed=done)
            began = time.perf_counter()
            truths, draws = (np.asarray(a) for a in _batch(*arguments(done)))
            seconds = np.asarray(time.perf_counter() - began)
            pieces.append({"truths": truths, "draws": draws, "seconds": seconds})
            _refuse_nan(truths[: count - done], draws[: count - done], done, names)
            if store is not None:
                store.save(np.asarray(done + batch), len(pieces), pieces[-1])
        bar.update(task, completed=count)
    truths, draws = (np.concatenate([p[k] for p in pieces])[:count] for k in ("truths", "draws"))
    _refuse_nan(truths, draws, 0, names)
    seconds = float(sum(p["seconds"] for p in pieces))
    # A density of 0 has a rank too: the lowest.
    return Simulations(names, np.nan_to_num(truths), np.nan_to_num(draws), seconds)


@eqx.filter_jit
def _batch(
    problem: Problem,
    sampler: Sampler | Drawer,
    names: tuple[str, ...],
    quantities: tuple[Quantity, ...],
    settings: Settings,
    keys: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    def one(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        key_joint, key_run = jax.random.split(key)
        x, y = problem.simulate(key_joint)
        posterior = problem.condition(y)

        def asked(x: jax.Array) -> jax.Array:
            found = [f(x, posterior.y) for f in quantities]
            for name, value in zip(names, found):
                if jnp.shape(value) != () or jnp.iscomplexobj(value):
                    raise ValueError(f"{name} is no real number (f(x, y) gives {value}): give one")
            return jnp.stack(found)

        # The truth first: a quantity that is no number is not the sampler's fault.
        truth = asked(x)
        return truth, recorded(sampler, posterior, key_run, settings, asked)

    return jax.vmap(one)(keys)


def recorded(
    sampler: Sampler | Drawer,
    posterior: Posterior,
    key: jax.Array,
    settings: Settings,
    record: Callable[[jax.Array], jax.Array] = lambda x: x,
) -> jax.Array:
    """`record` of each draw (chains, draws, ...) by a sampler, or by a function of draws.

    Raises SamplerRefusal where the sampler refuses the posterior, ValueError for draws of a
    function that have another shape.
    """
    if isinstance(sampler, Sampler):
        try:
            return whole_run(sampler, posterior, key, **settings._asdict(), record=record)
        except ValueError as error:
            raise SamplerRefusal(" ".join(str(error).split())) from error
    draws = sampler(key, posterior)
    if draws.ndim < 2 or draws.shape[2:] != posterior.shape:
        raise ValueError(
            f"the sampler gives draws of shape {draws.shape}: give (chains, draws, "
            f"*{posterior.shape})"
        )
    return jax.vmap(jax.vmap(record))(draws)


def _refuse_nan(truths: np.ndarray, draws: np.ndarray, first: int, names: tuple[str, ...]) -> None:
    for i, q in np.argwhere(np.isnan(truths)):
        raise ValueError(
            f"simulation {first + i}: {names[q]} of the object itself is NaN: give quantities that "
            "are defined for every object and recording"
        )
    for i, q in np.argwhere(np.isnan(draws).any(axis=(1, 2))):
        raise NonFiniteError(
            f"simulation {first + i}: {names[q]} of a draw is NaN: the run diverged, give the "
            "sampler a smaller step"
        )
