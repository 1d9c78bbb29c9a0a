"""Coverage as a picture: the share of truths that intervals hold, against the share they state."""

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .coverage import Coverage


def plot_coverage(
    found: Mapping[str, Sequence[Coverage]], axes: Axes | None = None, errors: float = 2.0
) -> Axes:
    """Draw {name: `coverage` at several levels}: a line of points each, beside the diagonal.

    Bars reach `errors` standard errors, of which the images are the unit, to either side. Points
    below the diagonal are of intervals that are too narrow. Those of one name are of the same
    images, so that they lie above or below together. Returns the axes, new ones unless given.
    Raises ValueError for nothing to draw.
    """
    if not found or not all(found.values()):
        raise ValueError("no coverage to draw: give {name: [coverage(...) at each level]}")
    if axes is None:
        axes = Figure(figsize=(4.4, 4.2), layout="constrained").add_subplot()
    axes.plot([0, 1], [0, 1], color="0.3", lw=0.7)
    # Beside each other, so that bars of one level do not hide each other.
    apart = 0.012
    for i, (name, points) in enumerate(found.items()):
        points = sorted(points, key=lambda point: point.level)
        shift = apart * (i - (len(found) - 1) / 2)
        axes.errorbar(
            [point.level + shift for point in points],
            [point.share for point in points],
            yerr=[errors * point.error for point in points],
            fmt="o-", ms=4, lw=1, elinewidth=1.2, capsize=2, label=name,
        )  # fmt: skip
    axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    axes.set(xlabel="level stated", ylabel="share of truths inside")
    axes.legend(fontsize=8, frameon=False, loc="upper left")
    return axes
