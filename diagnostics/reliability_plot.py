"""Reliability as a picture: the error of the mean against the spread that is stated of it."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .reliability import Reliability


def plot_reliability(
    found: Reliability, axes: Axes | None = None, unit: str | None = "object"
) -> Axes:
    """Draw a point for each bin of pixels, beside the diagonal on which spread and error agree.

    In the object's unit, which `unit` names (None: not said). Above the diagonal the draws are too
    sure, below it not sure enough. Returns the axes, new ones unless given.
    """
    if axes is None:
        axes = Figure(figsize=(4.0, 3.8), layout="constrained").add_subplot()
    largest = 1.05 * max(found.stated.max(), found.error.max())
    axes.plot([0, largest], [0, largest], color="0.7", lw=1)
    axes.plot(found.stated, found.error, "o-", ms=3, lw=1)
    said = "" if unit is None else f" / {unit}"
    axes.set(xlabel=f"stated sd{said}", ylabel=f"error{said}")
    return axes
