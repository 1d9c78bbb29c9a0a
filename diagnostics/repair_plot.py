"""What a repair of intervals did: the share of truths that they held, and hold."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .conformal import Repair


def plot_repair(found: Mapping[str, Repair], axes: Axes | None = None) -> Axes:
    """Draw {sampler: repair}: the share of pixels inside, before and after, beside the level.

    On the images that the repair was found on. Written above is the factor by which intervals were
    widened; a black line is what at least they are guaranteed to hold of new images, with the
    repair's confidence. Returns the axes, new ones unless given. Raises ValueError for nothing to
    draw.
    """
    if not found:
        raise ValueError("no repair to draw: give {sampler: repair_intervals(...)}")
    if axes is None:
        axes = Figure(figsize=(2.2 + 1.0 * len(found), 3.4), layout="constrained").add_subplot()
    at, repairs = np.arange(len(found)), list(found.values())
    shares = {
        "before": [1 - one.before for one in repairs],
        "after": [1 - one.after for one in repairs],
    }
    for shift, colour, (name, heights) in zip((-0.2, 0.2), ("#f7c68d", "#bfdcf0"), shares.items()):
        axes.bar(at + shift, heights, 0.4, color=colour, label=name)
    levels = [1 - one.miss for one in repairs]
    line = axes.hlines(levels, at - 0.45, at + 0.45, colors="k", lw=1.2, label="guaranteed")
    for x, one in zip(at, repairs):
        top = max(1 - one.before, 1 - one.after, 1 - one.miss)
        axes.text(x, top + 0.01, f"x {one.factor:.3g}", ha="center", va="bottom", fontsize=8)
    axes.set_xticks(at, list(found))
    axes.set(ylim=(0, 1.1), ylabel="share of pixels inside")
    place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1), "ncols": 3}
    axes.legend(handles=[*axes.containers, line], fontsize=8, frameon=False, **place)
    axes.spines[["top", "right"]].set_visible(False)
    return axes
