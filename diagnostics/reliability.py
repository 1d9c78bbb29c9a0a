"""Is the error large where the draws say so? Pixels sorted by the spread that is stated of them."""

from typing import NamedTuple

import numpy as np

from .checks import check_beside, check_varies


class Reliability(NamedTuple):
    """For each bin of pixels (bins,), from the least stated spread to the largest.

    `stated`: root mean variance of the draws, for the error of the mean of so many of them;
    `error`: root mean square error of that mean. Equal in every bin where the draws are calibrated.
    """

    stated: np.ndarray
    error: np.ndarray

    @property
    def ratio(self) -> np.ndarray:
        """Spread over error of each bin; 1 is right."""
        return self.stated / self.error


def reliability(draws: np.ndarray, truths: np.ndarray, bins: int = 10) -> Reliability:
    """Of `draws` (n, L, *shape) of n posteriors and their `truths` (n, *shape), real or complex.

    Bins hold as many pixels each. Pixels are sorted by the variance of the first half of the draws,
    and `stated` is that of the second: a variance of few draws is large by chance too, and what was
    chosen for it would state too much. Raises ValueError as `spread_over_error` does, for fewer
    than 4 draws, and for bins that are no whole number from 1 to that of the pixels.
    """
    draws, truths = np.asarray(draws), np.asarray(truths)
    check_beside(truths, draws, real=False, fewest=4)
    check_varies(draws, axis=1)
    if int(bins) != bins or not 1 <= bins <= truths.size:
        raise ValueError(f"{bins} bins: give a whole number, 1 to the {truths.size} pixels")
    count = draws.shape[1]
    halves = np.split(draws, [count // 2], axis=1)
    first, second = (np.ravel(half.var(axis=1, ddof=1)) for half in halves)
    square = np.ravel(np.abs(draws.mean(axis=1) - truths) ** 2)
    parts = np.array_split(np.argsort(first, kind="stable"), int(bins))
    # The mean of so many draws keeps a share 1 / L of their variance.
    stated = [second[part].mean() * (1 + 1 / count) for part in parts]
    return Reliability(np.sqrt(stated), np.sqrt([square[part].mean() for part in parts]))
