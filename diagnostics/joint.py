"""Geweke's joint test: do a sampler's moves leave the posterior as it is, whatever was recorded?

It asks less of a sampler than simulation-based calibration does, no convergence and no warm-up, and
so it tells a fault of the moves from a run that is too short.
"""

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr
from scipy.stats import rankdata, spearmanr

from ..problem import Posterior, Problem
from ..samplers import Ensemble
from ..samplers.base import PopulationSampler, Sampler
from ..sampling import NonFiniteError
from .campaign import SamplerRefusal, check_asked
from .quantities import Quantity, default_quantities, values_of
from .uniformity import holm

Kernel = Callable[[jax.Array, Posterior, jax.Array], jax.Array]

# Correlation with the start above which less than half of a lasting fault has had time to show.
_KEPT = 0.5
# So many times as many transitions are no advice.
_HARDLY = 1000
_FEWEST = 20


class JointTest(NamedTuple):
    """Pairs (x, y) after the moves beside fresh ones, in Q quantities `names`.

    `z` (Q,): of the rank-sum test, positive where moved pairs have the larger values. `above` (Q,):
    how often a moved pair lies above a fresh one, 0.5 if the moves are right. `kept` (Q,): rank
    correlation of a chain's last value with its first. `moved`: median squared distance of
    an object from its start, over that of two independent objects: 0 for a chain that stands still,
    1 for one that has forgotten its start. `seconds`: of the simulations, compilation included.
    """

    names: tuple[str, ...]
    z: np.ndarray
    above: np.ndarray
    kept: np.ndarray
    moved: float
    chains: int
    transitions: int
    seconds: float = float("nan")

    @property
    def p(self) -> dict[str, float]:
        """p-value of each quantity, adjusted for their number (`holm`)."""
        return holm(dict(zip(self.names, (2 * ndtr(-np.abs(self.z))).tolist())))

    def verdict(self, alpha: float = 0.05) -> str:
        """One sentence: passes, fails (in what, and by how much), or cannot be judged, and why.

        Moves that leave every posterior as it is fail with probability `alpha` at most, however
        slow they are. Slow ones pass unseen, and so nothing passes unless objects have moved, and
        every quantity has forgotten half of its start.
        """
        p = self.p
        worst = min(p, key=p.__getitem__)
        if p[worst] < alpha:
            i = self.names.index(worst)
            failed = sum(value < alpha for value in p.values())
            return (
                f"fails: {worst} (p = {p[worst]:.2g}), moves make it too "
                f"{'high' if self.z[i] > 0 else 'low'}: above that of a fresh pair in "
                f"{100 * self.above[i]:.0f} % of comparisons, not 50; {failed} of {len(p)} "
                f"quantities in {self.chains} chains"
            )
        slow = {"the object": 1 - self.moved} | dict(zip(self.names, self.kept.tolist()))
        slowest = max(slow, key=slow.__getitem__)
        if slow[slowest] > _KEPT:
            return self._unmoved(slowest, slow[slowest])
        return (
            f"passes: {len(p)} quantities in {self.chains} chains of {self.transitions} "
            f"transitions, the smallest p is {p[worst]:.2g}; objects have moved by "
            f"{self.moved:.2f} times the squared distance of independent ones"
        )

    def _unmoved(self, name: str, kept: float) -> str:
        said = f"cannot be judged: {name} keeps a correlation of {kept:.2f} with its start after "
        said += f"{self.transitions} transitions, {_KEPT} at most is needed: "
        # A correlation that falls by the same factor in every transition.
        more = np.log(_KEPT) / np.log(kept) if kept < 1 else np.inf
        if more > _HARDLY:
            return said + "it has hardly moved, take longer moves"
        return said + f"take at least {np.ceil(10 * more) / 10:g} times as many, or longer moves"


def geweke(
    problem: Problem,
    sampler: Sampler | Kernel,
    key: jax.Array,
    chains: int = 400,
    transitions: int = 20,
    *,
    steps: int = 5,
    quantities: Mapping[str, Quantity] | None = None,
    batch: int = 100,
) -> JointTest:
    """Joint test of the moves of `sampler` on `problem` (Geweke 2004, "Getting it right").

    Each of `chains` starts at an exact draw (x, y) of the joint distribution. A transition moves x
    given y, then records y anew given x; moves that leave every posterior as it is leave the joint
    distribution as it is. After `transitions` of them, of which the last does not record anew, so
    that y is what x was moved by, the pairs are compared with as many fresh ones. From exact starts
    all pairs are independent, and the rank-sum test (Wilcoxon 1945) of each quantity has its
    nominal level with no burn-in and no estimate of autocorrelation (as Gandy and Scott 2020, "Unit
    testing for MCMC and other Monte Carlo methods"; they too start exactly).

    `sampler`: a function (key, posterior, x) -> x, traceable by JAX, or a `Sampler`, of which a
    transition is `init` at x and `steps` draws, at the settings it has: nothing is tuned, for a
    chain that adapts leaves no posterior as it is. Give a Metropolis sampler its step size.
    What a sampler holds besides x is begun anew at every transition, and counts.
    `quantities`: {name: f(x, y)}, a real scalar each; None: `default_quantities`, and mean and mean
    square of the recording. `batch`: how many chains run at a time: memory, not results, beyond
    rounding. Objects are drawn by `prior.sample`, so that an approximate one counts as a fault.

    Its limits: a chain that stands still keeps its distribution too, so that `verdict` refuses
    where objects have hardly moved. Objects that are known well from their recording move little in
    a transition, whatever the sampler: faults show, but to pass takes many of them. And a fault is
    seen by how far the quantity's distribution is shifted, not by every change of its form.
    Raises ValueError for bad settings, samplers that are not moves of one object or refuse the
    problem, and quantities that are no real scalars; NonFiniteError where a quantity is NaN.
    """
    check_asked(problem, sampler)
    for name, value, least in (
        ("chains", chains, _FEWEST),
        ("transitions", transitions, 1),
        ("steps", steps, 1),
        ("batch", batch, 1),
    ):
        if int(value) != value or value < least:
            raise ValueError(f"{name} {value}: give a whole number, {least} or more")
    if quantities is None:
        quantities = default_quantities(problem) | _RECORDING
    if not quantities:
        raise ValueError("no quantities: give {name: f(x, y)}, one or more")
    if isinstance(sampler, PopulationSampler | Ensemble):
        raise ValueError(
            f"{type(sampler).__name__} moves a population, not one object: calibrate it by `sbc`"
        )
    names = tuple(quantities)
    began = time.perf_counter()
    found = _pairs(
        problem, sampler, names, tuple(quantities.values()),
        transitions, steps, min(batch, chains), jax.random.split(key, chains),
    )  # fmt: skip
    first, last, fresh, distances = (np.asarray(part, dtype=float) for part in found)
    seconds = time.perf_counter() - began
    _refuse_nan(names, first, last, fresh)
    if not np.all(np.isfinite(distances)):
        lost = int(np.sum(~np.isfinite(distances).all(axis=1)))
        raise NonFiniteError(
            f"the object is not finite in {lost} of {len(distances)} chains: they diverged, give "
            "the sampler a smaller step"
        )
    z, above = np.transpose([_rank_sum(a, b) for a, b in zip(last.T, fresh.T)])
    kept = np.array([_rank_correlation(a, b) for a, b in zip(first.T, last.T)])
    # Medians: a single chain far off must not move the others.
    moved = float(np.divide(*np.median(distances, axis=0)))
    return JointTest(names, z, above, kept, moved, chains, transitions, seconds)


def _recording_mean(x: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.mean(jnp.abs(y) if jnp.iscomplexobj(y) else y)


def _recording_square(x: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.mean(jnp.abs(y) ** 2)


_RECORDING: dict[str, Quantity] = {
    "mean of the recording": _recording_mean,
    "mean square of the recording": _recording_square,
}


@eqx.filter_jit
def _pairs(
    problem: Problem,
    sampler: Sampler | Kernel,
    names: tuple[str, ...],
    quantities: tuple[Quantity, ...],
    transitions: int,
    steps: int,
    batch: int,
    keys: jax.Array,
) -> tuple[jax.Array, ...]:
    """Quantities (chains, Q) at the start, after the moves and of fresh pairs; and distances.

    Distances (chains, 2): squared, of the start to where it was moved, and to the fresh object.
    """

    asked = partial(values_of, names, quantities)

    def one(key: jax.Array) -> tuple[jax.Array, ...]:
        key_start, key_fresh, key_moves = jax.random.split(key, 3)
        start, fresh = problem.simulate(key_start), problem.simulate(key_fresh)

        def transition(pair: tuple, key: jax.Array) -> tuple[tuple, None]:
            # The recording first: the last move is then of the pair that is compared.
            key_record, key_move = jax.random.split(key)
            y = problem.likelihood.simulate(key_record, pair[0])
            return (_moved(sampler, key_move, problem.condition(y), pair[0], steps), y), None

        key_first, *_ = keys = jax.random.split(key_moves, transitions)
        pair = _moved(sampler, key_first, problem.condition(start[1]), start[0], steps), start[1]
        (x, y), _ = jax.lax.scan(transition, pair, keys[1:])
        distances = [jnp.sum(jnp.abs(other - start[0]) ** 2) for other in (x, fresh[0])]
        return asked(*start), asked(x, y), asked(*fresh), jnp.stack(distances)

    return jax.lax.map(one, keys, batch_size=batch)


def _moved(
    sampler: Sampler | Kernel, key: jax.Array, posterior: Posterior, x: jax.Array, steps: int
) -> jax.Array:
    """The object after one transition's moves."""
    if not isinstance(sampler, Sampler):
        moved = sampler(key, posterior, x)
        if not isinstance(moved, jax.Array):
            raise ValueError(
                f"the kernel gives a {type(moved).__name__}: give an object, a JAX array {x.dtype} "
                f"{x.shape}"
            )
        if jnp.shape(moved) != x.shape or moved.dtype != x.dtype:
            raise ValueError(
                f"the kernel gives {moved.dtype} {jnp.shape(moved)}: give an object, "
                f"{x.dtype} {x.shape}"
            )
        return moved
    key_init, key_steps = jax.random.split(key)
    try:
        state = sampler.init(key_init, posterior, x)
        state, _ = jax.lax.scan(
            lambda state, key: (sampler.step(key, state)[0], None),
            state,
            jax.random.split(key_steps, steps * sampler.steps_per_draw()),
        )
    except ValueError as error:
        raise SamplerRefusal(" ".join(str(error).split())) from error
    return sampler.position(state)


def _rank_sum(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """z of the rank sum of `a` among `a` and `b`, and how often it is above; ties count half."""
    ranks = rankdata(np.concatenate([a, b]))
    n, m = len(a), len(b)
    above = (ranks[:n].mean() - (n + 1) / 2) / m
    # Of the mean of n of these ranks, taken at random: whatever their ties.
    error = np.sqrt(ranks.var(ddof=1) * m / n / (n + m))
    return (float((ranks[:n].mean() - ranks.mean()) / error) if error else 0.0), float(above)


def _rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """0 for a quantity that is the same everywhere: it has nothing to keep."""
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(spearmanr(a, b).statistic)


def _refuse_nan(
    names: tuple[str, ...], first: np.ndarray, last: np.ndarray, fresh: np.ndarray
) -> None:
    for i in np.argwhere((np.isnan(first) | np.isnan(fresh)).any(axis=0))[:, 0]:
        raise ValueError(
            f"{names[i]} of an exact pair is NaN: give quantities that are defined for every "
            "object and recording"
        )
    for i in np.argwhere(np.isnan(last).any(axis=0))[:, 0]:
        raise NonFiniteError(
            f"{names[i]} is NaN in {int(np.isnan(last[:, i]).sum())} of {len(last)} chains: they "
            "diverged, give the sampler a smaller step"
        )
