"""Convergence of chains: R-hat, effective sample size and Monte-Carlo error, on arviz-stats.

Every function takes draws (chains, draws, *shape), real, and returns an array of `shape`.
"""

import numpy as np
from arviz_stats.base import array_stats


def rhat(values: np.ndarray) -> np.ndarray:
    """Rank-normalised split R-hat (Vehtari et al. 2021)."""
    return array_stats.rhat(_checked(values), chain_axis=0, draw_axis=1)


def ess(values: np.ndarray, method: str = "bulk") -> np.ndarray:
    """Effective sample size; `method` "bulk", "tail", "mean" or "sd" (Vehtari et al. 2021)."""
    return array_stats.ess(_checked(values), chain_axis=0, draw_axis=1, method=method)


def mcse(values: np.ndarray, method: str = "mean") -> np.ndarray:
    """Monte-Carlo standard error of the mean or the sd."""
    return array_stats.mcse(_checked(values), chain_axis=0, draw_axis=1, method=method)


def _checked(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values)
    if np.iscomplexobj(values):
        raise ValueError("complex draws: give .real, .imag or abs() of them, one at a time")
    if values.ndim < 2 or values.shape[1] < 4:
        raise ValueError(
            f"draws of shape {values.shape}: give (chains, draws, ...), 4 draws or more"
        )
    if not np.all(np.isfinite(values)):
        raise ValueError("draws hold NaN or infinity: the run has diverged")
    return values.astype(float, copy=False)
