"""sample(): run a sampler on a posterior, in compiled chunks, with progress and checkpoints."""

import os
import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from .checkpoint import Checkpoint, fingerprint
from .draws import Draws, versions
from .problem import Posterior
from .samplers import Ensemble
from .samplers.base import (
    PopulationSampler,
    Sampler,
    chain_keys,
    fold_each,
    populations,
    positions,
    vmap_init,
    vmap_own_warmup,
    vmap_population,
    vmap_step,
)
from .samplers.checks import check_run

_CHUNK_SECONDS = 2.0
_BUFFER_BYTES = 64 * 2**20
_BUFFER_DRAWS = 1024


class NonFiniteError(ArithmeticError):
    """A chain became infinite or NaN."""


def sample(
    posterior: Posterior,
    sampler: Sampler,
    key: jax.Array,
    *,
    chains: int = 4,
    draws: int = 1000,
    warmup: int | None = None,
    thin: int = 1,
    keep: bool = True,
    start: jax.Array | None = None,
    progress: bool = True,
    checkpoint: str | os.PathLike | None = None,
) -> Draws:
    """Draw from a posterior.

    `chains` run vectorised; each gives `draws` draws, one every `thin` steps (samplers whose draw
    is the end of a path of its own: every `thin` paths). `warmup` steps (None: the sampler's own
    default) tune the sampler, or are discarded where there is nothing to tune. `start`: object
    shape, or with a leading chain axis. With `keep=False` only streaming mean and variance are
    held. `checkpoint`: a folder; a run killed at any moment goes on from there bit-identically.

    Same key, same draws; chain i depends on `fold_in(key, i)` alone, adaptation apart, which is
    pooled. Raises ValueError on bad settings before any work, NonFiniteError if a chain diverges.
    """
    check_run(chains, draws, thin, warmup)
    if not isinstance(posterior, Posterior):
        raise ValueError(f"posterior is a {type(posterior).__name__}: use problem.condition(y)")
    if not isinstance(sampler, Sampler):
        raise ValueError(f"sampler is a {type(sampler).__name__}: use one of posterior.samplers")
    warmup = sampler.default_warmup() if warmup is None else warmup
    start = _checked_start(start, posterior, chains)
    # No chain has this key.
    sampler.check(jax.random.fold_in(key, 2**31), posterior, None if start is None else start[0])
    plan = _Plan(sampler, chains, draws, warmup, thin, keep, progress)
    began = time.perf_counter()
    if isinstance(sampler, Ensemble):
        run = _run_ensemble
    elif isinstance(sampler, PopulationSampler):
        run = _run_population
    else:
        run = _run_chains
    values, mean, variance, stats = run(plan, posterior, key, start, checkpoint)
    settings = {
        "sampler": _describe(sampler),
        "chains": chains,
        "draws": draws,
        "warmup": warmup,
        "thin": thin,
        "key": np.asarray(jax.random.key_data(key)).tolist(),
        "seconds": round(time.perf_counter() - began, 3),
        "versions": versions(),
    }
    return Draws.build(values, mean, variance, stats, np.asarray(posterior.y), settings)


class _Plan(NamedTuple):
    """The settings of a run."""

    sampler: Sampler
    chains: int
    draws: int
    warmup: int
    thin: int
    keep: bool
    progress: bool

    def identity(self) -> tuple:
        """What makes two runs the same; more draws of one run are still the same run."""
        return (repr(self.sampler), self.sampler, self.chains, self.warmup, self.thin, self.keep)


class _Moments(NamedTuple):
    """Running mean and sum of squares of every chain (Re and Im apart)."""

    count: jax.Array
    mean: jax.Array
    squares: jax.Array


class _Run(NamedTuple):
    """Where a run of chains stands; all of it is in the checkpoint but the posterior."""

    states: Any
    adapted: Any
    warmed: jax.Array
    step: jax.Array
    bad_step: jax.Array
    moments: _Moments


Result = tuple[np.ndarray | None, np.ndarray, np.ndarray, dict[str, np.ndarray]]


# ---- chains -------------------------------------------------------------------------------------


def _run_chains(
    plan: _Plan,
    posterior: Posterior,
    key: jax.Array,
    start: jax.Array | None,
    checkpoint: str | os.PathLike | None,
) -> Result:
    keys = chain_keys(key, plan.chains)
    run = _begin(plan.sampler, keys, posterior, start)
    store, pieces = None, []
    if checkpoint is not None:
        store = Checkpoint(checkpoint, fingerprint(plan.identity(), posterior, key, start))
        found = store.load(_without_posterior(run))
        if found is not None:
            run = _with_posterior(found[0], posterior)
            pieces = store.shards(found[1])
    per_draw = plan.sampler.steps_per_draw() * plan.thin
    adaptation = plan.sampler.adaptation()
    warm_total = plan.warmup if adaptation is None else adaptation.steps(plan.warmup)
    warm_total = warm_total if plan.warmup else 0
    total = plan.draws * per_draw
    if int(run.step) > total:
        raise ValueError(
            f"checkpoint {checkpoint} already holds {int(run.step) // per_draw} draws: "
            "ask for that many or more"
        )
    with _bar(plan.progress) as bar:
        task = bar.add_task("warm-up", total=warm_total + total, note="")

        def report(run: _Run, note: str) -> None:
            done = int(run.warmed) + int(run.step)
            name = "drawing" if int(run.warmed) >= warm_total else "warm-up"
            bar.update(task, completed=done, description=name, note=note)

        def save(run: _Run, new: dict[str, np.ndarray] | None) -> None:
            if store is not None:
                store.save(_without_posterior(run), len(pieces), new)

        report(run, "")
        if plan.sampler.tunes_itself() and warm_total and not int(run.warmed):
            run = _own_warmup(plan.sampler, plan.warmup, run, keys)
            save(run, None)
        pace = _Pace()
        while int(run.warmed) < warm_total:
            count = min(pace.steps(), warm_total - int(run.warmed))
            with pace.timing(count):
                run = _warm(plan.sampler, plan.warmup, run, keys, jnp.asarray(count))
                _refuse_non_finite(run, "warm-up", store)
            if int(run.warmed) == warm_total:
                run = _finish_warmup(plan.sampler, run)
            save(run, None)
            report(run, "")
        pace = _Pace()
        size = int(np.prod(posterior.shape)) * np.dtype(posterior.dtype).itemsize
        # Not the number of draws: another number of them needs no new compilation.
        capacity = int(np.clip(_BUFFER_BYTES // (plan.chains * size), 1, _BUFFER_DRAWS))
        while int(run.step) < total:
            step = int(run.step)
            room = capacity * per_draw - step % per_draw
            count = min(pace.steps(), room, total - step)
            with pace.timing(count):
                run, buffer, infos, filled = _advance(
                    plan.sampler,
                    run,
                    keys,
                    jnp.asarray(count),
                    per_draw,
                    capacity if plan.keep else 0,
                    capacity,
                )
                _refuse_non_finite(run, "drawing", store)
            filled = int(filled)
            new = None
            if filled:
                new = {f"stat_{k}": np.asarray(v[:filled]) for k, v in infos.items()}
                if plan.keep:
                    new["draws"] = np.asarray(buffer[:filled])
                pieces.append(new)
            save(run, new)
            report(run, _acceptance_note(_last_acceptance(new)))
    return _collect(plan, run, pieces)


def _collect(plan: _Plan, run: _Run, pieces: list[dict[str, np.ndarray]]) -> Result:
    joined = {name: np.concatenate([p[name] for p in pieces])[: plan.draws] for name in pieces[0]}
    # Pieces are (draws, chains, ...); results are (chains, draws, ...).
    values = np.swapaxes(joined.pop("draws"), 0, 1) if plan.keep else None
    stats = {name.removeprefix("stat_"): np.swapaxes(v, 0, 1) for name, v in joined.items()}
    count = np.maximum(np.asarray(run.moments.count) - 1, 1)
    return values, np.asarray(run.moments.mean), np.asarray(run.moments.squares) / count, stats


@eqx.filter_jit
def _begin(
    sampler: Sampler, keys: jax.Array, posterior: Posterior, start: jax.Array | None
) -> _Run:
    states = vmap_init(sampler, fold_each(keys, 0), posterior, start)
    at = positions(sampler, states)
    adaptation = sampler.adaptation()
    zero = jnp.zeros((), jnp.int32)
    return _Run(
        states=states,
        adapted=None if adaptation is None else adaptation.init(states),
        warmed=zero,
        step=zero,
        bad_step=zero - 1,
        moments=_Moments(
            jnp.zeros((), at.real.dtype),
            jnp.zeros_like(at),
            jnp.zeros_like(at),
        ),
    )


@eqx.filter_jit
def _warm(sampler: Sampler, warmup: int, run: _Run, keys: jax.Array, count: jax.Array) -> _Run:
    """`count` warm-up steps of every chain."""
    keys = fold_each(keys, 1)
    adaptation = sampler.adaptation()

    def body(carry: tuple) -> tuple:
        i, run = carry
        step_keys = fold_each(keys, run.warmed)
        if adaptation is None:
            states, info = vmap_step(sampler, step_keys, run.states)
            adapted = run.adapted
        else:
            states, adapted = adaptation.step(
                run.warmed, warmup, step_keys, run.states, run.adapted
            )
        bad = jnp.where(_all_finite(sampler, states), -1, run.warmed)
        run = run._replace(states=states, adapted=adapted, warmed=run.warmed + 1, bad_step=bad)
        return i + 1, run

    return jax.lax.while_loop(lambda c: (c[0] < count) & (c[1].bad_step < 0), body, (0, run))[1]


@eqx.filter_jit
def _own_warmup(sampler: Sampler, warmup: int, run: _Run, keys: jax.Array) -> _Run:
    """Every chain after the sampler's own warm-up, which counts as the whole."""
    states = vmap_own_warmup(sampler, fold_each(keys, 1), run.states, warmup)
    return run._replace(states=states, warmed=run.warmed + warmup)


@eqx.filter_jit
def _finish_warmup(sampler: Sampler, run: _Run) -> _Run:
    adaptation = sampler.adaptation()
    if adaptation is None:
        return run
    return run._replace(states=adaptation.finish(run.states, run.adapted))


@eqx.filter_jit
def _advance(
    sampler: Sampler,
    run: _Run,
    keys: jax.Array,
    count: jax.Array,
    per_draw: int,
    kept: int,
    capacity: int,
) -> tuple[_Run, jax.Array | None, dict[str, jax.Array], jax.Array]:
    """`count` steps of every chain; the draws among them in a buffer, with their statistics."""
    keys = fold_each(keys, 2)
    at = jax.eval_shape(lambda s: positions(sampler, s), run.states)
    _, info = jax.eval_shape(lambda k, s: vmap_step(sampler, k, s), keys, run.states)
    buffer = jnp.zeros((kept, *at.shape), at.dtype) if kept else None
    infos = {k: jnp.zeros((capacity, *v.shape), v.dtype) for k, v in info._asdict().items()}

    def body(carry: tuple) -> tuple:
        i, filled, run, buffer, infos = carry
        states, info = vmap_step(sampler, fold_each(keys, run.step), run.states)
        bad = jnp.where(_all_finite(sampler, states), -1, run.step)
        run = run._replace(states=states, step=run.step + 1, bad_step=bad)

        def record(filled: jax.Array, moments: _Moments, buffer: Any, infos: Any) -> tuple:
            position = positions(sampler, states)
            if kept:
                buffer = buffer.at[filled].set(position)
            infos = {k: infos[k].at[filled].set(v) for k, v in info._asdict().items()}
            return filled + 1, _update(moments, position), buffer, infos

        filled, moments, buffer, infos = jax.lax.cond(
            run.step % per_draw == 0, record, lambda *a: a, filled, run.moments, buffer, infos
        )
        return i + 1, filled, run._replace(moments=moments), buffer, infos

    _, filled, run, buffer, infos = jax.lax.while_loop(
        lambda c: (c[0] < count) & (c[2].bad_step < 0),
        body,
        (0, jnp.zeros((), jnp.int32), run, buffer, infos),
    )
    return run, buffer, infos, filled


def _update(moments: _Moments, x: jax.Array) -> _Moments:
    """Welford's step, Re and Im apart."""
    count = moments.count + 1
    delta = x - moments.mean
    mean = moments.mean + delta / count
    rest = x - mean
    if jnp.iscomplexobj(x):
        product = jax.lax.complex(delta.real * rest.real, delta.imag * rest.imag)
    else:
        product = delta * rest
    return _Moments(count, mean, moments.squares + product)


# ---- populations --------------------------------------------------------------------------------


def _run_population(
    plan: _Plan,
    posterior: Posterior,
    key: jax.Array,
    start: jax.Array | None,
    checkpoint: str | os.PathLike | None,
) -> Result:
    if start is not None:
        raise ValueError(f"{type(plan.sampler).__name__} starts from the prior: leave out start=")
    if not plan.keep or plan.thin > 1:
        raise ValueError(
            f"{type(plan.sampler).__name__} draws a population at once: leave out keep= and thin="
        )
    keys = chain_keys(key, plan.chains)
    states, step = _begin_population(plan.sampler, fold_each(keys, 0), posterior, plan.draws), 0
    store = None
    if checkpoint is not None:
        identity = fingerprint(plan.identity(), plan.draws, posterior, key)
        store = Checkpoint(checkpoint, identity)
        found = store.load((states._replace(posterior=None), np.asarray(0)))
        if found is not None:
            states, step = found[0][0]._replace(posterior=posterior), int(found[0][1])
    with _bar(plan.progress) as bar:
        task = bar.add_task("tempering", total=1.0, note="")
        while not bool(jnp.all(states.done)):
            states, info = _step_population(
                plan.sampler, fold_each(fold_each(keys, 1), step), states
            )
            step += 1
            if not bool(jnp.all(jnp.isfinite(states.inner.particles))):
                raise NonFiniteError(_non_finite_sentence("tempering", step, store))
            if store is not None:
                store.save((states._replace(posterior=None), np.asarray(step)), 0, None)
            note = f"step {step}, {_acceptance_note(jnp.mean(info.acceptance_rate))}"
            bar.update(task, completed=float(jnp.min(info.temperature)), note=note)
    values = np.asarray(populations(plan.sampler, states))
    return values, *_moments_of(values), {}


_begin_population = eqx.filter_jit(vmap_population)


@eqx.filter_jit
def _step_population(sampler: PopulationSampler, keys: jax.Array, states: Any) -> tuple:
    return vmap_step(sampler, keys, states)


# ---- emcee --------------------------------------------------------------------------------------


def _run_ensemble(
    plan: _Plan,
    posterior: Posterior,
    key: jax.Array,
    start: jax.Array | None,
    checkpoint: str | os.PathLike | None,
) -> Result:
    if not plan.keep:
        raise ValueError("Ensemble holds all its draws: leave out keep=False")
    walkers = plan.sampler.size(posterior)
    kept = -(-plan.draws // walkers)
    values, rates = [], []
    for i, chain_key in enumerate(chain_keys(key, plan.chains)):
        path = None
        if checkpoint is not None:
            identity = fingerprint(plan.identity(), posterior, key, start)
            path = Checkpoint(checkpoint, identity).path / f"chain-{i}.h5"
        position = None if start is None else start[i]
        iterations = plan.warmup + kept * plan.thin
        chain, rate = plan.sampler.run(
            chain_key, posterior, iterations, position, path, plan.progress
        )
        thinned = chain[plan.warmup + plan.thin - 1 :: plan.thin]
        # Walker by walker, so that neighbours among the draws are neighbours in time.
        thinned = np.swapaxes(thinned, 0, 1)
        values.append(thinned.reshape(-1, *posterior.shape)[: plan.draws])
        rates.append(np.full(plan.draws, np.mean(rate)))
    values = np.stack(values)
    return values, *_moments_of(values), {"acceptance_rate": np.stack(rates)}


# ---- small parts --------------------------------------------------------------------------------


class _Pace:
    """Chooses how many steps a compiled call takes, so that it lasts about two seconds."""

    def __init__(self):
        self.rate = None
        self.compiled = False

    def steps(self) -> int:
        return 8 if self.rate is None else max(1, int(self.rate * _CHUNK_SECONDS))

    def timing(self, count: int) -> Any:
        pace = self

        class Timer:
            def __enter__(self):
                self.began = time.perf_counter()

            def __exit__(self, *error):
                # The first call compiles: its time says nothing.
                if pace.compiled:
                    rate = count / max(time.perf_counter() - self.began, 1e-6)
                    most = 8 * (pace.rate or rate)
                    pace.rate = min(rate, most)
                pace.compiled = True

        return Timer()


def _all_finite(sampler: Sampler, states: Any) -> jax.Array:
    return jnp.all(jnp.isfinite(positions(sampler, states)))


def _moments_of(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of every chain, the variance of Im in the imaginary part."""
    if np.iscomplexobj(values):
        variance = values.real.var(axis=1, ddof=1) + 1j * values.imag.var(axis=1, ddof=1)
    else:
        variance = values.var(axis=1, ddof=1)
    return values.mean(axis=1), variance.astype(values.dtype)


def _without_posterior(run: _Run) -> _Run:
    return run._replace(states=run.states._replace(posterior=None))


def _with_posterior(run: _Run, posterior: Posterior) -> _Run:
    return run._replace(states=run.states._replace(posterior=posterior))


def _refuse_non_finite(run: _Run, phase: str, store: Checkpoint | None) -> None:
    if int(run.bad_step) >= 0:
        raise NonFiniteError(_non_finite_sentence(phase, int(run.bad_step), store))


def _non_finite_sentence(phase: str, step: int, store: Checkpoint | None) -> str:
    kept = f"; the last good state is kept in {store.path}" if store else ""
    return (
        f"a chain became infinite or NaN at step {step} of {phase}: "
        f"the step size is probably too large, try a tenth of it{kept}"
    )


def _checked_start(start: jax.Array | None, posterior: Posterior, chains: int) -> jax.Array | None:
    if start is None:
        return None
    start = jnp.asarray(start)
    if start.shape == posterior.shape:
        start = jnp.broadcast_to(start, (chains, *posterior.shape))
    if start.shape != (chains, *posterior.shape):
        raise ValueError(
            f"start of shape {start.shape}: give {posterior.shape}, "
            f"or {(chains, *posterior.shape)} with one a chain"
        )
    if not bool(jnp.all(jnp.isfinite(start))):
        raise ValueError("start holds NaN or infinity: every entry must be finite")
    if jnp.iscomplexobj(start) and not jnp.issubdtype(posterior.dtype, jnp.complexfloating):
        raise ValueError("start is complex, the object is real: take the real part")
    return start.astype(posterior.dtype)


def _describe(sampler: Sampler) -> str:
    return eqx.tree_pformat(sampler, short_arrays=True).replace("\n", " ")


def _last_acceptance(new: dict[str, np.ndarray] | None) -> float:
    rates = None if new is None else new.get("stat_acceptance_rate")
    return np.nan if rates is None else float(np.mean(rates))


def _acceptance_note(rate: jax.Array | float) -> str:
    rate = float(rate)
    return "" if np.isnan(rate) else f"acceptance {rate:.2f}"


def _bar(show: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=Console(stderr=True),
        disable=not show,
        transient=True,
    )
