"""A sampler's certificate: its verdict on each problem of the gallery, and the figures behind."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models.gallery import GALLERY, Known
from ..problem import Problem
from ..samplers.base import RunSampler, Sampler
from ..sampling import NonFiniteError
from .campaign import Drawer, SamplerRefusal, Settings, recorded
from .distance import sliced_wasserstein
from .quantities import DistanceTo, default_quantities
from .sbc import Calibration, sbc

LEVELS = (0.5, 0.8, 0.95)
_RECORDINGS = 8


class Certificate(NamedTuple):
    """What a sampler is worth on one problem.

    `verdict`: passes, fails, cannot be judged (`Calibration.verdict`), or does not apply, with the
    sampler's own reason. `distance`: sliced Wasserstein distance from as many exact draws, over
    that of two exact sets of that size, on average over 8 recordings: 1 is as good as exact and
    independent. `mode_error`: the largest error of a mode's mass, on average over them, and
    `mode_floor` that of an exact set; None where the problem has one mode. `seconds` of the
    simulations, compilation included.
    """

    verdict: str
    calibration: Calibration | None = None
    distance: float | None = None
    mode_error: float | None = None
    mode_floor: float | None = None
    seconds: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for JSON; p-values and coverage of every quantity among them."""
        plain = self._asdict() | {"calibration": None}
        if (found := self.calibration) is not None:
            coverage = {f"{level:g}": found.coverage(level) for level in LEVELS}
            plain["calibration"] = {
                name: {
                    "p": p,
                    "draws": float(draws),
                    "coverage": {level: shares[name][0] for level, shares in coverage.items()},
                }
                for (name, p), draws in zip(found.p.items(), found.effective)
            }
            plain["simulations"] = len(found.ranks)
        return plain


def certify(
    sampler: Sampler | Drawer,
    problems: Mapping[str, Known] | None = None,
    key: jax.Array | None = None,
    simulations: int = 200,
    *,
    settings: Settings | None = None,
    alpha: float = 0.05,
    folder: str | os.PathLike | None = None,
    progress: bool = True,
) -> dict[str, Certificate]:
    """The certificates of `sampler` on `problems`, by name; None: all of `models.gallery.GALLERY`.

    `sampler`: one of `posterior.samplers`, or a function (key, posterior) -> (chains, draws,
    *shape) of independent draws, traceable by JAX. `settings`: of a run; None: `settings_of` it.
    `key` None: key 0. `alpha`: with that probability at most an exact sampler fails on any of the
    problems, each being tested at its share. `folder`: the simulations of each problem are kept
    there, and a certificate that was interrupted goes on.
    """
    key = jax.random.key(0) if key is None else key
    problems = {name: build() for name, build in GALLERY.items()} if problems is None else problems
    settings = settings_of(sampler) if settings is None else settings
    found = {}
    for name, known in problems.items():
        place = None if folder is None else Path(folder) / file_name(name)
        share = alpha / len(problems)
        found[name] = _certificate(
            sampler, known, key, simulations, settings, share, place, progress
        )
    return found


def settings_of(sampler: Sampler | Drawer) -> Settings:
    """Of a run: twenty draws where each is a run of its own, otherwise four chains of a hundred."""
    if isinstance(sampler, RunSampler):
        return Settings(chains=20, draws=1, warmup=0)
    return Settings(chains=4, draws=100, warmup=500, thin=5)


def as_table(certificates: Mapping[str, Mapping[str, Certificate]]) -> str:
    """Markdown: a row for each sampler and problem of {sampler: {problem: certificate}}."""
    rows = [
        "| sampler | problem | verdict | coverage of 50, 80, 95 % where worst "
        "| distance over floor | error of modes | its floor | s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for sampler, by_problem in certificates.items():
        for problem, found in by_problem.items():
            cells = [sampler, problem, found.verdict, _worst_coverage(found)]
            cells += [_said(found.distance, ".2f"), _said(found.mode_error, ".2f")]
            cells += [_said(found.mode_floor, ".2f"), _said(found.seconds, ".0f")]
            rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _certificate(
    sampler: Sampler | Drawer,
    known: Known,
    key: jax.Array,
    simulations: int,
    settings: Settings,
    alpha: float,
    folder: Path | None,
    progress: bool,
) -> Certificate:
    problem = Problem(known.likelihood, known.prior)
    quantities = default_quantities(problem)
    if known.modes is not None:
        quantities["distance to a mode"] = DistanceTo(jnp.asarray(known.modes[0]))
    try:
        calibration = sbc(
            problem, sampler, key, simulations, quantities=quantities,
            folder=folder, progress=progress, **settings._asdict(),
        )  # fmt: skip
    except SamplerRefusal as error:
        return Certificate(f"does not apply: {error}")
    except NonFiniteError as error:
        return Certificate(f"fails: {error}")
    keys = jax.random.split(jax.random.fold_in(key, 2**31 + 1), _RECORDINGS)
    draws, exact, others = (
        np.asarray(part) for part in _beside_exact(problem, known.exact, sampler, settings, keys)
    )
    if not np.all(np.isfinite(draws)):
        lost = int(np.sum(~np.isfinite(draws.reshape(len(draws), -1)).all(axis=1)))
        verdict = f"fails: draws of {lost} in {_RECORDINGS} recordings are not finite"
        return Certificate(verdict, calibration, seconds=calibration.seconds)
    rng = np.random.default_rng(0)
    distances = [
        np.mean([sliced_wasserstein(a, b, rng) for a, b in zip(part, exact)])
        for part in (draws, others)
    ]
    errors: tuple[float | None, float | None] = (None, None)
    if known.modes is not None:
        masses, *beside = (_masses(part, known.modes) for part in (exact, draws, others))
        errors = tuple(float(np.abs(m - masses).max(axis=1).mean()) for m in beside)
    distance = float(distances[0] / distances[1])
    verdict = calibration.verdict(alpha)
    return Certificate(verdict, calibration, distance, *errors, calibration.seconds)


@eqx.filter_jit
def _beside_exact(
    problem: Problem, exact: Any, sampler: Sampler | Drawer, settings: Settings, keys: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Draws (recordings, n, *shape) by the sampler, and two exact sets as large."""

    def one(key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        keys = jax.random.split(key, 4)
        posterior = problem.condition(problem.simulate(keys[0])[1])
        values = recorded(sampler, posterior, keys[1], settings).reshape(-1, *posterior.shape)
        return values, *(exact(k, posterior.y, len(values)) for k in keys[2:])

    return jax.vmap(one)(keys)


def _masses(draws: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """Shares (recordings, modes) of the draws (recordings, n, *shape) that are nearest to each."""
    apart = np.abs(draws[:, :, None] - modes).reshape(*draws.shape[:2], len(modes), -1)
    nearest = (apart**2).sum(axis=-1).argmin(axis=-1)
    return (nearest[..., None] == np.arange(len(modes))).mean(axis=1)


def _worst_coverage(found: Certificate) -> str:
    if found.calibration is None:
        return ""
    p = found.calibration.p
    worst = min(p, key=p.__getitem__)
    shares = (found.calibration.coverage(level)[worst][0] for level in LEVELS)
    return ", ".join(f"{100 * share:.0f}" for share in shares)


def _said(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def file_name(name: str) -> str:
    """The name of a problem, as a file may have it."""
    return "".join(c if c.isalnum() else "-" for c in name)
