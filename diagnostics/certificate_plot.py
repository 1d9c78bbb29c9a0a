"""The certificates of many samplers at a glance: a cell for each sampler and problem."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from .certificate import VERDICTS, Certificate
from .certificate_table import problems_of, said

# Blue, orange and grey are told apart by every eye, and the symbols without colour.
COLOURS = dict(zip(VERDICTS, ("#bfdcf0", "#f7c68d", "#dedede", "#ffffff")))
SYMBOLS = dict(zip(VERDICTS, ("\N{CHECK MARK}", "\N{BALLOT X}", "?", "\N{EN DASH}")))


def plot_certificates(
    certificates: Mapping[str, Mapping[str, Certificate]], axes: Axes | None = None
) -> Axes:
    """Draw {sampler: {problem: certificate}}: a column for each sampler, a row for each problem.

    Colour and symbol are the verdict, the number is the distance from exact draws over the noise
    floor: 1 is as good as exact and independent. An empty cell was not run. Returns the axes, new
    ones unless given. Raises ValueError for no certificates.
    """
    check_certificates(certificates)
    samplers, problems = list(certificates), problems_of(certificates)
    if axes is None:
        size = (4.5 + 1.1 * len(samplers), 1.3 + 0.36 * len(problems))
        axes = Figure(figsize=size, layout="constrained").add_subplot()
    for column, by_problem in enumerate(certificates.values()):
        for row, problem in enumerate(problems):
            if problem in by_problem:
                _cell(axes, column, row, by_problem[problem])
    axes.set(xlim=(-0.5, len(samplers) - 0.5), ylim=(len(problems) - 0.5, -0.5))
    axes.set_xticks(range(len(samplers)), samplers)
    axes.set_yticks(range(len(problems)), problems)
    axes.tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
    about = "number: distance from exact draws over the noise floor"
    axes.set_xlabel(about, loc="left", fontsize=8)
    axes.spines[:].set_visible(False)
    shown = [
        Rectangle((0, 0), 1, 1, facecolor=COLOURS[kind], edgecolor="0.5", label=f"{symbol} {kind}")
        for kind, symbol in SYMBOLS.items()
    ]
    axes.figure.legend(handles=shown, ncols=4, fontsize=8, frameon=False, loc="outside lower right")
    return axes


def check_certificates(certificates: Mapping[str, Mapping[str, Certificate]]) -> None:
    """Refuse none at all."""
    if not any(certificates.values()):
        raise ValueError(
            "no certificates to show: give {sampler: {problem: Certificate}}, of `certify`"
        )


def _cell(axes: Axes, column: int, row: int, found: Certificate) -> None:
    corner = (column - 0.5, row - 0.5)
    axes.add_patch(Rectangle(corner, 1, 1, facecolor=COLOURS[found.kind], edgecolor="white", lw=2))
    text = f"{SYMBOLS[found.kind]} {said(found.distance, '.2f')}".strip()
    axes.text(column, row, text, ha="center", va="center", fontsize=9)
