"""How much of the posterior lies about each of its modes, where these are known."""

import numpy as np

from .checks import check_draws_finite, check_kinds


def mode_masses(draws: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """Shares (modes,) of the draws that are nearest to each mode; they sum to 1.

    `draws` (n, *shape) and `modes` (modes, *shape), objects, real or complex, near in squared
    distance; of two modes as near the first counts. Of n independent draws the standard error of a
    mass m is sqrt(m (1 - m)/n). Objects that the data tell apart only up to a phase or a flip must
    be in one gauge first (`align`). Where the modes are not known, `modes` finds them.
    Raises ValueError for shapes or kinds that differ, no draws, no modes or two that are the same,
    and values that are not finite.
    """
    draws, modes = np.asarray(draws), np.asarray(modes)
    if draws.ndim < 2 or draws.shape[1:] != modes.shape[1:] or not len(draws) or not len(modes):
        raise ValueError(
            f"draws of shape {draws.shape}, modes of {modes.shape}: give (n, *shape) and "
            "(modes, *shape), one or more of each"
        )
    check_kinds("draws", draws, "modes", modes)
    check_draws_finite(draws)
    check_draws_finite(modes, "modes", "give finite ones")
    different = len(np.unique(modes, axis=0))
    if different < len(modes):
        raise ValueError(
            f"{len(modes)} modes of which {different} are different: give each of them once"
        )
    flat, places = (a.reshape(len(a), -1) for a in (draws, modes))
    # A mode at a time: all differences at once would be as many times the draws.
    apart = np.stack([np.sum(np.abs(flat - place) ** 2, axis=1) for place in places], axis=1)
    return np.bincount(apart.argmin(axis=1), minlength=len(modes)) / len(draws)
