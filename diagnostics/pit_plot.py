"""Ranks as a histogram: where truths, or second exposures, lie among what draws predict."""

from typing import NamedTuple

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .checks import check_level, check_real

_INSIDE, _OUTSIDE, _BAND = "#4a86b8", "#e08a1e", "0.86"


def plot_pit(
    ranks: np.ndarray, axes: Axes | None = None, bins: int = 20, level: float = 0.95
) -> Axes:
    """Draw a histogram of `ranks` in (0, 1), as of `randomised_ranks` and `predictive_ranks`.

    Of any shape, all together; bars in units of what is expected. Flat where draws are right,
    a hill where they are too wide, a valley where they are too narrow. The grey band holds all bars
    together with `level` or more if ranks are independent, and a bar outside of it is orange: those
    of the pixels of one image are not, so that of them only the shape is to be read. Returns the
    axes, new ones unless given. Raises ValueError for ranks that are complex, outside [0, 1] or
    none, for fewer than 2 bins, and levels outside (0, 1).
    """
    found = _histogram(_checked(ranks), bins, level)
    count = len(found.heights)
    if axes is None:
        axes = Figure(figsize=(4.8, 3.0), layout="constrained").add_subplot()
    colours = np.where(found.outside, _OUTSIDE, _INSIDE)
    axes.axhspan(found.low, found.high, color=_BAND, lw=0, zorder=0)
    places = np.arange(count) / count
    axes.bar(places, found.heights, 1 / count, align="edge", color=colours, alpha=0.6)
    axes.axhline(1, color="0.3", lw=0.7)
    axes.set(xlim=(0, 1), xlabel="rank among the draws", ylabel="count / expected")
    about = f"n = {np.size(ranks)}; grey: {100 * level:g} % band of all bars"
    axes.set_title(about, fontsize=8, loc="right")
    axes.spines[["top", "right"]].set_visible(False)
    return axes


class _Histogram(NamedTuple):
    """`heights` (bins,), over the expected count, as the ends of the band; which are `outside`."""

    heights: np.ndarray
    low: float
    high: float
    outside: np.ndarray


def _histogram(ranks: np.ndarray, bins: int, level: float) -> _Histogram:
    check_level(level)
    if int(bins) != bins or bins < 2:
        raise ValueError(f"{bins} bins: give a whole number, 2 or more")
    counts = np.histogram(ranks, int(bins), (0, 1))[0]
    one = scipy.stats.binom(len(ranks), 1 / bins)
    beyond = (1 - level) / bins / 2
    low, high = one.ppf(beyond), one.isf(beyond)
    expected = len(ranks) / bins
    outside = (counts < low) | (counts > high)
    return _Histogram(counts / expected, low / expected, high / expected, outside)


def _checked(ranks: np.ndarray) -> np.ndarray:
    ranks = np.ravel(ranks)
    check_real(ranks=ranks)
    wrong = np.sum(~((ranks >= 0) & (ranks <= 1)))
    if wrong or not len(ranks):
        raise ValueError(
            f"{wrong} of {len(ranks)} ranks lie outside [0, 1]: give one or more, none of them NaN"
        )
    return ranks
