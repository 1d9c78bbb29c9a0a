"""The price of each approximation: a table beside exact draws, and a figure of it."""

from typing import NamedTuple

import numpy as np

from ..diagnostics.coverage import coverage
from ..diagnostics.distance import noise_floor, sliced_wasserstein
from ..diagnostics.fidelity import psnr
from ..diagnostics.ranks import randomised_ranks
from ..diagnostics.spread import spread_over_error
from .approximations import APPLICATIONS, EXACT, VARIANTS
from .harness import Answer
from .report import refusals, row_of

LEVELS = (0.5, 0.9)
# Exact draws that are taken for truths, and pairs of exact sets that the noise floor is of.
_TRUTHS, _PAIRS = 200, 4
_HEAD = (
    "application", "problem", "variant", "mean off, sd", "sd off", "ratio of sds",
    "distance / floor", "whole, sd", "whole / floor", "in 50 / 90 %", "spread over error",
    "mean, dB", "s a draw",
)  # fmt: skip


class Apart(NamedTuple):
    """Sliced Wasserstein distance from as many exact draws, in posterior sds, and of exact sets."""

    distance: float
    floor: float

    @property
    def over(self) -> float:
        """The distance over the floor: 1 is as good as exact."""
        return self.distance / self.floor


class Cost(NamedTuple):
    """What a variant makes of a problem; None where it cannot be known.

    Of amplitudes of complex objects, of values of real ones, and over all pixels and recordings:
    `mean_off` the root mean square error of the mean in sds of the exact posterior, `sd_off` that
    of the sd as a share of the exact one, `ratio` the geometric mean of sds over exact ones;
    `distance` that of all of them together, `whole` that of whole objects; `inside` the shares of
    the truth inside the central intervals of LEVELS and the standard error of the last; `spread`
    the sd over the error of the mean; `psnr` in dB, of pictures; `seconds` a draw.
    """

    mean_off: float | None
    sd_off: float | None
    ratio: float | None
    distance: Apart | None
    whole: Apart | None
    inside: tuple[float, float, float]
    spread: float
    psnr: float | None
    seconds: float


def beside_reference(draws: np.ndarray, reference: np.ndarray, seconds: np.ndarray) -> Cost:
    """Of draws (n, L, *shape) of n posteriors, of which `reference` (n, M, *shape) are exact draws.

    M of 2 L or more. Coverage and the error of the mean are averages over the exact posterior and
    not over one truth a recording; recordings are the unit of errors. `seconds` (n,) of recordings.
    Raises ValueError for one recording or too few exact draws.
    """
    if len(draws) < 2 or reference.shape[1] < 2 * draws.shape[1]:
        raise ValueError(
            f"{len(draws)} recordings, {reference.shape[1]} exact draws beside {draws.shape[1]}: "
            "give 2 or more, and twice as many"
        )
    asked, exact = _asked(draws), _asked(reference)
    mean, sd = exact.mean(axis=1), exact.std(axis=1)
    ratio = asked.std(axis=1) / sd
    off = (asked.mean(axis=1) - mean) / sd
    rng = np.random.default_rng(0)
    # The mean of (mean - truth)^2 over exact truths.
    error = np.mean((asked.mean(axis=1) - mean) ** 2 + sd**2)
    amplitudes, count = _apart(asked, exact, rng), draws.shape[1]
    spread = np.sqrt(np.mean(asked.var(axis=1, ddof=1)) * (1 + 1 / count) / error)
    return Cost(
        mean_off=_root_mean_square(off),
        sd_off=_root_mean_square(ratio - 1),
        ratio=float(np.exp(np.mean(np.log(ratio)))),
        distance=amplitudes,
        whole=_apart(draws, reference, rng) if np.iscomplexobj(draws) else amplitudes,
        inside=_inside(asked, exact, rng),
        spread=float(spread),
        psnr=None,
        seconds=float(np.median(seconds)) / count,
    )


def beside_truths(draws: np.ndarray, truths: np.ndarray, seconds: np.ndarray) -> Cost:
    """Of draws (n, L, h, w) where only the truths (n, h, w) are known."""
    rng = np.random.default_rng(0)
    found = [coverage(draws, truths, level, rng) for level in LEVELS]
    return Cost(
        *[None] * 5,
        inside=(found[0].share, found[1].share, found[1].error),
        spread=spread_over_error(draws, truths),
        psnr=_quality(draws, truths),
        seconds=float(np.median(seconds)) / draws.shape[1],
    )


def costs(answers: dict[str, Answer], truths: np.ndarray) -> dict[str, Cost]:
    """Of every variant that answered; beside the exact draws, where they are among the answers.

    A row `EXACT` is of as many exact draws, beside others.
    """
    answered = {name: a for name, a in answers.items() if not a.refusal and name != EXACT}
    if EXACT not in answers:
        return {n: beside_truths(a.images, truths, a.seconds) for n, a in answered.items()}
    exact, seconds = answers[EXACT].images, answers[EXACT].seconds
    found = {n: beside_reference(a.images, exact, a.seconds) for n, a in answered.items()}
    if answered:
        count = next(iter(answered.values())).images.shape[1]
        seconds = seconds * count / exact.shape[1]
        one, others = exact[:, :count], exact[:, count:]
        found[EXACT] = beside_reference(one, others, seconds)
    if truths.ndim == 3 and not np.iscomplexobj(truths):
        for name, cost in found.items():
            draws = answers[name].images
            found[name] = cost._replace(psnr=_quality(draws, truths))
    return found


def cost_table(costed: dict[str, dict[str, Cost]], found: dict[str, dict[str, Answer]]) -> str:
    """Markdown: a row for each problem and variant, and what the columns and variants are.

    `costed`: the `costs` of each problem's answers in `found`, which tell what was refused.
    """
    lines = [row_of(_HEAD), "|" + "---|" * len(_HEAD)]
    for problem, variants in costed.items():
        for name, cost in variants.items():
            first = [APPLICATIONS.get(problem, "Poisson denoising"), problem, name]
            lines.append(row_of([*first, *_cells(cost)]))
    about = [f"- {name}: {variant.about}" for name, variant in VARIANTS.items()]
    refused = [
        line.replace("- ", f"- {problem}, ", 1)
        for problem, answers in found.items()
        for line in refusals(answers)
        if line
    ]
    return "\n".join([*lines, "", _LEGEND, "", *about, *refused, ""])


_LEGEND = (
    "Means, sds, distances (sliced Wasserstein) and intervals are of amplitudes where objects are "
    "complex; whole: distance of whole objects, phases and odds of modes included. Floor: of two "
    "exact sets as large. In 50 / 90 %: how much of the exact posterior these intervals hold; of "
    "pictures, how many pixels of the truths."
)


def _cells(cost: Cost) -> list[str]:
    half, most, error = cost.inside
    numbers = [""] * 6
    if cost.ratio is not None:
        numbers = [f"{value:.2f}" for value in (cost.mean_off, cost.sd_off, cost.ratio)]
        numbers += [f"{cost.distance.over:.1f}", f"{cost.whole.distance:.2f}"]
        numbers += [f"{cost.whole.over:.1f}"]
    return [
        *numbers,
        f"{100 * half:.0f} / {100 * most:.0f} ± {100 * error:.0f}",
        f"{cost.spread:.2f}",
        "" if cost.psnr is None else f"{cost.psnr:.2f}",
        f"{cost.seconds:.2g}",
    ]


def _asked(x: np.ndarray) -> np.ndarray:
    return np.abs(x) if np.iscomplexobj(x) else np.asarray(x, float)


def _apart(draws: np.ndarray, reference: np.ndarray, rng: np.random.Generator) -> Apart:
    """On average over the recordings."""
    found = np.array([_of_recording(a, b, rng) for a, b in zip(draws, reference)])
    return Apart(*found.mean(axis=0).tolist())


def _of_recording(
    draws: np.ndarray, reference: np.ndarray, rng: np.random.Generator
) -> tuple[float, float]:
    sd = np.sqrt(np.mean(np.abs(reference - reference.mean(axis=0)) ** 2))
    if np.iscomplexobj(reference):
        sd = sd / np.sqrt(2)
    size = len(draws)
    # The same number of pairs for both: one alone would be as noisy as the floor is high.
    apart = np.mean(
        [
            sliced_wasserstein(draws, reference[rng.permutation(len(reference))[:size]], rng)
            for _ in range(_PAIRS)
        ]
    )
    return float(apart / sd), noise_floor(reference, size, rng, _PAIRS) / sd


def _inside(
    asked: np.ndarray, exact: np.ndarray, rng: np.random.Generator
) -> tuple[float, float, float]:
    truths = exact[:, :_TRUTHS]
    ranks = np.stack(
        [
            randomised_ranks(t, np.broadcast_to(a, (len(t), *a.shape)), rng)
            for t, a in zip(truths, asked)
        ]
    )
    middle = np.abs(ranks - 0.5).reshape(len(ranks), -1)
    half, most = ((middle < level / 2).mean(axis=1) for level in LEVELS)
    return half.mean(), most.mean(), most.std(ddof=1) / np.sqrt(len(most))


def _quality(draws: np.ndarray, truths: np.ndarray) -> float:
    return float(np.mean([psnr(d.mean(axis=0), t) for d, t in zip(draws, truths)]))


def _root_mean_square(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))
