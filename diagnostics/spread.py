"""Spread of draws, pixel by pixel. Draws are (chains, draws, *shape); maps have `shape`."""

import numpy as np


def interval(values: np.ndarray, level: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper end of the central interval that holds the truth at `level`.

    Ends at the ranks p (n + 1) of n draws (Weibull's rule): a truth that is one draw more lies
    between them with probability `level`, exactly where the ranks are whole (else interpolated:
    91 % for 90 % of 32 normal draws; quantiles of the draws themselves hold 84 %). Fewer than
    2/(1 - level) - 1 draws, 19 at 90 %, hold (n - 1)/(n + 1) at most: the ends are then the least
    and the largest.
    """
    return ends_at_ranks(_flat(values), level, axis=0)


def ends_at_ranks(draws: np.ndarray, level: float, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Those ends along the one axis that `draws` are counted on."""
    if not 0 < level < 1:
        raise ValueError(f"level {level}: it must lie between 0 and 1")
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2], axis, method="weibull")
    return low, high


def interval_width(values: np.ndarray, level: float = 0.9) -> np.ndarray:
    """Width of that interval."""
    low, high = interval(values, level)
    return high - low


def circular_mean(phase: np.ndarray) -> np.ndarray:
    """Mean direction of phases in radians, in (-pi, pi] (Mardia and Jupp 2000)."""
    return np.angle(np.mean(np.exp(1j * _flat(phase)), axis=0))


def circular_sd(phase: np.ndarray) -> np.ndarray:
    """Circular standard deviation in radians: sqrt(-2 log R), R the mean resultant length."""
    resultant = np.abs(np.mean(np.exp(1j * _flat(phase)), axis=0))
    return np.sqrt(-2 * np.log(np.clip(resultant, 1e-300, 1.0)))


def spread_over_error(draws: np.ndarray, truths: np.ndarray) -> float:
    """Sd of the draws over the error of their mean: 1 if calibrated, below it if too narrow.

    `draws` (n, draws, ...), real or complex, of n problems whose truths are `truths` (n, ...). The
    spread-skill ratio of forecasts (Fortin et al. 2014): the mean of so many draws keeps a share
    1/draws of their variance.
    """
    variance = np.mean(draws.var(axis=1, ddof=1)) * (1 + 1 / draws.shape[1])
    return float(np.sqrt(variance / np.mean(np.abs(draws.mean(axis=1) - truths) ** 2)))


def _flat(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values)
    if np.iscomplexobj(values):
        raise ValueError("complex draws: give abs() or np.angle() of them")
    if values.ndim < 2:
        raise ValueError(f"draws of shape {values.shape}: give (chains, draws, ...)")
    return values.reshape(-1, *values.shape[2:])
