"""The price of each approximation at a glance: a row for each problem, a mark for each variant."""

import textwrap
from collections.abc import Mapping

from matplotlib.figure import Figure

from .approximations import EXACT, VARIANTS
from .approximations_report import Cost

# Blues and greens for what is consistent, reds for what was printed (Wong 2011, and shades).
_LOOKS = dict(
    zip(
        (*VARIANTS, EXACT),
        (
            ("#d55e00", "X"), ("#e69f00", "P"), ("#cc79a7", "v"), ("#999999", "<"),
            ("#56b4e9", "o"), ("#0072b2", "D"), ("#009e73", "s"), ("#000000", "|"),
        ),
    )
)  # fmt: skip

_NAME_WIDTH = 26  # characters; the four panels share what is left


def cost_picture(found: Mapping[str, Mapping[str, Cost]]) -> Figure:
    """Width, distance, coverage and time of {problem: {variant: `Cost`}}; lines are what is right.

    Where no exact posterior is known the width is the spread over error.
    """
    problems = list(found)
    size = (13, 1.9 + 0.9 * len(problems))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    panels = (
        ("sd over the exact sd", lambda c: c.spread if c.ratio is None else c.ratio, 1.0),
        (
            "distance from exact\nover noise floor",
            lambda c: None if c.distance is None else c.distance.over,
            1.0,
        ),
        ("held by intervals of 90 %, in %", lambda c: 100 * c.inside[1], 90.0),
        ("seconds a draw", lambda c: c.seconds, None),
    )
    for axis, (title, value, right) in zip(axes, panels):
        if right is not None:
            axis.axvline(right, color="0.3", lw=0.8, zorder=0)
        for row, problem in enumerate(problems):
            _marks(axis, row, found[problem], value)
        axis.set_title(title, fontsize=10)
        if right != 90.0:
            axis.set_xscale("log")
        axis.grid(axis="x", which="major", color="0.9", lw=0.6, zorder=-1)
        axis.spines[["top", "right", "left"]].set_visible(False)
        axis.tick_params(axis="y", length=0)
    for i in range(len(problems) - 1):
        for axis in axes:
            axis.axhline(i + 0.5, color="0.85", lw=0.8, zorder=0)
    names = [textwrap.fill(problem, _NAME_WIDTH) for problem in problems]
    axes[0].set_yticks(range(len(problems)), names)
    axes[0].set_ylim(len(problems) - 0.5, -0.5)
    for i, axis in enumerate(axes[:2]):
        _plain_ticks(axis, (0.5, 1, 2, 4) if i == 0 else (1, 3, 10, 30))
    shown = {name for costs in found.values() for name in costs}
    handles = [
        axes[0].plot([], [], ls="", marker=marker, color=colour, label=name)[0]
        for name, (colour, marker) in _LOOKS.items()
        if name in shown
    ]
    figure.legend(handles=handles, ncols=8, fontsize=9, frameon=False, loc="outside lower center")
    return figure


def _marks(axis, row: int, costs: Mapping[str, Cost], value) -> None:  # noqa: ANN001
    names = [name for name in _LOOKS if name in costs]
    for i, name in enumerate(names):
        at = value(costs[name])
        if at is None:
            continue
        colour, marker = _LOOKS[name]
        height = row + 0.76 * ((i + 0.5) / len(names) - 0.5)
        axis.plot([at], [height], ls="", marker=marker, color=colour, ms=7, clip_on=False)


def _plain_ticks(axis, ticks: tuple[float, ...]) -> None:  # noqa: ANN001
    """Those that lie in reach, and the line at 1 in view."""
    low, high = axis.get_xlim()
    axis.set_xlim(min(low, 0.8), max(high, 1.25))
    low, high = axis.get_xlim()
    inside = [t for t in ticks if low <= t <= high]
    axis.set_xticks(inside, [f"{t:g}" for t in inside])
    axis.minorticks_off()
