"""The overview figure of a run: truth, recording, draws, mean, and how sure each pixel is."""

import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec

from .checks import varies
from .spread import circular_sd, widest

_INCH = 2.0  # a side of a panel
_DPI = 150
_DRAWS = ("a draw", "another draw", "a third draw", "a fourth draw")
_GREY, _SPREAD, _WIDTH, _PHASE = "gray", "viridis", "magma", "twilight"


class ComplexMaps(NamedTuple):
    """Pixel maps of complex draws: amplitudes in the object's unit, phases in radians."""

    mean_amplitude: np.ndarray
    mean_phase: np.ndarray
    sd_amplitude: np.ndarray
    sd_phase: np.ndarray
    width_amplitude: np.ndarray
    width_phase: np.ndarray


def complex_maps(values: np.ndarray, level: float = 0.9) -> ComplexMaps:
    """Maps of aligned complex draws (chains, draws, *shape).

    Phases are referred to that of the mean field, so that an interval never straddles the cut at
    +-pi; their sd is circular. Widths are those of the central interval that holds `level`, or of
    fewer draws of the widest there is (`spread.held_by`); all are 0 of draws that stand still.
    """
    mean = values.mean(axis=(0, 1))
    amplitude, phase = np.abs(values), np.angle(values * np.exp(-1j * np.angle(mean)))
    return ComplexMaps(
        amplitude.mean(axis=(0, 1)),
        np.angle(mean),
        amplitude.std(axis=(0, 1)),
        circular_sd(phase) if varies(phase.reshape(-1, *mean.shape), 0) else np.zeros(mean.shape),
        widest(amplitude, level),
        widest(phase, level),
    )


def overview(
    path: str | os.PathLike | None,
    truth: np.ndarray | None,
    data: np.ndarray,
    draws: Sequence[np.ndarray],
    mean: np.ndarray,
    sd: np.ndarray,
    width: np.ndarray,
    *,
    data_title: str = "recording",
    data_is_object: bool = False,
    title: str | None = None,
    level: float = 0.9,
) -> np.ndarray:
    """Draw a run, save it as PNG to `path` unless that is None, and return the axes (panels,).

    `draws`: objects (h, w), two or more; in colour (h, w, 3), and then so are `sd` and `width`, of
    which the root mean square over the channels is shown; `mean`: an object; `data`: any picture,
    shown on the object's scale if `data_is_object`. `sd` and `width` (of the `level` interval) are
    (h, w); for complex objects (2, h, w), of amplitude and of phase in radians, and then `truth`
    and `draws` must be aligned to `mean` (`gauge.align`). Without `truth` its panel, and that of
    the error of the mean, are left out. The figure is `axes[0].figure`.
    Raises ValueError for fewer than two draws, and draws of another shape than the mean.
    """
    shapes = {np.shape(draw) for draw in draws}
    if len(draws) < 2 or shapes != {np.shape(mean)}:
        raise ValueError(
            f"{len(draws)} draws of shape {', '.join(map(str, shapes))} beside a mean of "
            f"{np.shape(mean)}: give two draws or more, each shaped as the mean"
        )
    shown = _Shown(truth, data, draws, mean, sd, width, data_title, data_is_object, level)
    figure = _complex_overview(shown) if np.iscomplexobj(mean) else _real_overview(shown)
    if title:
        figure.suptitle(title, fontsize=11, y=0.985)
    if path is not None:
        FigureCanvasAgg(figure).print_figure(os.fspath(path), dpi=_DPI, format="png")
    return np.array([axes for axes in figure.axes if axes.images])


class _Shown(NamedTuple):
    """What an overview is drawn from."""

    truth: np.ndarray | None
    data: np.ndarray
    draws: Sequence[np.ndarray]
    mean: np.ndarray
    sd: np.ndarray
    width: np.ndarray
    data_title: str
    data_is_object: bool
    level: float


class _Panel(NamedTuple):
    """A picture under its heading, in the colours of `scale`; without a picture it is left out."""

    title: str
    picture: np.ndarray | None
    scale: ScalarMappable


# ---- real objects --------------------------------------------------------------------------------


def _real_overview(shown: _Shown) -> Figure:
    """Two rows: what is known above, what is drawn below; how sure each pixel is at their ends."""
    truth, mean = shown.truth, shown.mean
    error = None if truth is None else _over_channels(np.abs(mean - truth))
    shown = shown._replace(sd=_over_channels(shown.sd), width=_over_channels(shown.width))
    grey = _scale([*shown.draws[:2], mean, *([] if truth is None else [truth])], _GREY)
    own = grey if shown.data_is_object else _scale([shown.data], _GREY)
    spread, wide = _spread_scale(shown.sd, error), _scale([shown.width], _WIDTH, zero=True)
    top = _present(
        _Panel("truth", truth, grey),
        _Panel(shown.data_title, shown.data, own),
        _Panel("posterior mean", mean, grey),
        _Panel("standard deviation", shown.sd, spread),
    )
    bottom = _present(
        _Panel("a draw", shown.draws[0], grey),
        _Panel("another draw", shown.draws[1], grey),
        _Panel("error of the mean", error, spread),
        _Panel(f"width of {100 * shown.level:.0f} % interval", shown.width, wide),
    )
    columns = len(top)
    aspect = mean.shape[0] / mean.shape[1]
    figure, grid = _canvas(columns, 2, [0.08] + [1] * columns + [0.08], aspect)
    for row, panels in enumerate((top, bottom)):
        for column, panel in enumerate(panels):
            _show(figure, grid[row, column + 1], panel)
    _bar(figure, grid[:, 0], grey, "object", left=True)
    _bar(figure, grid[0, -1], spread, "sd" if truth is None else "sd, error")
    _bar(figure, grid[1, -1], wide, "width")
    return figure


def _over_channels(values: np.ndarray) -> np.ndarray:
    """A map (h, w) of one (h, w[, 3])."""
    return values if values.ndim == 2 else np.sqrt(np.mean(values**2, axis=-1))


# ---- complex objects -----------------------------------------------------------------------------


class _Part(NamedTuple):
    """Amplitude or phase of complex objects: its values, the error of two, its colours."""

    name: str
    unit: str
    of: Callable[[np.ndarray], np.ndarray]
    error: Callable[[np.ndarray, np.ndarray], np.ndarray]
    scale: Callable[[Sequence[np.ndarray]], ScalarMappable]


def _complex_overview(shown: _Shown) -> Figure:
    """Amplitudes, phases, and a last row of how sure both are; five columns in each."""
    truth, mean = shown.truth, shown.mean
    draws = [(name, shown.draws[i % len(shown.draws)]) for i, name in enumerate(_DRAWS)]
    objects = [("posterior mean", mean), *draws]
    if truth is not None:
        objects = [("truth", truth), *objects[:3]]
    figure, grid = _canvas(5, 3, [0.08] + [1] * 5, mean.shape[0] / mean.shape[1], 0.15, 0.45)
    _show(figure, grid[2, 1], _Panel(shown.data_title, shown.data, _scale([shown.data], _GREY)))
    for row, (part, sd, width) in enumerate(zip(_PARTS, shown.sd, shown.width)):
        pictures = [part.of(o) for _, o in objects]
        error = None if truth is None else part.error(mean, truth)
        scale, spread = part.scale(pictures), _spread_scale(sd, error)
        panels = [_Panel(title, p, scale) for (title, _), p in zip(objects, pictures)]
        panels = _present(*panels, _Panel("error of the mean", error, spread))
        for column, panel in enumerate(panels):
            # The headings of the first row are those of the second too.
            panel = panel._replace(title="") if row else panel
            _show(figure, grid[row, column + 1], panel)
        _bar(figure, grid[row, 0], scale, part.unit, left=True)
        sure = (
            _Panel(f"sd of {part.name}", sd, spread),
            _Panel(
                f"{100 * shown.level:.0f} % width, {part.name}",
                width,
                _scale([width], _WIDTH, zero=True),
            ),
        )
        for column, panel in enumerate(sure):
            _bar_under(figure, _show(figure, grid[2, 2 + 2 * row + column], panel), panel.scale)
    return figure


def phase_scale(phases: Sequence[np.ndarray]) -> ScalarMappable:
    """Symmetric; short of the whole circle, the two ends of the colours must not look alike."""
    largest = np.quantile(np.abs(np.concatenate([np.ravel(p) for p in phases])), 0.995)
    limit = min(1.5 * largest, np.pi)
    return ScalarMappable(Normalize(-limit, limit), mpl.colormaps[_PHASE])


_PARTS = (
    _Part(
        "amplitude",
        "amplitude",
        np.abs,
        lambda a, b: np.abs(np.abs(a) - np.abs(b)),
        lambda amplitudes: _scale(amplitudes, _GREY),
    ),
    _Part(
        "phase", "phase / rad", np.angle, lambda a, b: np.abs(np.angle(a * b.conj())), phase_scale
    ),
)


# ---- parts ---------------------------------------------------------------------------------------


def _canvas(
    panels: int,
    rows: int,
    ratios: Sequence[float],
    aspect: float,
    right: float = 0.65,
    under: float = 0.0,
) -> tuple[Figure, GridSpec]:
    """A figure of panels; `right` and `under`: inches left free beside and below them."""
    width = _INCH * sum(ratios) + 0.1 * _INCH * len(ratios) + 0.55 + right
    height = rows * (_INCH * aspect + 0.3) + 0.55 + under
    figure = Figure(figsize=(width, height))
    grid = GridSpec(
        rows,
        len(ratios),
        figure,
        width_ratios=ratios,
        left=0.65 / width,
        right=1 - right / width,
        bottom=(0.12 + under) / height,
        top=1 - 0.62 / height,
        wspace=0.1 * len(ratios) / sum(ratios),
        hspace=0.16 / aspect,
    )
    return figure, grid


def _scale(pictures: Sequence[np.ndarray], colours: str, zero: bool = False) -> ScalarMappable:
    """One colour scale for all: the range without the extreme half per cent at each end."""
    values = np.concatenate([np.ravel(p) for p in pictures])
    low, high = np.quantile(values, [0.005, 0.995])
    return ScalarMappable(Normalize(0 if zero else low, high), mpl.colormaps[colours])


def _spread_scale(sd: np.ndarray, error: np.ndarray | None) -> ScalarMappable:
    """From zero, for a map of sd and the error it should foretell: nearly all are under 2 sd."""
    top = max(np.quantile(sd, 0.995), 0 if error is None else np.quantile(error, 0.95))
    return ScalarMappable(Normalize(0, top), mpl.colormaps[_SPREAD])


def _present(*panels: _Panel) -> list[_Panel]:
    return [panel for panel in panels if panel.picture is not None]


def _show(figure: Figure, place: SubplotSpec, panel: _Panel) -> Axes:
    axes, scale, picture = figure.add_subplot(place), panel.scale, panel.picture
    if picture.ndim == 3:
        # Matplotlib applies no scale to colours.
        picture = np.clip(scale.norm(picture), 0, 1)
    axes.imshow(picture, norm=scale.norm, cmap=scale.cmap, interpolation="nearest")
    axes.set_title(panel.title, fontsize=9, pad=4)
    axes.set_xticks([])
    axes.set_yticks([])
    return axes


def _bar(
    figure: Figure, place: SubplotSpec, scale: ScalarMappable, label: str, left: bool = False
) -> None:
    axes = figure.add_subplot(place)
    bar = figure.colorbar(scale, cax=axes, ticklocation="left" if left else "right")
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8, length=2)
    bar.ax.locator_params(nbins=5)
    bar.outline.set_visible(False)


def _bar_under(figure: Figure, axes: Axes, scale: ScalarMappable) -> None:
    # Narrower than the panel, so that the numbers at its ends stay clear of the next one's.
    place = axes.inset_axes([0.06, -0.08, 0.88, 0.05])
    bar = figure.colorbar(scale, cax=place, orientation="horizontal")
    bar.ax.tick_params(labelsize=8, length=2)
    bar.ax.locator_params(nbins=4)
    bar.outline.set_visible(False)
