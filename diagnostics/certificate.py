"""A sampler's certificate: its verdict on each problem of the gallery, and the figures behind."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..models.gallery import GALLERY, Known, file_name
from ..problem import Problem
from ..samplers.base import RunSampler, Sampler
from ..sampling import NonFiniteError
from .beside_exact import RECORDINGS, beside_exact
from .campaign import Drawer, OutOfTime, SamplerRefusal, Settings, check_sampler
from .quantities import DistanceTo, default_quantities
from .sbc import Calibration, sbc

LEVELS = (0.5, 0.8, 0.95)
VERDICTS = ("passes", "fails", "cannot be judged", "does not apply")


class Certificate(NamedTuple):
    """What a sampler is worth on one problem.

    `verdict`: passes; fails, in what and by how much; cannot be judged at this budget, and at which
    it could; or does not apply, with the sampler's own reason. `distance`: sliced Wasserstein
    distance from as many exact draws, over that of two exact sets of that size, on average over 8
    recordings: 1 is as good as exact and independent; `distance_error`: its standard error, from
    how it differs between recordings. `mode_error`: the largest error of a mode's
    mass, on average over them, and `mode_floor` that of an exact set; None where the problem has
    one mode. `seconds` of the simulations, compilation included. `effective`: independent draws
    that a run is worth, the median over quantities, and `evaluations`: its prior score evaluations,
    warm-up included, counted as it runs (`beside_exact.Beside`).
    """

    verdict: str
    calibration: Calibration | None = None
    distance: float | None = None
    mode_error: float | None = None
    mode_floor: float | None = None
    seconds: float | None = None
    effective: float | None = None
    evaluations: int | None = None
    distance_error: float | None = None

    @property
    def kind(self) -> str:
        """The verdict in a word: one of `VERDICTS`."""
        return next(kind for kind in VERDICTS if self.verdict.startswith(kind))

    @property
    def p(self) -> float | None:
        """p-value over all quantities judged: the smallest of those adjusted for their number.

        None where no quantity has draws enough to be judged.
        """
        judged = {} if self.calibration is None else self.calibration.judged_p
        return min(judged.values(), default=None)

    @property
    def effective_per_evaluation(self) -> float | None:
        """Independent draws per prior score evaluation; None where a run makes none."""
        if self.effective is None or not self.evaluations:
            return None
        return self.effective / self.evaluations

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for JSON; p-values and coverage of every quantity among them.

        A quantity of too few draws to be judged has no p.
        """
        plain = self._asdict() | {"calibration": None, "p": self.p}
        plain["effective_per_evaluation"] = self.effective_per_evaluation
        if (found := self.calibration) is not None:
            coverage = {f"{level:g}": found.coverage(level) for level in LEVELS}
            judged = found.judged_p
            plain["calibration"] = {
                name: {
                    "p": judged.get(name),
                    "draws": float(draws),
                    "coverage": {level: shares[name][0] for level, shares in coverage.items()},
                }
                for name, draws in zip(found.names, found.effective)
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
    limit: float | None = None,
    folder: str | os.PathLike | None = None,
    progress: bool = True,
) -> dict[str, Certificate]:
    """The certificates of `sampler` on `problems`, by name; None: all of `models.gallery.GALLERY`.

    `sampler`: one of `posterior.samplers`, or a function (key, posterior) -> (chains, draws,
    *shape) of independent draws, traceable by JAX. `settings`: of a run; None: `settings_of` it.
    `key` None: key 0. `alpha`: with that probability at most an exact sampler fails on any of the
    problems, each being tested at its share. `limit`: the seconds after which no simulations of a
    problem begin, which then cannot be judged, or None. `folder`: the simulations of each problem
    and its other figures are kept there; a certificate that was interrupted goes on, and repeats
    nothing.
    Raises ValueError for no problems, for what is none or no sampler, and as `sbc` does.
    """
    check_sampler(sampler)
    key = jax.random.key(0) if key is None else key
    problems = {name: build() for name, build in GALLERY.items()} if problems is None else problems
    if not problems:
        raise ValueError(
            "no problems to certify on: give {name: Known}, or None for all of the gallery"
        )
    for name, known in problems.items():
        if not isinstance(known, Known):
            raise ValueError(
                f"problem {name} is a {type(known).__name__}: give a models.gallery.Known, a "
                "likelihood and a prior with exact draws"
            )
    settings = settings_of(sampler) if settings is None else settings
    found = {}
    for name, known in problems.items():
        place = None if folder is None else Path(folder) / file_name(name)
        share = alpha / len(problems)
        found[name] = _certificate(
            sampler, known, key, simulations, settings, share, limit, place, progress
        )
    return found


def settings_of(sampler: Sampler | Drawer) -> Settings:
    """Of a run: twenty draws where each is a run of its own, otherwise four chains of a hundred."""
    if isinstance(sampler, RunSampler):
        # The sampler's own warm-up: without it, a polish would accept nothing.
        return Settings(chains=20, draws=1)
    return Settings(chains=4, draws=100, warmup=500, thin=5)


def _certificate(
    sampler: Sampler | Drawer,
    known: Known,
    key: jax.Array,
    simulations: int,
    settings: Settings,
    alpha: float,
    limit: float | None,
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
            limit=limit, folder=folder, progress=progress, **settings._asdict(),
        )  # fmt: skip
    except OutOfTime as error:
        return Certificate(f"cannot be judged: {error}")
    except SamplerRefusal as error:
        return Certificate(f"does not apply: {error}")
    except NonFiniteError as error:
        return Certificate(f"fails: {error}")
    file = None if folder is None else folder.with_suffix(".json")
    key = jax.random.fold_in(key, 2**31 + 1)
    beside = beside_exact(known, sampler, key, settings, quantities, file)
    if beside.lost:
        verdict = f"fails: draws of {beside.lost} in {RECORDINGS} recordings are not finite"
        return Certificate(verdict, calibration, seconds=calibration.seconds)
    return Certificate(
        _verdict(calibration, alpha, settings if isinstance(sampler, Sampler) else None),
        calibration,
        beside.distance,
        beside.mode_error,
        beside.mode_floor,
        calibration.seconds,
        beside.effective,
        beside.evaluations,
        beside.distance_error,
    )


def _verdict(calibration: Calibration, alpha: float, settings: Settings | None) -> str:
    """The calibration's, with the size of a failure, or the settings that were too few."""
    verdict = calibration.verdict(alpha)
    for name, ranks in zip(calibration.names, calibration.ranks.T):
        if verdict.startswith(f"fails: {name} (p = "):
            share, error = calibration.coverage(0.8)[name]
            return (
                f"{verdict}; 80 % intervals of it hold {100 * share:.0f} +- {100 * error:.0f} % "
                f"of truths, whose mean rank is {ranks.mean():.2f}, not 0.50"
            )
    if settings is None or not verdict.startswith("cannot be judged"):
        return verdict
    chains, draws, _, thin = settings
    verdict += f" as {chains} chains of {draws} draws, thinned by {thin}"
    if calibration.effective.min() <= chains:
        verdict += (
            "; no chain is worth more than one draw: longer ones help if they are slow, not if "
            "modes hold them"
        )
    return verdict
