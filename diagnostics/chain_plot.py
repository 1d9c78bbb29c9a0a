"""Chains beside each other: how the ranks of each one's draws lie among those of all."""

from typing import NamedTuple

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .checks import check_finite, check_level
from .ranks import thinned

_INSIDE, _OUTSIDE, _BAND = "#4a86b8", "#e08a1e", "0.86"
_MOST_BINS, _FEWEST_BINS, _DRAWS_A_BIN = 20, 4, 20


class _Histograms(NamedTuple):
    """Of the ranks of each chain: all (chains, bins), over the expected counts; `sizes` (chains,).

    `low`, `high`: ends of the band, `outside`: which counts it does not hold.
    """

    heights: np.ndarray
    low: np.ndarray
    high: np.ndarray
    outside: np.ndarray
    sizes: np.ndarray


def plot_chains(values: np.ndarray, axes: Axes | None = None, level: float = 0.95) -> Axes:
    """Draw a histogram for each chain, of the ranks of its draws among all (Vehtari et al. 2021).

    `values` (chains, draws), real: one number of the object, such as a pixel or a mean. Chains of
    one distribution have flat histograms; one that stays higher leans right, one too narrow is a
    hill. The grey band holds all bars of all chains with `level` or more: a bar outside of it is
    orange. Each chain is first thinned by its own effective number, for neighbours share their
    bin; `n` is how many draws it has left. Bars are in units of what is expected.
    Returns the axes, new ones unless given. Raises ValueError for complex values, one chain, fewer
    than 8 draws, NaN, and levels outside (0, 1).
    """
    found = _histograms(_checked(values), level)
    chains, bins = found.heights.shape
    row = 1.15 * max(found.heights.max(), found.high.max())
    if axes is None:
        axes = Figure(figsize=(5.5, 0.7 + 0.75 * chains), layout="constrained").add_subplot()
    edges = np.linspace(0, 1, bins + 1)
    for i in range(chains):
        base = (chains - 1 - i) * row
        colours = np.where(found.outside[i], _OUTSIDE, _INSIDE)
        heights = found.heights[i]
        axes.bar(edges[:-1], heights, 1 / bins, base, align="edge", color=colours, alpha=0.45)
        axes.hlines(base + heights, edges[:-1], edges[1:], colors=colours, lw=2)
        low, high = (base + np.append(ends[i], ends[i, -1]) for ends in (found.low, found.high))
        axes.fill_between(edges, low, high, step="post", color=_BAND, lw=0, zorder=0)
        axes.axhline(base, color="0.3", lw=0.7, zorder=4)
    labels = [f"chain {i}\nn = {n}" for i, n in enumerate(found.sizes, 1)]
    axes.set_yticks([(chains - 1 - i) * row + 1 for i in range(chains)], labels, fontsize=8)
    axes.set(xlim=(0, 1), ylim=(0, chains * row), xlabel="rank among the draws of all chains")
    axes.set_title(f"grey: {100 * level:g} % band of all bars", fontsize=8, loc="right")
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _histograms(values: np.ndarray, level: float) -> _Histograms:
    check_level(level)
    # Each chain is a run of its own: chains that disagree are not thinned for it.
    kept = thinned(values[:, None])[:, 0]
    sizes = kept.sum(axis=1)
    total, chain = sizes.sum(), np.nonzero(kept)[0]
    bins = int(np.clip(np.median(sizes) // _DRAWS_A_BIN, _FEWEST_BINS, _MOST_BINS))
    ranks = scipy.stats.rankdata(values[kept])
    place = np.minimum(((ranks - 0.5) * bins / total).astype(int), bins - 1)
    counts = np.zeros((len(values), bins), int)
    np.add.at(counts, (chain, place), 1)
    # Given how many draws each bin has, those of a chain are drawn from them without replacement.
    share = scipy.stats.hypergeom(total, counts.sum(axis=0)[None], sizes[:, None])
    beyond = (1 - level) / counts.size / 2
    low, high = share.ppf(beyond), share.isf(beyond)
    expected = np.maximum(share.mean(), np.finfo(float).tiny)
    outside = (counts < low) | (counts > high)
    return _Histograms(counts / expected, low / expected, high / expected, outside, sizes)


def _checked(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values)
    if np.iscomplexobj(values):
        raise ValueError("complex values have no ranks: give abs(), .real or .imag of them")
    if values.ndim != 2 or len(values) < 2 or values.shape[1] < 8:
        raise ValueError(
            f"values of shape {values.shape}: give (chains, draws), 2 chains and 8 draws or more"
        )
    check_finite("draws", values)
    return values
