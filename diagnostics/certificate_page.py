"""Certificates as one HTML page that holds everything: verdicts, figures and rank pictures."""

import base64
import io
from collections.abc import Mapping
from html import escape

from .certificate import LEVELS, Certificate
from .certificate_plot import COLOURS, SYMBOLS, check_certificates
from .certificate_table import problems_of, said, said_distance
from .rank_plot import plot_ranks

Pictures = Mapping[str, Mapping[str, bytes]]

_STYLE = """
body { max-width: 62rem; margin: 2rem auto; padding: 0 1rem; background: #fff; color: #1a1a1a;
  font: 1rem/1.5 system-ui, sans-serif; }
h1, h2, h3 { line-height: 1.2; }
h2 { margin-top: 3rem; border-bottom: 2px solid #1a1a1a; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: .3rem; }
th, td { padding: .25rem .7rem; border: 1px solid #999; text-align: left; vertical-align: top; }
td.number { text-align: right; }
thead th { background: #f2f2f2; }
.verdict { padding: .4rem .7rem; border: 1px solid #999; }
.wide { overflow-x: auto; }
a { color: #003d7a; }
img { max-width: 100%; height: auto; }
@media print {
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  body { max-width: none; font-size: 9pt; }
  section section, tr, img { break-inside: avoid; }
}
"""


def as_page(
    certificates: Mapping[str, Mapping[str, Certificate]],
    made: Mapping[str, str] | None = None,
    pictures: Pictures | None = None,
) -> str:
    """A self-contained page of {sampler: {problem: certificate}}: no scripts, nothing to load.

    `made`: how it was made, as {name: text}, such as the command and the versions. `pictures`: PNG
    files by sampler and problem; None: drawn here, by `rank_picture`. Raises ValueError for no
    certificates.
    """
    check_certificates(certificates)
    pictures = _drawn(certificates) if pictures is None else pictures
    sections = "\n".join(
        _of_sampler(column, sampler, by_problem, problems_of(certificates), pictures)
        for column, (sampler, by_problem) in enumerate(certificates.items())
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Certificates of samplers</title>
<style>{_STYLE}{_colours()}</style>
</head>
<body>
<main>
<h1>Certificates of samplers</h1>
<p>Samplers on problems whose posterior is known. Objects are drawn from the prior and recorded;
if a sampler is right, each true object ranks among its draws as one of them, in every quantity.
Beside the verdict: the distance of its draws from exact ones over that of two exact sets, 1 for
draws as good as exact and independent, ± its standard error over eight recordings. No certificate
is a proof: a fault too small for so many simulations passes.</p>
{_matrix(certificates)}
{_made(made or {})}
{sections}
</main>
</body>
</html>
"""


def rank_picture(found: Certificate, title: str) -> bytes | None:
    """The ranks of a certificate as a PNG file, under its name and verdict; None if it has none."""
    if found.calibration is None:
        return None
    axes = plot_ranks(found.calibration)
    axes.set_title(f"{title}\n{found.verdict}", fontsize=8, wrap=True)
    file = io.BytesIO()
    axes.figure.savefig(file, dpi=120, format="png")
    return file.getvalue()


def _drawn(certificates: Mapping[str, Mapping[str, Certificate]]) -> Pictures:
    return {
        sampler: {
            problem: picture
            for problem, found in by_problem.items()
            if (picture := rank_picture(found, f"{sampler}: {problem}")) is not None
        }
        for sampler, by_problem in certificates.items()
    }


def _colours() -> str:
    return "\n".join(
        f".{_class(kind)} {{ background: {colour}; }}" for kind, colour in COLOURS.items()
    )


def _class(kind: str) -> str:
    return kind.replace(" ", "-")


def _matrix(certificates: Mapping[str, Mapping[str, Certificate]]) -> str:
    head = "".join(f'<th scope="col">{escape(sampler)}</th>' for sampler in certificates)
    rows = []
    for row, problem in enumerate(problems_of(certificates)):
        cells = "".join(
            _matrix_cell(by_problem.get(problem), f"c{column}-{row}")
            for column, by_problem in enumerate(certificates.values())
        )
        rows.append(f'<tr><th scope="row">{escape(problem)}</th>{cells}</tr>')
    return f"""<div class="wide"><table>
<caption>Verdicts, and distance over the noise floor</caption>
<thead><tr><th scope="col">problem</th>{head}</tr></thead>
<tbody>
{chr(10).join(rows)}
</tbody>
</table></div>"""


def _matrix_cell(found: Certificate | None, anchor: str) -> str:
    if found is None:
        return "<td>not run</td>"
    distance = f"<br>{said_distance(found)}" if found.distance is not None else ""
    verdict = f'{SYMBOLS[found.kind]} <a href="#{anchor}">{found.kind}</a>'
    return f'<td class="{_class(found.kind)}">{verdict}{distance}</td>'


def _made(made: Mapping[str, str]) -> str:
    if not made:
        return ""
    rows = "\n".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(text)}</td></tr>'
        for name, text in made.items()
    )
    return f"<table>\n<caption>How it was made</caption>\n<tbody>\n{rows}\n</tbody>\n</table>"


def _of_sampler(
    column: int,
    sampler: str,
    by_problem: Mapping[str, Certificate],
    problems: list[str],
    pictures: Pictures,
) -> str:
    parts = "\n".join(
        _of_problem(
            f"c{column}-{problems.index(problem)}",
            sampler,
            problem,
            found,
            pictures.get(sampler, {}).get(problem),
        )
        for problem, found in by_problem.items()
    )
    return f"<section>\n<h2>{escape(sampler)}</h2>\n{parts}\n</section>"


def _of_problem(
    anchor: str, sampler: str, problem: str, found: Certificate, picture: bytes | None
) -> str:
    name = escape(f"{sampler}: {problem}")
    shown = ""
    if picture is not None:
        data = base64.b64encode(picture).decode()
        shown = (
            f'<p><img src="data:image/png;base64,{data}" '
            f'alt="Distribution of the ranks of {name}, less the uniform one"></p>'
        )
    return f"""<section id="{anchor}">
<h3>{name}</h3>
<p class="verdict {_class(found.kind)}">{SYMBOLS[found.kind]} {escape(found.verdict)}</p>
{_figures(found)}
{shown}
{_quantities(found)}
</section>"""


def _figures(found: Certificate) -> str:
    simulations = None if found.calibration is None else len(found.calibration.ranks)
    figures = {
        "p-value over all quantities judged, the smallest by Holm": said(found.p, ".2g"),
        "distance from exact draws over the noise floor": said_distance(found),
        "error of the modes' masses": said(found.mode_error, ".3f"),
        "that error of exact draws": said(found.mode_floor, ".3f"),
        "independent draws that a run is worth": said(found.effective, ".0f"),
        "prior score evaluations of a run": said(found.evaluations, ",d"),
        "independent draws per score evaluation": said(found.effective_per_evaluation, ".2g"),
        "simulations": said(simulations, "d"),
        "their seconds": said(found.seconds, ".0f"),
    }
    rows = "\n".join(
        f'<tr><th scope="row">{escape(name)}</th><td class="number">{text}</td></tr>'
        for name, text in figures.items()
        if text
    )
    return f"<table>\n<caption>Figures</caption>\n<tbody>\n{rows}\n</tbody>\n</table>" * bool(rows)


def _quantities(found: Certificate) -> str:
    if (calibration := found.calibration) is None:
        return ""
    coverage = [calibration.coverage(level) for level in LEVELS]
    judged, rows = calibration.judged_p, []
    for name, draws in zip(calibration.names, calibration.effective):
        cells = [said(judged.get(name), ".2g") or "too few draws", f"{draws:.0f}"]
        for share, error in (shares[name] for shares in coverage):
            cells.append(f"{100 * share:.0f} ± {100 * error:.0f}")
        numbers = "".join(f'<td class="number">{cell}</td>' for cell in cells)
        rows.append(f'<tr><th scope="row">{escape(name)}</th>{numbers}</tr>')
    heads = ["quantity", "p, adjusted", "draws ranked among"]
    heads += [f"truths in {100 * level:.0f} % intervals, %" for level in LEVELS]
    head = "".join(f'<th scope="col">{text}</th>' for text in heads)
    return f"""<details open><summary>Every quantity</summary>
<div class="wide"><table>
<caption>Calibration of each quantity; ± one standard error of a right sampler</caption>
<thead><tr>{head}</tr></thead>
<tbody>
{chr(10).join(rows)}
</tbody>
</table></div>
</details>"""
