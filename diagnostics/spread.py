"""Spread of draws, pixel by pixel. Draws are (chains, draws, *shape); maps have `shape`."""

import math

import numpy as np
from numpy.typing import ArrayLike

from .checks import check_beside, check_finite, check_level, check_real, check_varies


def interval(values: np.ndarray, level: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper end of the central interval that holds the truth at `level`.

    Ends at the ranks p (n + 1) of n draws (Weibull's rule): a truth that is one draw more lies
    between them with probability `level`, exactly where the ranks are whole (else interpolated:
    91 % for 90 % of 32 normal draws; quantiles of the draws themselves hold 84 %). Raises
    ValueError for fewer than 2/(1 - level) - 1 draws, 19 at 90 %, which hold less between them
    (`held_by`), and for draws that are complex or not finite.
    """
    return ends_at_ranks(_flat(values), level, axis=0)


def ends_at_ranks(draws: np.ndarray, level: float, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Those ends along the one axis that `draws` are counted on."""
    check_level(level)
    tail = (1 - level) / 2
    check_count(draws.shape[axis], tail, f"an interval at {100 * level:g} %")
    low, high = np.quantile(draws, [tail, 1 - tail], axis, method="weibull")
    return low, high


def interval_width(values: np.ndarray, level: float = 0.9) -> np.ndarray:
    """Width of that interval. Raises ValueError also for draws that are all the same."""
    draws = _flat(values)
    low, high = ends_at_ranks(draws, level, axis=0)
    check_varies(draws, axis=0)
    return high - low


def held_by(count: int, level: float = 0.9) -> float:
    """`level`, or what so few draws hold between the least and the largest of them."""
    return min(level, (count - 1) / (count + 1))


def widest(values: np.ndarray, level: float = 0.9) -> np.ndarray:
    """Width of the interval at `held_by` of these draws, also of few and of ones that stand still.

    For the figure of a run, which is drawn whatever came of it: 0 of a single draw.
    """
    draws = _flat(values)
    tail = (1 - held_by(len(draws), level)) / 2
    return np.subtract(*np.quantile(draws, [1 - tail, tail], 0, method="weibull"))


def quantile(values: np.ndarray, p: ArrayLike) -> np.ndarray:
    """Quantile `p` of each pixel: a map, or one for each of several `p` (len(p), *shape).

    At the rank p (n + 1) of n draws, as the ends of `interval`: one draw more lies below it with
    probability p. Raises ValueError for p outside (0, 1), fewer draws than have such a rank, and
    draws that are complex or not finite.
    """
    draws, p = _flat(values), np.asarray(p, float)
    for each in np.ravel(p):
        check_level(each, "quantile")
        check_count(len(draws), min(each, 1 - each), f"the quantile {each:g}")
    return np.quantile(draws, p, 0, method="weibull")


def check_count(count: int, tail: float, asked: str) -> None:
    """Refuse fewer draws than have the rank `tail` (n + 1), which must be 1 or more."""
    # Rounding must not ask for a draw more: 2/(1 - 0.9) is a little above 20.
    needed = math.ceil(1 / tail - 1 - 1e-9)
    if count < needed:
        raise ValueError(f"{count} draws for {asked}: give {needed} or more")


def circular_mean(phase: np.ndarray) -> np.ndarray:
    """Mean direction of phases in radians, in (-pi, pi] (Mardia and Jupp 2000)."""
    return np.angle(np.mean(np.exp(1j * _flat(phase)), axis=0))


def circular_sd(phase: np.ndarray) -> np.ndarray:
    """Circular standard deviation in radians: sqrt(-2 log R), R the mean resultant length.

    Raises ValueError for fewer than 2 draws, and draws that are all the same.
    """
    draws = _flat(phase, fewest=2)
    check_varies(draws, axis=0)
    resultant = np.abs(np.mean(np.exp(1j * draws), axis=0))
    return np.sqrt(2 * np.log(1 / np.clip(resultant, 1e-300, 1.0)))


def spread_over_error(draws: np.ndarray, truths: np.ndarray) -> float:
    """Sd of the draws over the error of their mean: 1 if calibrated, below it if too narrow.

    `draws` (n, draws, ...), real or complex, of n problems whose truths are `truths` (n, ...). The
    spread-skill ratio of forecasts (Fortin et al. 2014): the mean of so many draws keeps a share
    1/draws of their variance. Raises ValueError for shapes that do not fit, one real and the other
    complex, values that are not finite, fewer than 2 draws, and draws that are all the same.
    """
    draws, truths = np.asarray(draws), np.asarray(truths)
    check_beside(truths, draws, real=False, fewest=2)
    check_varies(draws, axis=1)
    variance = np.mean(draws.var(axis=1, ddof=1)) * (1 + 1 / draws.shape[1])
    return float(np.sqrt(variance / np.mean(np.abs(draws.mean(axis=1) - truths) ** 2)))


def _flat(values: np.ndarray, fewest: int = 1) -> np.ndarray:
    values = np.asarray(values)
    check_real(draws=values)
    if values.ndim < 2 or not values.size:
        raise ValueError(f"draws of shape {values.shape}: give (chains, draws, ...), one or more")
    flat = values.reshape(-1, *values.shape[2:])
    if len(flat) < fewest:
        raise ValueError(f"{len(flat)} draws in all: give {fewest} or more")
    check_finite("draws", flat)
    return flat
