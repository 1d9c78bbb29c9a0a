"""Figures of the ptychography study: PSNR by noise and by LEDs, scatter, and maps of one object."""

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..diagnostics.spread import circular_sd
from .harness import Answer
from .ptychography import Condition
from .ptychography_report import Judged, aligned

_MARKS = "osD^vP"
_SHOWN_PIXELS = 3000


def psnr_panels(
    found: dict[str, dict[str, Judged]], by_sigma: Iterable[str], by_leds: Iterable[str]
) -> Figure:
    """The paper's figure: amplitude and phase PSNR of the mean, against sigma_0 and against LEDs.

    `found`: by condition and system; `by_sigma` and `by_leds`: the conditions of either row. Bars
    are standard deviations over objects.
    """
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    axes = figure.subplots(2, 2)
    rows = (
        (by_sigma, lambda c: float(c.sigma), "sigma_0", lambda c: f"{c.leds} LEDs"),
        (by_leds, lambda c: c.leds, "LEDs", lambda c: f"sigma_0 = {c.sigma}"),
    )
    for row, (names, x_of, label, fixed) in zip(axes, rows):
        known = sorted((Condition.of(n) for n in names if n in found), key=x_of)
        for axis, part in zip(row, ("amplitude", "phase")):
            _lines(axis, found, known, x_of, part)
            axis.set_xlabel(label)
            axis.set_ylabel(f"PSNR of the {part}, dB")
            if known:
                axis.set_title(fixed(known[0]), fontsize=9)
    axes[0, 0].legend(fontsize=8)
    return figure


def _lines(
    axis: Axes, found: dict[str, dict[str, Judged]], known: list[Condition], x_of, part: str  # noqa: ANN001
) -> None:  # fmt: skip
    systems = list(dict.fromkeys(name for c in known for name in found[c.name]))
    ticks = [x_of(c) for c in known]
    for i, system in enumerate(systems):
        there = [c for c in known if system in found[c.name]]
        values = [getattr(found[c.name][system], part) for c in there]
        # Beside each other, so that bars can be told apart.
        x = np.array([x_of(c) for c in there]) * 1.015 ** (i - (len(systems) - 1) / 2)
        mean, sd = ([f(v) for v in values] for f in (np.mean, lambda v: np.std(v, ddof=1)))
        axis.errorbar(x, mean, sd, marker=_MARKS[i % 6], ms=4, lw=1.2, capsize=2, label=system)
    axis.set_xscale("log")
    axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axis.minorticks_off()
    axis.grid(alpha=0.3)


def scatter(truths: np.ndarray, answers: dict[str, Answer]) -> Figure:
    """True against retrieved amplitude and phase of pixels of all objects, a column a system.

    Of the mean of the draws, turned to the truth; at most 3000 pixels, the same for every system.
    The dashed red line is a perfect recovery.
    """
    figure = Figure(figsize=(2.4 * max(len(answers), 2), 5), layout="constrained")
    axes = figure.subplots(2, len(answers), squeeze=False, sharex="row", sharey="row")
    for column, (name, answer) in zip(axes.T, answers.items()):
        truth = truths[: len(answer.images)]
        mean = aligned(answer.images, truth).mean(axis=1).ravel()
        chosen = np.random.default_rng(0).permutation(mean.size)[:_SHOWN_PIXELS]
        for axis, f in zip(column, (np.abs, np.angle)):
            true = f(truth).ravel()[chosen]
            axis.plot(true, f(mean)[chosen], ".", ms=1.5, alpha=0.4, rasterized=True)
            ends = [true.min(), true.max()]
            axis.plot(ends, ends, "r--", lw=1)
        column[0].set_title(name, fontsize=9)
        column[0].set_xlabel("true amplitude", fontsize=8)
        column[1].set_xlabel("true phase", fontsize=8)
    axes[0, 0].set_ylabel("retrieved amplitude", fontsize=8)
    axes[1, 0].set_ylabel("retrieved phase", fontsize=8)
    for axis, margin in zip(axes[:, 0], (0.25, 0.4)):
        low, high = (f(axis.lines[-1].get_xdata()) for f in (min, max))
        axis.set_ylim(low - margin, high + margin)
    return figure


def maps(truth: np.ndarray, answers: dict[str, Answer]) -> Figure:
    """The first object (h, w): amplitude and phase as each system sees them, sd and error.

    Columns: amplitude of the mean, of a draw, sd and error of amplitudes; the same of phases. Error
    and sd have one scale a column pair; an estimator has no draws and no sd.
    """
    rows = len(answers) + 1
    figure = Figure(figsize=(13, 1.75 * rows), layout="constrained")
    axes = figure.subplots(rows, 8)
    for axis in axes.ravel():
        axis.set_axis_off()
    limits = [(np.abs(truth).min(), np.abs(truth).max())]
    limits += [tuple(np.quantile(np.angle(truth), (0.001, 0.999)))]
    for part, (f, range_) in enumerate(zip((np.abs, np.angle), limits)):
        _show(axes[0, 4 * part], f(truth), f"true {_PARTS[part]}", range_)
    for row, (name, answer) in zip(axes[1:], answers.items()):
        draws = aligned(answer.images[:1], truth[None])[0]
        for part, range_ in enumerate(limits):
            _row_of(row[4 * part : 4 * part + 4], part, draws, truth, range_, name)
    return figure


_PARTS = ("amplitude", "phase")
_MOST = (0.15, 0.3)  # of the scale of sd and error


def _row_of(
    row: np.ndarray, part: int, draws: np.ndarray, truth: np.ndarray, range_: tuple, name: str
) -> None:
    mean = draws.mean(axis=0)
    if part == 0:
        values, spread = np.abs(mean), np.abs(draws).std(axis=0)
        error, first = np.abs(np.abs(mean) - np.abs(truth)), np.abs(draws[0])
    else:
        values = np.angle(mean)
        spread = circular_sd(np.angle(draws)[None]) if len(draws) > 1 else None
        error, first = np.abs(np.angle(mean * truth.conj())), np.angle(draws[0])
    scale = (0.0, _MOST[part])
    _show(row[0], values, f"{name}: {_PARTS[part]}", range_)
    if len(draws) > 1:
        _show(row[1], first, "a draw", range_)
        _show(row[2], spread, f"sd, 0 to {_MOST[part]}", scale, "viridis")
    _show(row[3], error, f"error, 0 to {_MOST[part]}", scale, "viridis")


def _show(axis: Axes, image: np.ndarray, title: str, range_: tuple, colours: str = "gray") -> None:
    axis.imshow(image, cmap=colours, vmin=range_[0], vmax=range_[1])
    axis.set_title(title, fontsize=7)
