"""Masses of modes as bars, with the error that so many draws give them."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure


def plot_mode_masses(
    masses: np.ndarray,
    count: int,
    axes: Axes | None = None,
    exact: np.ndarray | None = None,
    errors: float = 2.0,
) -> Axes:
    """Draw `masses` (modes,), such as of `mode_masses` or `modes(...).weights`, a bar for each.

    Of `count` independent draws (of chains: their effective number); lines reach `errors` standard
    errors to either side. `exact` (modes,): masses known otherwise, drawn as black ticks. Returns
    the axes, new ones unless given. Raises ValueError for masses that do not sum to 1, a count
    below 1, and `exact` of another shape.
    """
    masses = np.asarray(masses)
    if masses.ndim != 1 or not np.all(masses >= 0) or abs(masses.sum() - 1) > 1e-3:
        raise ValueError(f"masses {masses}: give shares of the draws, (modes,), that sum to 1")
    if not count >= 1:
        raise ValueError(f"count {count}: give the number of draws, 1 or more")
    if exact is not None and np.shape(exact) != masses.shape:
        raise ValueError(f"exact masses of shape {np.shape(exact)}: give {masses.shape}")
    if axes is None:
        axes = Figure(figsize=(1.8 + 0.6 * len(masses), 3.0), layout="constrained").add_subplot()
    at = np.arange(1, len(masses) + 1)
    reach = errors * np.sqrt(masses * (1 - masses) / count)
    axes.bar(at, masses, 0.6, yerr=reach, color="#bfdcf0", ecolor="#4a86b8", capsize=3)
    if exact is not None:
        axes.hlines(exact, at - 0.4, at + 0.4, colors="k", lw=1.5, label="exact")
        axes.legend(fontsize=8, frameon=False)
    axes.set_xticks(at)
    axes.set(ylim=(0, None), xlabel="mode", ylabel="share of the draws")
    axes.spines[["top", "right"]].set_visible(False)
    return axes
