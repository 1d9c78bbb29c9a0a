"""Distances beside the floor that exact draws have, for they are never 0."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .distance import Distance
from .frechet import Frechet

_VALUE, _FLOOR = "#4a86b8", "0.75"


def plot_distances(
    found: Mapping[str, Distance], axes: Axes | None = None, label: str = "distance", sds: float = 2
) -> Axes:
    """Draw {sampler: distance}, all of one kind: a dot each, beside its noise floor in grey.

    Grey bars reach `sds` standard deviations of the floor to either side of its mean, the tick in
    them: a dot inside is as near as exact draws are, and p, of the same hypothesis, is written
    beside it. `label` names distance and unit, say "sliced Wasserstein / posterior sd". Returns the
    axes, new ones unless given. Raises ValueError for nothing to draw.
    """
    if not found:
        raise ValueError("no distance to draw: give {sampler: beside_floor(...)}")
    if axes is None:
        axes = Figure(figsize=(5.5, 0.9 + 0.4 * len(found)), layout="constrained").add_subplot()
    rows, values = np.arange(len(found)), list(found.values())
    floors = np.array([one.floor for one in values])
    reach = sds * np.array([one.floor_sd for one in values])
    axes.barh(rows, 2 * reach, 0.5, floors - reach, color=_FLOOR, lw=0)
    axes.plot(floors, rows, "|", color="0.3", ms=10)
    axes.plot([one.value for one in values], rows, "o", color=_VALUE)
    for row, one, end in zip(rows, values, floors + reach):
        axes.annotate(
            f"p = {one.p:.2g}",
            (max(one.value, end), row),
            (8, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    axes.set_yticks(rows, list(found))
    axes.set_ylim(len(found) - 0.4, -0.6)
    axes.margins(x=0.2)
    axes.set_xlabel(label)
    axes.set_title(f"grey: exact draws, mean and {sds:g} sd", fontsize=8, loc="right")
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def plot_frechet(found: Mapping[str, Frechet], axes: Axes | None = None, sds: float = 2) -> Axes:
    """Draw {system: Frechet distance} beside the interval in which exchangeable pictures have it.

    Squared and without unit; each floor is that of its own draws. As `plot_distances`.
    """
    axes = plot_distances(found, axes, "squared Frechet distance", sds)
    axes.set_title(f"grey: exchangeable pictures, mean and {sds:g} sd", fontsize=8, loc="right")
    return axes
