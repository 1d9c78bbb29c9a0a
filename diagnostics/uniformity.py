"""Are ranks uniform? An exact test, and the bands that show where they are not."""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaln, xlogy
from scipy.stats import beta, poisson

# Below it rounding would speak; the bound is then used, which is hardly larger.
_ROUNDING = 1e-9


def uniformity(u: np.ndarray) -> float:
    """p-value of the hypothesis that `u` (n,) are independent and uniform on (0, 1).

    By how far the order statistic that is furthest out lies in its own beta distribution, all of
    them together: equal local levels (Aldor-Noiman et al. 2013; Saeilynoja, Buerkner and Vehtari
    2022), which sees the tails where Kolmogorov and Smirnov's test does not. Exact for every n, by
    a recursion over the order statistics; below 1e-9 an upper bound, n times the pointwise level.
    Raises ValueError for complex values, values outside [0, 1], NaN, or none.
    """
    u = _checked(u)
    ordered, k = np.sort(u), np.arange(1, len(u) + 1)
    position = beta(k, len(u) + 1 - k)
    local = 2 * np.minimum(position.cdf(ordered), position.sf(ordered)).min()
    return _any_outside(min(local, 1.0), len(u))


def bands(n: int, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """Between which the k-th smallest of `n` uniform numbers lies, for all k together; (n,) each.

    With probability `level` none of them is outside: the simultaneous bands of an empirical
    distribution function, for the test in `uniformity`. Raises ValueError for n that is no whole
    number, 1 or more, and levels outside (0, 1).
    """
    if int(n) != n or n < 1 or not 0 < level < 1:
        raise ValueError(
            f"n {n}, level {level}: give n of 1 or more, a whole number, a level between 0 and 1"
        )
    n = int(n)
    if n == 1:
        return _limits(1 - level, n)
    local = np.exp(
        brentq(
            lambda log_local: _any_outside(np.exp(log_local), n) - (1 - level),
            np.log((1 - level) / n),
            np.log(1 - level),
            xtol=1e-4,
        )
    )
    return _limits(local, n)


def holm(p: Mapping[str, float]) -> dict[str, float]:
    """p-values adjusted for their number, in the same order (Holm 1979).

    With probability 1 - alpha none of the true hypotheses falls below alpha, however the tests
    depend on each other. Raises ValueError for p outside [0, 1], or NaN.
    """
    for name, value in p.items():
        if not 0 <= value <= 1:
            raise ValueError(f"p {value} of {name}: give a probability, from 0 to 1")
    names = sorted(p, key=p.__getitem__)
    factors = np.arange(len(names), 0, -1)
    adjusted = np.minimum(np.maximum.accumulate(factors * [p[name] for name in names]), 1.0)
    found = dict(zip(names, adjusted.tolist()))
    return {name: found[name] for name in p}


def _limits(local: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The central interval of each order statistic of n, outside of which is `local`."""
    k = np.arange(1, n + 1)
    return beta.ppf(local / 2, k, n + 1 - k), beta.isf(local / 2, k, n + 1 - k)


def _any_outside(local: float, n: int) -> float:
    """Probability that any order statistic of n uniform numbers is outside its interval.

    The numbers of a uniform sample below t are a Poisson process of rate n that is known to end at
    n. Its distribution is carried from limit to limit, and what leaves them is dropped (Moscovich
    and Nadler 2017).
    """
    if n * local < _ROUNDING:
        return n * local
    low, high = _limits(local, n)
    times = np.sort(np.concatenate([low, high, [1.0]]))
    fewest = np.searchsorted(high, times, side="right")
    most = np.searchsorted(low, times, side="left")
    fewest[-1] = most[-1] = n
    width = int(np.max(most - fewest) + np.max(np.diff(fewest, prepend=0))) + 1
    mean = n * np.diff(times, prepend=0.0)[:, None]
    counts = np.arange(width + 1)
    arrivals = np.exp(xlogy(counts, mean) - mean - gammaln(counts + 1))
    inside, first = np.ones(1), 0
    for step, least, last in zip(arrivals, fewest, most):
        moved = np.convolve(inside, step)[least - first :][: last - least + 1]
        inside, first = moved, least
    return float(np.clip(1 - inside[0] / poisson.pmf(n, n), 0.0, 1.0))


def _checked(u: np.ndarray) -> np.ndarray:
    u = np.asarray(u)
    if np.iscomplexobj(u):
        raise ValueError(f"ranks are {u.dtype}: give real fractions from 0 to 1")
    u = u.astype(float)
    if u.ndim != 1 or len(u) == 0:
        raise ValueError(f"ranks of shape {u.shape}: give (n,), one or more")
    if not np.all((u >= 0) & (u <= 1)):
        raise ValueError(f"ranks from {u.min():.3g} to {u.max():.3g}: give fractions from 0 to 1")
    return u
