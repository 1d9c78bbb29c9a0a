"""Certificates in Markdown: a table of all figures, and verdicts at a glance."""

from collections.abc import Mapping

from .certificate import LEVELS, Certificate


def as_table(certificates: Mapping[str, Mapping[str, Certificate]]) -> str:
    """Markdown: a row for each sampler and problem of {sampler: {problem: certificate}}.

    The distance is given +- its standard error.
    """
    rows = [
        "| sampler | problem | verdict | p over all quantities "
        "| coverage of 50, 80, 95 % where worst | distance over floor | error of modes "
        "| its floor | ESS per score evaluation | s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for sampler, by_problem in certificates.items():
        for problem, found in by_problem.items():
            cells = [sampler, problem, found.verdict, said(found.p, ".2g"), _worst_coverage(found)]
            cells += [said_distance(found), said(found.mode_error, ".2f")]
            cells += [said(found.mode_floor, ".2f"), said(found.effective_per_evaluation, ".2g")]
            rows.append(f"| {' | '.join([*cells, said(found.seconds, '.0f')])} |")
    return "\n".join(rows) + "\n"


def as_matrix(certificates: Mapping[str, Mapping[str, Certificate]]) -> str:
    """Markdown: a row for each problem, a column for each sampler, of verdicts and distances.

    Of a failure the quantity that failed; in full, with the p-values and costs, in `as_table`.
    """
    rows = [f"| problem | {' | '.join(certificates)} |", "|---" * (1 + len(certificates)) + "|"]
    for problem in problems_of(certificates):
        cells = (_at_a_glance(found.get(problem)) for found in certificates.values())
        rows.append(f"| {problem} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def problems_of(certificates: Mapping[str, Mapping[str, Certificate]]) -> list[str]:
    """The names of all problems, in the order in which they first come."""
    return list(dict.fromkeys(name for by_problem in certificates.values() for name in by_problem))


def _at_a_glance(found: Certificate | None) -> str:
    if found is None:
        return ""
    words = found.kind
    if words == "fails":
        words = "**fails**: " + found.verdict.removeprefix("fails: ").split(" (p = ")[0]
    return ", ".join(part for part in (words, said(found.distance, ".2f")) if part)


def _worst_coverage(found: Certificate) -> str:
    if found.p is None:
        return ""
    p = found.calibration.judged_p
    worst = min(p, key=p.__getitem__)
    shares = (found.calibration.coverage(level)[worst][0] for level in LEVELS)
    return ", ".join(f"{100 * share:.0f}" for share in shares)


def said(value: float | None, form: str) -> str:
    """A number in this format; nothing, where there is none."""
    return "" if value is None else format(value, form)


def said_distance(found: Certificate) -> str:
    """The distance over its floor, +- its standard error where that is known."""
    error = said(found.distance_error, ".2f")
    return said(found.distance, ".2f") + (f" \N{PLUS-MINUS SIGN} {error}" if error else "")
