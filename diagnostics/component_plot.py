"""What is uncertain together, as pictures: components of the posterior, and two draws of it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from .components import Components, Contrast

_INCH = 2.1  # a side of a panel
_GREY, _SIGNED = "gray", "RdBu_r"


class _Panel(NamedTuple):
    title: str
    picture: np.ndarray


class _Row(NamedTuple):
    """Pictures (h, w) in the object's own scale, then changes, from -limit to limit."""

    objects: Sequence[_Panel]
    changes: Sequence[_Panel]
    object_label: str
    change_label: str


def plot_components(components: Components) -> np.ndarray:
    """Draw the mean and, beside it, a change of one sd along each component, all on one scale.

    Red is more, blue is less, in the object's unit; either sign is as probable. Of complex objects
    the amplitude and, below it, the phase in radians, both to first order about the mean. Draw four
    or so. Raises ValueError for objects that are no pictures (h, w).
    """
    mean = _picture(components.mean)
    names = [f"{k}: {100 * share:.2g} % of variance" for k, share in enumerate(components.share, 1)]
    changes = components.sd[:, None, None] * components.patterns
    if not np.iscomplexobj(mean):
        panels = [_Panel(*pair) for pair in zip(names, changes)]
        return _drawn([_Row([_Panel("mean", mean)], panels, "object", "one sd")])
    # Across the mean field a small change turns its phase; where there is no light there is none.
    turned = changes * np.exp(-1j * np.angle(mean))
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = np.where(np.abs(mean) > 0, turned.imag / np.abs(mean), np.nan)
    amplitude = [_Panel(*pair) for pair in zip(names, turned.real)]
    phase = [_Panel("", turn) for turn in turns]
    return _drawn(
        [
            _Row([_Panel("mean", np.abs(mean))], amplitude, "amplitude", "one sd"),
            _Row([_Panel("", np.angle(mean))], phase, "phase / rad", "one sd / rad"),
        ]
    )


def plot_contrast(values: np.ndarray, found: Contrast) -> np.ndarray:
    """Draw the two draws of `contrast(values)` and, in posterior sd, where they differ.

    Both draws on one scale; the whole difference, and its part along the first component. Of
    complex draws amplitudes, and phases in radians below; their differences are taken along and
    across the mean field, where they change the amplitude and the phase. Returns the axes (rows,
    columns). Raises ValueError for objects that are no pictures (h, w), and for values that the
    contrast is not of.
    """
    values = np.asarray(values)
    most = np.max([found.first, found.second], axis=0)
    if (
        values.ndim != 4
        or values.shape[2:] != found.difference.shape
        or np.any(most >= values.shape[:2])
    ):
        raise ValueError(
            f"values of shape {values.shape}: give the draws (chains, draws, h, w) that the "
            f"contrast is of, with objects of {found.difference.shape} and a draw {tuple(most)}"
        )
    pair = [_picture(values[place]) for place in (found.first, found.second)]
    names = ["a draw", "another draw"]
    titles = ["difference", f"of it along component 1: {100 * found.share:.2g} %"]
    maps, label = [found.difference, found.along], "difference / sd"
    if not np.iscomplexobj(values):
        objects, changes = ([*map(_Panel, *part)] for part in ((names, pair), (titles, maps)))
        return _drawn([_Row(objects, changes, "object", label)])
    turn = np.exp(-1j * np.angle(values.mean(axis=(0, 1))))
    turned = [change * turn for change in maps]
    rows = []
    for of, part, unit, heads in (
        (np.abs, np.real, "amplitude", (names, titles)),
        (np.angle, np.imag, "phase / rad", ([""] * 2, [""] * 2)),
    ):
        objects = [_Panel(name, of(picture)) for name, picture in zip(heads[0], pair)]
        changes = [_Panel(name, part(change)) for name, change in zip(heads[1], turned)]
        rows.append(_Row(objects, changes, unit, label))
    return _drawn(rows)


def _drawn(rows: Sequence[_Row]) -> np.ndarray:
    """The axes of a figure of rows of panels, each row with its two scales at its ends."""
    columns = max(len(row.objects) + len(row.changes) for row in rows)
    height, width = rows[0].objects[0].picture.shape
    size = (_INCH * columns + 1.6, len(rows) * (_INCH * height / width + 0.3) + 0.1)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(rows), columns, squeeze=False)
    for places, row in zip(grid, rows):
        count = len(row.objects)
        low, high = np.nanquantile([p.picture for p in row.objects], [0.005, 0.995])
        limit = np.nanquantile(np.abs([p.picture for p in row.changes]), 0.999)
        for axes, panels, colours, ends, label, side in (
            (places[:count], row.objects, _GREY, (low, high), row.object_label, "left"),
            (places[count:], row.changes, _SIGNED, (-limit, limit), row.change_label, "right"),
        ):
            for place, panel in zip(axes, panels):
                shown = place.imshow(panel.picture, cmap=colours, vmin=ends[0], vmax=ends[1])
                place.set_title(panel.title, fontsize=9, pad=4)
                place.set(xticks=[], yticks=[])
            edge = axes[0] if side == "left" else axes[-1]
            bar = figure.colorbar(shown, ax=edge, location=side, shrink=0.9, aspect=16, pad=0.03)
            bar.set_label(label, fontsize=9)
            bar.ax.tick_params(labelsize=8, length=2)
            bar.outline.set_visible(False)
    return grid


def _picture(x: np.ndarray) -> np.ndarray:
    if x.ndim != 2:
        raise ValueError(f"objects of shape {x.shape}: only pictures (h, w) can be drawn")
    return x
