"""A sampler's draws beside exact ones, and what they cost: the figures that ranks do not give."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import rankdata

from ..checkpoint import fingerprint
from ..files import replace_whole
from ..models.gallery import Exact, Known
from ..problem import Problem
from ..samplers.base import PopulationSampler, Sampler
from .campaign import Drawer, Settings, recorded
from .convergence import ess
from .distance import sliced_wasserstein
from .mode_masses import mode_masses
from .quantities import Quantity
from .score_count import score_evaluations

RECORDINGS = 8


class Beside(NamedTuple):
    """Averages over 8 recordings; None where they could not be had.

    Where exact draws are by importance (`Known.basis`), some come twice, and floors are higher.

    `lost`: in how many of them a draw was not finite; nothing else is known then. `distance`:
    sliced Wasserstein distance from as many exact draws, over that of two exact sets of that size,
    and `distance_error` its standard error, from how it differs between recordings. `mode_error`:
    the largest error of a mode's mass, and `mode_floor` that of an exact set; None where the
    problem has one mode.

    `effective`: independent draws that a run is worth, the median over quantities. Of chains their
    bulk effective sample size (Vehtari et al. 2021); of draws that are runs of their own, and of a
    function's, their number; of populations, whose particles have common ancestors, the variance
    inside over that between them, as many times as there are populations. `evaluations`: prior
    score evaluations of a whole run on the first recording, warm-up included, counted as it runs
    (`score_evaluations`); 0 where it makes none.
    """

    lost: int = 0
    distance: float | None = None
    mode_error: float | None = None
    mode_floor: float | None = None
    effective: float | None = None
    evaluations: int | None = None
    distance_error: float | None = None


def beside_exact(
    known: Known,
    sampler: Sampler | Drawer,
    key: jax.Array,
    settings: Settings,
    quantities: Mapping[str, Quantity],
    file: str | os.PathLike | None = None,
) -> Beside:
    """Compare with `known.exact` on 8 recordings drawn with `key`.

    `file`: the figures are kept there, as JSON, and are not computed again for the same problem,
    sampler, key and settings.
    """
    problem = Problem(known.likelihood, known.prior)
    keys = jax.random.split(key, RECORDINGS)
    asked = tuple(quantities.values())
    lowered = _compared.lower(problem, known.exact, sampler, asked, settings, keys)
    own = sampler if isinstance(sampler, Sampler) else None
    guard = fingerprint(lowered.as_text(), problem, asked, keys, own, known.modes)
    if (kept := _read(file, guard)) is not None:
        return kept
    compared = lowered.compile()(problem, known.exact, sampler, asked, settings, keys)
    found = _figures(known, sampler, *(np.asarray(part) for part in compared))
    if not found.lost:
        found = found._replace(evaluations=_evaluations(problem, sampler, settings, keys[0]))
    if file is not None:
        _write(file, guard, found)
    return found


@eqx.filter_jit
def _compared(
    problem: Problem,
    exact: Exact,
    sampler: Sampler | Drawer,
    quantities: tuple[Quantity, ...],
    settings: Settings,
    keys: jax.Array,
) -> tuple[jax.Array, ...]:
    """Draws (recordings, chains, n, *shape), their quantities, and two exact sets as large."""

    def one(key: jax.Array) -> tuple[jax.Array, ...]:
        keys = jax.random.split(key, 4)
        posterior = problem.condition(problem.simulate(keys[0])[1])
        draws = recorded(sampler, posterior, keys[1], settings)

        def ask(x: jax.Array) -> jax.Array:
            return jnp.stack([f(x, posterior.y) for f in quantities])

        count = draws.shape[0] * draws.shape[1]
        sets = (exact(k, posterior.y, count) for k in keys[2:])
        return draws, jax.vmap(jax.vmap(ask))(draws), *sets

    return jax.vmap(one)(keys)


def _figures(
    known: Known,
    sampler: Sampler | Drawer,
    draws: np.ndarray,
    values: np.ndarray,
    exact: np.ndarray,
    others: np.ndarray,
) -> Beside:
    lost = int(np.sum(~np.isfinite(draws.reshape(len(draws), -1)).all(axis=1)))
    if lost:
        return Beside(lost)
    rng = np.random.default_rng(0)
    draws = draws.reshape(others.shape)
    apart, floor = (
        np.array([sliced_wasserstein(a, b, rng) for a, b in zip(part, exact)])
        for part in (draws, others)
    )
    errors: tuple[float | None, float | None] = (None, None)
    if known.modes is not None:
        masses, *beside = (
            np.array([mode_masses(a, known.modes) for a in part]) for part in (exact, draws, others)
        )
        errors = tuple(float(np.abs(m - masses).max(axis=1).mean()) for m in beside)
    distance, error = ratio_of_means(apart, floor)
    return Beside(lost, distance, *errors, effective_draws(sampler, values), distance_error=error)


def ratio_of_means(above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """mean(above) / mean(below) of pairs (n,), and its standard error, to first order in 1/n."""
    ratio = above.mean() / below.mean()
    # What a pair is off the common ratio; the pairs are independent, their members are not.
    off = above - ratio * below
    return float(ratio), float(off.std(ddof=1) / np.sqrt(len(off)) / below.mean())


def effective_draws(sampler: Sampler | Drawer, values: np.ndarray) -> float | None:
    """Independent draws that a run is worth, from quantities (recordings, chains, draws, Q).

    As `Beside.effective`; None of a single population, whose ancestors cannot be told.
    """
    _, chains, draws, _ = values.shape
    # A density of 0 has a rank too: the lowest.
    values = np.nan_to_num(values)
    if isinstance(sampler, PopulationSampler):
        return _of_populations(values) if chains > 1 else None
    if not isinstance(sampler, Sampler) or sampler.independent or draws == 1:
        return float(chains * draws)
    if not np.ptp(values) > 0:
        return 1.0
    # Draws that never move are one draw.
    by_run = np.nan_to_num(ess(np.moveaxis(values, 0, 2)), nan=1.0)
    return float(np.median(by_run.mean(axis=0)))


def _of_populations(values: np.ndarray) -> float:
    _, populations, size, _ = values.shape
    # By ranks, as R-hat: of a density of 0 there is no variance.
    flat = values.reshape(len(values), populations * size, -1)
    values = rankdata(flat, axis=1).reshape(values.shape)
    inside = values.var(axis=(1, 2))
    between = values.mean(axis=2).var(axis=1, ddof=1)
    ratio = np.where(inside > 0, between / np.where(inside > 0, inside, 1.0), 1.0).mean(axis=0)
    # Of few recordings the ratio may fall below that of independent particles.
    return float(np.median(populations * np.minimum(1 / np.maximum(ratio, 1 / size), size)))


def _evaluations(
    problem: Problem, sampler: Sampler | Drawer, settings: Settings, key: jax.Array
) -> int:
    keys = jax.random.split(key, 4)
    posterior = problem.condition(problem.simulate(keys[0])[1])
    return score_evaluations(lambda p: recorded(sampler, p, keys[1], settings), posterior)


def _read(file: str | os.PathLike | None, guard: str) -> Beside | None:
    if file is None or not Path(file).exists():
        return None
    kept = json.loads(Path(file).read_text())
    # Figures of another sampler or key, or fewer than there are now, are computed anew: they are
    # cheap beside the simulations.
    same = kept["fingerprint"] == guard and set(kept["figures"]) == set(Beside._fields)
    return Beside(**kept["figures"]) if same else None


def _write(file: str | os.PathLike, guard: str, found: Beside) -> None:
    kept: dict[str, Any] = {"fingerprint": guard, "figures": found._asdict()}
    replace_whole(file, lambda part: Path(part).write_text(json.dumps(kept, indent=1)))
