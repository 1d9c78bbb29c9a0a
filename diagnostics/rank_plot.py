"""Ranks as curves: where the draws of a sampler lie beside the truths, and how far is chance."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .checks import check_level
from .sbc import Calibration
from .uniformity import bands


def plot_ranks(
    calibration: Calibration, axes: Axes | None = None, level: float = 0.95, named: int = 4
) -> Axes:
    """Draw the distribution of ranks less that of uniform ones, a line for each quantity.

    The grey band holds a line as a whole with probability 1 - (1 - level)/Q: all Q of them with
    `level` or more. A line that rises above it on the left and falls below on the right is of draws
    that are too narrow, one wholly above of draws that are too high. The `named` worst lines are
    told apart by colour, after them those of too few draws to be judged. Returns the axes, new ones
    unless given. Raises ValueError for a level outside (0, 1).
    """
    check_level(level)
    axes = Figure(figsize=(7.5, 3.6), layout="constrained").add_subplot() if axes is None else axes
    n, count = calibration.ranks.shape
    low, high = bands(n, 1 - (1 - level) / count)
    at = np.linspace(0, 1, 1001)
    most, least = (np.searchsorted(ends, at, side="right") / n for ends in (low, high))
    axes.fill_between(at, least - at, most - at, color="0.88", lw=0)
    p = calibration.judged_p
    worst = sorted(calibration.names, key=lambda name: p.get(name, 2.0))[:named]
    for name, ranks in zip(calibration.names, calibration.ranks.T):
        ordered = np.concatenate([[0], np.repeat(np.sort(ranks), 2), [1]])
        shares = np.repeat(np.arange(n + 1) / n, 2) - ordered
        if name in worst:
            said = f"p = {p[name]:.2g}" if name in p else "too few draws"
            axes.plot(ordered, shares, lw=1.4, label=f"{name}, {said}", zorder=3)
        else:
            axes.plot(ordered, shares, lw=0.7, color="0.6")
    axes.axhline(0, color="0.3", lw=0.7)
    axes.set(xlim=(0, 1), xlabel="rank of the truth among the draws", ylabel="share less rank")
    axes.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return axes
