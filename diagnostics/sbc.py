"""Simulation-based calibration: do draws and truths come from one distribution?"""

import os
from collections.abc import Mapping
from concurrent.futures import Executor
from typing import NamedTuple

import jax
import numpy as np

from ..problem import Problem
from ..samplers.base import PopulationSampler, Sampler
from .campaign import Drawer, Settings, Simulations, check_asked, simulate
from .checks import check_level
from .quantities import Quantity, default_quantities
from .ranks import randomised_ranks, thinned
from .uniformity import holm, uniformity

# An effective number below twice that is not known well enough to thin by.
_FEWEST = 5


class Calibration(NamedTuple):
    """Ranks (n, Q) of n truths in each of Q quantities `names`, and how many draws they are among.

    `effective`: the median number of draws left after thinning, of each quantity. `seconds`: of the
    simulations. `impossible`: those in which a draw has no density (`Simulations`).
    """

    names: tuple[str, ...]
    ranks: np.ndarray
    effective: np.ndarray
    seconds: float = float("nan")
    impossible: int = 0

    @property
    def p(self) -> dict[str, float]:
        """p-value of each quantity, adjusted for their number (`holm`)."""
        return holm(dict(zip(self.names, self._raw_p)))

    @property
    def _raw_p(self) -> list[float]:
        return [uniformity(u) for u in self.ranks.T]

    @property
    def judged_p(self) -> dict[str, float]:
        """As `p`, of the quantities that a verdict is on: those of 5 independent draws or more."""
        fine = self.effective >= _FEWEST
        return holm({n: p for n, p, is_fine in zip(self.names, self._raw_p, fine) if is_fine})

    def coverage(self, level: float) -> dict[str, tuple[float, float]]:
        """Share of the truths inside the central interval of `level`, and its standard error.

        The error is that of a right sampler. Raises ValueError for levels outside (0, 1).
        """
        error = self._coverage_error(level)
        shares = np.mean(np.abs(self.ranks - 0.5) < level / 2, axis=0)
        return {name: (float(share), error) for name, share in zip(self.names, shares)}

    def hpd_coverage(self, level: float) -> tuple[float, float]:
        """Share of the truths in the region of highest density of mass `level`, and its error.

        The region is that of the objects whose posterior density is above that of all but a share
        `level` of the draws: a truth is in it if its rank in "log-posterior" is above 1 - `level`
        (Hyndman 1996). The standard error is that of a right sampler. Raises ValueError for levels
        outside (0, 1), and where the log-posterior was not asked for.
        """
        error = self._coverage_error(level)
        if "log-posterior" not in self.names:
            raise ValueError(
                "no log-posterior among the quantities, so that regions of highest density are not "
                "known: give a prior with a log_prob, or ask for a quantity of that name"
            )
        ranks = self.ranks[:, self.names.index("log-posterior")]
        return float(np.mean(ranks > 1 - level)), error

    def _coverage_error(self, level: float) -> float:
        check_level(level)
        return float(np.sqrt(level * (1 - level) / len(self.ranks)))

    def verdict(self, alpha: float = 0.05) -> str:
        """One sentence: passes, fails (in what, and how), or cannot be judged, and why.

        An exact sampler of independent draws fails with probability `alpha` at most. It fails in
        quantities of which there are 5 independent draws or more; where there are fewer, and no
        other fails, it cannot be judged. A draw without density fails whatever the ranks say: they
        count it as one draw, however far it is off, and an exact sampler never makes one.
        """
        if self.impossible:
            return (
                f"fails: draws of density 0 in {self.impossible} of {len(self.ranks)} simulations"
            )
        n, p = len(self.ranks), self.judged_p
        worst = min(p, key=p.__getitem__) if p else ""
        if len(p) < len(self.names) and (not p or p[worst] >= alpha):
            coarse = int(np.argmin(self.effective))
            few = self.effective[coarse]
            more = np.ceil(10 * _FEWEST / few) / 10
            return (
                f"cannot be judged: {few:.0f} independent draws of {self.names[coarse]} in a run, "
                f"{_FEWEST} are needed: take at least {more:g} times as many"
            )
        if p[worst] < alpha:
            failed = sum(value < alpha for value in p.values())
            said = _fault(self.ranks[:, self.names.index(worst)])
            return (
                f"fails: {worst} (p = {p[worst]:.2g}), {said}; {failed} of {len(p)} quantities in "
                f"{n} simulations"
            )
        return f"passes: {len(p)} quantities in {n} simulations, the smallest p is {p[worst]:.2g}"


def sbc(
    problem: Problem,
    sampler: Sampler | Drawer,
    key: jax.Array,
    simulations: int = 200,
    *,
    quantities: Mapping[str, Quantity] | None = None,
    chains: int = 1,
    draws: int = 100,
    warmup: int | None = None,
    thin: int = 1,
    independent: bool | None = None,
    batch: int | None = None,
    limit: float | None = None,
    folder: str | os.PathLike | None = None,
    executor: Executor | None = None,
    progress: bool = True,
) -> Calibration:
    """Simulation-based calibration of `sampler` on `problem` (Cook et al. 2006, Talts et al. 2018).

    Draws (x, y) of the joint distribution and draws of the posterior given y: if these are exact,
    the rank of f(x, y) among theirs is uniform, for every f. `quantities`: {name: f(x, y)}, a real
    scalar each; None: `default_quantities`. `independent`: draws of a run are, and are not thinned
    by their effective number; None: as the sampler says; True for a function of draws, for one draw
    a chain, and for particles, which have no order to thin them by.
    The rest as in `campaign.simulate`. Objects are drawn by `prior.sample`: what is tested is the
    sampler, not the prior, but where those draws are approximate (of a learned prior, by reverse
    diffusion) their error counts too.

    Passing is no proof: a fault that no quantity sees passes, and so does one too small for so
    many simulations. Raises ValueError as `simulate` does, for fewer than 20 simulations or 8 draws
    of a chain, and where every draw is as its object in every quantity.
    """
    check_asked(problem, sampler)
    if simulations < 20:
        raise ValueError(f"{simulations} simulations: give 20 or more, no test sees less")
    if independent is None:
        independent = _independent(sampler, draws)
    quantities = default_quantities(problem) if quantities is None else quantities
    settings = Settings(chains, draws, warmup, thin)
    if not independent and draws < 8:
        raise ValueError(f"{draws} draws a chain: give 8 or more, to know how far they depend")
    simulated = simulate(
        problem, sampler, key, simulations, quantities, settings,
        batch=batch, limit=limit, folder=folder, executor=executor, progress=progress,
    )  # fmt: skip
    _refuse_constant(simulated)
    names, truths, found, seconds, impossible = simulated
    kept = np.ones(found.shape, bool) if independent else thinned(found)
    flat, kept = (a.reshape(len(a), -1, len(names)) for a in (found, kept))
    # The ranks' own randomness follows the key too, away from every simulation's.
    seed = jax.random.key_data(jax.random.fold_in(key, 2**31))
    ranks = randomised_ranks(truths, flat, np.random.default_rng(np.asarray(seed)), kept)
    effective = np.median(kept.sum(axis=1), axis=0)
    return Calibration(names, ranks, effective, seconds, impossible)


def _independent(sampler: Sampler | Drawer, draws: int) -> bool:
    if not isinstance(sampler, Sampler) or draws == 1:
        return True
    return sampler.independent or isinstance(sampler, PopulationSampler)


def _refuse_constant(found: Simulations) -> None:
    """Of ties the ranks are random: they would be uniform, and pass."""
    if np.all(found.draws == found.truths[:, None, None]):
        raise ValueError(
            f"in all {len(found.truths)} simulations every draw is as its object in "
            f"{', '.join(found.names)}: nothing is ranked, give quantities and draws that vary"
        )


def _fault(u: np.ndarray) -> str:
    """What ranks say is wrong: the larger of an offset and a spread, in standard errors."""
    offset = (u.mean() - 0.5) * np.sqrt(12 * len(u))
    spread = (np.mean((u - 0.5) ** 2) - 1 / 12) * np.sqrt(180 * len(u))
    if abs(offset) > abs(spread):
        return "draws are too low" if offset > 0 else "draws are too high"
    return "draws are too narrow" if spread > 0 else "draws are too wide"
