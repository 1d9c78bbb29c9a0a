"""Draws of a prior side by side: what it believes before any data."""

import math

import numpy as np
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure, SubFigure

from .plots import phase_scale

_INCH = 1.1  # of a draw's longer side


def plot_prior(draws: np.ndarray) -> Figure:
    """Draws (n, h, w), (n, h, w, 3) in colour, or complex (n, h, w), on one scale.

    Grey runs from 0 to 1, farther where more than one value in a hundred lies above. Raises
    ValueError for another shape.
    """
    draws = np.asarray(draws)
    if draws.ndim not in (3, 4) or (draws.ndim == 4 and draws.shape[3] != 3) or not len(draws):
        raise ValueError(f"draws of shape {draws.shape}: give (n, h, w), or (n, h, w, 3)")
    columns = math.ceil(math.sqrt(2 * len(draws) / (1 + np.iscomplexobj(draws))))
    rows = math.ceil(len(draws) / columns)
    light = np.abs(draws) if np.iscomplexobj(draws) else draws
    scale = Normalize(0, max(1.0, float(np.quantile(light, 0.99))))
    panels = {"": (light, scale, "gray")}
    if np.iscomplexobj(draws):
        phases = np.angle(draws)
        colours = phase_scale(phases)
        panels = {"amplitude": panels[""], "phase": (phases, colours.norm, colours.cmap)}
    size = (_INCH * columns * len(panels), _INCH * rows + 0.3 * (len(panels) > 1))
    figure = Figure(figsize=size, layout="constrained")
    parts = np.atleast_1d(figure.subfigures(1, len(panels)))
    for part, (title, (pictures, norm, colours)) in zip(parts, panels.items()):
        _grid(part, (rows, columns), pictures, norm, colours)
        part.suptitle(title, fontsize=9)
    return figure


def _grid(
    figure: SubFigure,
    shape: tuple[int, int],
    pictures: np.ndarray,
    norm: Normalize,
    colours: str | Colormap,
) -> None:
    for axes, picture in zip(figure.subplots(*shape, squeeze=False).flat, pictures):
        shown = np.clip(norm(picture), 0, 1) if picture.ndim == 3 else picture
        axes.imshow(shown, norm=norm, cmap=colours, interpolation="nearest")
    for axes in figure.axes:
        axes.set_axis_off()
