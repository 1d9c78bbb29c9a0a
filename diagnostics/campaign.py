"""Simulations by the thousand: an object, its recording, draws given it; in compiled batches."""

import os
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ..checkpoint import fingerprint
from ..models.realview import real_size
from ..problem import Posterior, Problem
from ..samplers.base import Sampler
from ..samplers.checks import check_run
from ..sampling import NonFiniteError
from ..whole_run import whole_run
from .executors import completed
from .quantities import DENSITIES, Quantity, values_of
from .shards import Shard, Shards

Drawer = Callable[[jax.Array, Posterior], jax.Array]

_BATCH = 32
# Real unknowns of a batch: of large objects fewer, lest the first be hours in coming.
_BATCH_SIZE = 4096


class SamplerRefusal(ValueError):
    """A sampler's own reason not to run on a problem."""


class OutOfTime(RuntimeError):
    """A campaign whose time was over before its simulations were."""


class Enumerated(Problem):
    """A problem whose simulations are told apart by their number, besides their key."""

    @abstractmethod
    def numbered(self, key: jax.Array, number: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The pair (x, y) of this number, from 0; in place of `simulate`."""

    def simulate(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Not told by a key alone: TypeError."""
        raise TypeError("simulations of this problem have numbers: use numbered(key, number)")


class Settings(NamedTuple):
    """Of every run: as in `posterior.sample`."""

    chains: int = 1
    draws: int = 100
    warmup: int | None = None
    thin: int = 1


class Simulations(NamedTuple):
    """Quantities of the truths (n, Q), and of the draws given their recordings.

    `draws` is (n, chains, draws, Q); `names` are those of the Q quantities. `seconds`: of all
    batches, whichever process ran them, compilation included. `impossible`: in how many simulations
    a draw has no density, by the quantities that are densities, and its object has.
    """

    names: tuple[str, ...]
    truths: np.ndarray
    draws: np.ndarray
    seconds: float
    impossible: int


def simulate(
    problem: Problem,
    sampler: Sampler | Drawer,
    key: jax.Array,
    count: int,
    quantities: Mapping[str, Quantity],
    settings: Settings = Settings(),  # noqa: B008
    *,
    batch: int | None = None,
    limit: float | None = None,
    folder: str | os.PathLike | None = None,
    executor: Executor | None = None,
    progress: bool = True,
) -> Simulations:
    """`count` draws of the joint distribution, each with draws of its posterior by `sampler`.

    `sampler` may be a function (key, posterior) -> (chains, draws, *shape), traceable by JAX; then
    `settings` are not used. Simulation i depends on `fold_in(key, i)` alone, so that more of them
    go on where fewer ended. Only the quantities are held. `batch` of them run at a time, split over
    the devices that this process sees (or on `jax_default_device`, if that is set): memory and
    speed, not results, beyond rounding; None: 32, or as many as have 4096 real unknowns together.

    `limit`: the seconds of all batches together, the folder's among them and whoever computes them,
    after which none begins; None: without end. In this process a batch that has begun is ended and
    kept, by an `executor` those that run are lost.

    `folder`: each batch is kept in a file of its own, and a campaign killed at any moment goes on
    with the same call, which repeats nothing but the batches that were running. It belongs to what
    is computed, the constants of functions included. Processes that share it do the work twice, and
    no harm.

    `executor`: who computes the batches; None: this process. Results are the same, bit for bit,
    whichever of one kind of machine computes them. Any `concurrent.futures.Executor` will do, such
    as Dask's `Client.get_executor()`, or `ProcessPoolExecutor` by "spawn": JAX may hang in
    processes made by fork. With cloudpickle, which the extra `cluster` installs, functions of any
    kind are sent, without it those at the top of a module.

    Raises ValueError for what is no problem or no sampler, bad settings, quantities that are no
    real scalars or not defined for an object, draws of another shape or kind than the object, a
    folder of another campaign or with a damaged file, functions that cannot be sent, and processes
    made by fork or of other versions; NonFiniteError with the number of a simulation in which any
    pixel of a draw is not finite; OutOfTime, with the time that all would take, at the `limit`.
    """
    check_asked(problem, sampler)
    batch = _batch_of(problem) if batch is None else batch
    for name, value in (("count", count), ("batch", batch)):
        if int(value) != value or value < 1:
            raise ValueError(f"{name} {value}: give a whole number, 1 or more")
    if limit is not None and not limit > 0:
        raise ValueError(f"limit {limit}: give seconds above 0, or None")
    if not quantities:
        raise ValueError("no quantities: give {name: f(x, y)}, one or more")
    check_run(settings.chains, settings.draws, settings.thin, settings.warmup)
    count, batch = int(count), int(batch)
    campaign = _Campaign(problem, sampler, key, dict(quantities), settings, batch)
    shards = _shards(campaign, count, folder, executor, progress, limit)
    truths, draws = (np.concatenate([s[k] for s in shards])[:count] for k in ("truths", "draws"))
    names = tuple(quantities)
    _refuse_nan(truths, draws, 0, names)
    seconds = float(sum(s["seconds"] for s in shards))
    densities = [isinstance(f, DENSITIES) for f in quantities.values()]
    lost = np.isneginf(draws).any(axis=(1, 2)) & np.isfinite(truths)
    impossible = int(np.sum(lost[:, densities].any(axis=1)))
    # A density of 0 has a rank too: the lowest.
    return Simulations(names, np.nan_to_num(truths), np.nan_to_num(draws), seconds, impossible)


@dataclass(frozen=True, eq=False)
class _Campaign:
    """What is simulated; called with a number, that batch of it."""

    problem: Problem
    sampler: Sampler | Drawer
    key: jax.Array
    quantities: dict[str, Quantity]
    settings: Settings
    batch: int

    def __call__(self, number: int) -> Shard:
        began = time.perf_counter()
        found = _batch(*self._arguments(number, _mesh()))
        truths, draws = (np.asarray(a)[: self.batch] for a in found)
        seconds = np.asarray(time.perf_counter() - began)
        return {"truths": truths, "draws": draws, "seconds": seconds}

    def identity(self) -> str:
        """A hash of what is computed, on however many devices."""
        arguments = self._arguments(0, None)
        # Of the program all but its arrays is in its text, in which functions have no address.
        program = _batch.lower(*arguments).as_text()
        names, arrays = tuple(self.quantities), jax.tree.leaves(eqx.filter(arguments, eqx.is_array))
        return fingerprint(names, program, arrays, self.key, self.batch)

    def parts(self) -> dict[str, Any]:
        """What it is made of, by the names that errors give them."""
        named = {f"quantity {name}": f for name, f in self.quantities.items()}
        return {"the problem": self.problem, "the sampler": self.sampler, **named}

    def _arguments(self, number: int, mesh: Mesh | None) -> tuple:
        devices = 1 if mesh is None else mesh.size
        # Every device has as many: those beyond the batch are cut off.
        rows = -(-self.batch // devices) * devices
        numbers = number * self.batch + jnp.arange(rows)
        # JAX would sort a dictionary.
        quantities = tuple(self.quantities), tuple(self.quantities.values())
        fixed = self.problem, self.sampler, *quantities, self.key
        if mesh is not None:
            arrays, others = eqx.partition(fixed, eqx.is_array)
            arrays = jax.device_put(arrays, NamedSharding(mesh, PartitionSpec()))
            fixed = eqx.combine(arrays, others)
            numbers = jax.device_put(numbers, NamedSharding(mesh, PartitionSpec(mesh.axis_names)))
        return *fixed, self.settings, numbers, mesh


def _shards(
    campaign: _Campaign,
    count: int,
    folder: str | os.PathLike | None,
    executor: Executor | None,
    progress: bool,
    limit: float | None,
) -> list[Shard]:
    """The batches of `count` simulations: those of the folder, and the others computed."""
    batch, names = campaign.batch, tuple(campaign.quantities)
    numbers = range(-(-count // batch))
    store = None if folder is None else Shards(folder, campaign.identity())
    shards = {} if store is None else store.found(len(numbers))
    missing = [i for i in numbers if i not in shards]
    if missing:
        _refuse_late(shards, count, batch, limit)
    # Closed, so that what has not begun is cancelled on an error.
    results = closing(completed(campaign, missing, executor))
    with _bar(progress) as bar, results as found:
        task = bar.add_task("simulations", total=count, completed=_done(shards, count, batch))
        for i, shard in found:
            asked = min(batch, count - i * batch)
            _refuse_nan(shard["truths"][:asked], shard["draws"][:asked], i * batch, names)
            if store is not None:
                store.put(i, shard)
            shards[i] = shard
            bar.advance(task, asked)
            if len(shards) < len(numbers):
                _refuse_late(shards, count, batch, limit)
    return [shards[i] for i in numbers]


def _batch_of(problem: Problem) -> int:
    unknowns = real_size(problem.prior.shape, problem.prior.dtype)
    return min(_BATCH, max(1, _BATCH_SIZE // unknowns))


def _done(shards: dict[int, Shard], count: int, batch: int) -> int:
    """How many of the `count` simulations asked for are in these batches, of which one is last."""
    return sum(min(batch, count - i * batch) for i in shards)


def _refuse_late(shards: dict[int, Shard], count: int, batch: int, limit: float | None) -> None:
    seconds = sum(float(shard["seconds"]) for shard in shards.values())
    if limit is None or seconds < limit:
        return
    done = _done(shards, count, batch)
    # A tenth more than in proportion, for batches differ.
    raise OutOfTime(
        f"{done} of {count} simulations took {seconds:.0f} s, of {limit:.0f} s that they were "
        f"given: give {1.1 * seconds * count / done:.0f} s for all"
    )


def _mesh() -> Mesh | None:
    """The devices that a batch is split over; None for one."""
    devices = jax.local_devices()
    if len(devices) == 1 or jax.config.jax_default_device is not None:
        return None
    return Mesh(np.asarray(devices), ("simulations",))


@eqx.filter_jit
def _batch(
    problem: Problem,
    sampler: Sampler | Drawer,
    names: tuple[str, ...],
    quantities: tuple[Quantity, ...],
    key: jax.Array,
    settings: Settings,
    numbers: jax.Array,
    mesh: Mesh | None,
) -> tuple[jax.Array, jax.Array]:
    def one(number: jax.Array) -> tuple[jax.Array, jax.Array]:
        key_joint, key_run = jax.random.split(jax.random.fold_in(key, number))
        if isinstance(problem, Enumerated):
            x, y = problem.numbered(key_joint, number)
        else:
            x, y = problem.simulate(key_joint)
        posterior = problem.condition(y)

        def asked(x: jax.Array) -> jax.Array:
            return values_of(names, quantities, x, posterior.y)

        # The truth first: a quantity that is no number is not the sampler's fault.
        truth = asked(x)
        return truth, recorded(sampler, posterior, key_run, settings, asked)

    if mesh is None:
        return jax.vmap(one)(numbers)
    # Every device loops as long as its own simulations do, and none waits for another.
    split = PartitionSpec(mesh.axis_names)
    return jax.shard_map(
        jax.vmap(one), mesh=mesh, in_specs=split, out_specs=split, check_vma=False
    )(numbers)


def recorded(
    sampler: Sampler | Drawer,
    posterior: Posterior,
    key: jax.Array,
    settings: Settings,
    record: Callable[[jax.Array], jax.Array] = lambda x: x,
) -> jax.Array:
    """`record` of each draw (chains, draws, ...) by a sampler, or by a function of draws.

    NaN for a draw that is not finite, whichever of its pixels `record` reads.
    Raises SamplerRefusal where the sampler refuses the posterior, ValueError for draws of a
    function that are no JAX array or have another shape, and for draws of another kind than the
    object.
    """

    def of_finite(x: jax.Array) -> jax.Array:
        _check_kind(x.dtype, posterior)
        return jnp.where(jnp.all(jnp.isfinite(x)), record(x), jnp.nan)

    if isinstance(sampler, Sampler):
        try:
            return whole_run(sampler, posterior, key, **settings._asdict(), record=of_finite)
        except ValueError as error:
            raise SamplerRefusal(" ".join(str(error).split())) from error
    draws = sampler(key, posterior)
    if not isinstance(draws, jax.Array):
        raise ValueError(
            f"the sampler gives a {type(draws).__name__}: give a JAX array of draws (chains, "
            f"draws, *{posterior.shape}), computed with jax.numpy"
        )
    if draws.ndim < 2 or draws.shape[2:] != posterior.shape:
        raise ValueError(
            f"the sampler gives draws of shape {draws.shape}: give (chains, draws, "
            f"*{posterior.shape})"
        )
    return jax.vmap(jax.vmap(of_finite))(draws)


def check_asked(problem: Problem, sampler: Sampler | Callable) -> None:
    """Refuse what is no problem, and what is no sampler."""
    if not isinstance(problem, Problem):
        raise ValueError(
            f"problem is a {type(problem).__name__}: give a Problem, which is there before any "
            "recording (of one recording, `posterior_sbc`)"
        )
    check_sampler(sampler)


def check_sampler(sampler: Sampler | Callable) -> None:
    """Refuse what is neither a sampler nor a function."""
    if isinstance(sampler, type):
        raise ValueError(f"sampler is the class {sampler.__name__}: give {sampler.__name__}(...)")
    if not isinstance(sampler, Sampler) and not callable(sampler):
        raise ValueError(
            f"sampler {sampler!r} is a {type(sampler).__name__}: give one of posterior.samplers, "
            "or a function"
        )


def _check_kind(dtype: np.dtype, posterior: Posterior) -> None:
    """Refuse draws of another kind than the object."""
    kind = np.complexfloating if posterior.prior.complex_valued else np.floating
    if not jnp.issubdtype(dtype, kind):
        raise ValueError(
            f"the sampler gives draws of {dtype}, the object is {posterior.dtype}: give draws of "
            "its kind"
        )


def _refuse_nan(truths: np.ndarray, draws: np.ndarray, first: int, names: tuple[str, ...]) -> None:
    for i, q in np.argwhere(np.isnan(truths)):
        raise ValueError(
            f"simulation {first + i}: {names[q]} of the object itself is NaN: give quantities that "
            "are defined for every object and recording"
        )
    for i, q in np.argwhere(np.isnan(draws).any(axis=(1, 2))):
        raise NonFiniteError(
            f"simulation {first + i}: {names[q]} of a draw is NaN, or the draw is not finite: the "
            "run diverged, give the sampler a smaller step"
        )


def _bar(show: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not show,
        transient=True,
        # A batch may take minutes: the speed is that of all of them.
        speed_estimate_period=float("inf"),
    )
