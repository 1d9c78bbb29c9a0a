"""What the answers to phase retrieval are worth: figures, table, and where their variance is."""

import numpy as np
from matplotlib.figure import Figure

from ..diagnostics.coverage import coverage
from ..diagnostics.fidelity import psnr, ssim
from ..diagnostics.gauge import align, gauge_to
from ..diagnostics.reliability import reliability
from ..diagnostics.reliability_plot import plot_reliability
from ..diagnostics.spread import spread_over_error
from ..models.optics import CIRCULAR_SHIFT, CONJUGATE_FLIP
from .harness import Answer
from .phase_retrieval import Condition, PhaseRetrieval
from .phase_systems import PHASE_SYSTEMS
from .report import LEVELS, refusals, row_of, shares

_HEAD = (
    "system", "mean, dB", "sd over pictures", "published, dB", "a draw, dB", "SSIM",
    "pixels in 50 / 90 %", "spread over error", "misfit", "s a picture", "MB",
)  # fmt: skip
# The paper's Table 2 has these noise levels.
_PUBLISHED_AT = (2.0, 3.0, 4.0)
_SYMMETRIES = [CONJUGATE_FLIP, CIRCULAR_SHIFT]


def aligned(study: PhaseRetrieval, answer: Answer) -> np.ndarray:
    """Images (n, draws, h, w), flipped and shifted in a circle to lie nearest their pictures.

    Draws are first brought together by themselves, then all by what suits their mean best: each by
    itself would take from the truth what the draws do not know.
    """
    return np.stack([_brought(images, study.truth(i)) for i, images in enumerate(answer.images)])


def _brought(draws: np.ndarray, truth: np.ndarray) -> np.ndarray:
    together = align(draws[None], None, _SYMMETRIES)[0]
    return gauge_to(together.mean(axis=0), truth, _SYMMETRIES).apply(together)


def judged_phases(
    study: PhaseRetrieval, condition: str, answer: Answer
) -> dict[str, float | tuple[float, ...]]:
    """Figures of an answer; fidelity of the mean of the draws, after `aligned`.

    "psnr": mean over pictures, of each the mean over its seeds; "sd": over pictures (nan of one).
    "by seed": mean over pictures of each seed; "moves": the most that a picture's differ.
    "misfit": `Recording.misfit` of the draws as they were found.
    "seconds": of a picture, all draws, the median. For those that sample also "draw psnr",
    coverage of pixels with its error over answers, and spread over error, "each" answer's too.
    """
    images, count = aligned(study, answer), len(study.truths)
    n = len(images)
    truths = np.stack([study.truth(i) for i in range(n)])
    means = images.mean(axis=1)
    each = np.reshape([psnr(mean, truth) for mean, truth in zip(means, truths)], (-1, count))
    quality = each.mean(axis=0)
    found = {
        "by seed": tuple(each.mean(axis=1)),
        "moves": float(np.ptp(each, axis=0).max()),
        "psnr": float(quality.mean()),
        "sd": float(quality.std(ddof=1)) if count > 1 else float("nan"),
        "ssim": float(np.mean([ssim(mean, truth) for mean, truth in zip(means, truths)])),
        "misfit": float(
            np.mean(
                [study.recording(condition, i).misfit(answer.images[i]) for i in range(n)]
            )
        ),
        "seconds": float(np.median(answer.seconds)),
        "memory": answer.memory / 1e6,
    }  # fmt: skip
    if images.shape[1] < 2:
        return found
    draws = [psnr(image[0], truth) for image, truth in zip(images, truths)]
    found["draw psnr"] = float(np.mean(draws))
    rng = np.random.default_rng(0)
    covered = [coverage(images, truths, level, rng) for level in LEVELS]
    found["pixels"] = tuple(value for share in covered for value in (share.share, share.error))
    found["spread"] = spread_over_error(images, truths)
    found["each"] = tuple(spread_over_error(x[None], t[None]) for x, t in zip(images, truths))
    return found


def phase_table(
    study: PhaseRetrieval, condition: str, judged: dict[str, dict], answers: dict[str, Answer]
) -> str:
    """Markdown: a row for each system that answered, and why others did not.

    `judged`: the `judged_phases` of those that did.
    """
    lines = [f"## alpha = {condition.replace('-', ', ', 1)}", "", measured_as(study, condition), ""]
    lines += [row_of(_HEAD), "|" + "---|" * len(_HEAD)]
    lines += [row_of(_row(system, condition, found)) for system, found in judged.items()]
    lines += ["", *(line for item in judged.items() for line in _differences(*item)), ""]
    return "\n".join([*lines, *refusals(answers)])


def _differences(system: str, found: dict) -> list[str]:
    """How far seeds, and answers, differ: a line, or none where there is one of them."""
    said = []
    if len(found["by seed"]) > 1:
        seeds = ", ".join(f"{value:.1f}" for value in found["by seed"])
        said.append(f"{seeds} dB by seed, a picture moves by {found['moves']:.1f} dB at most")
    if "each" in found:
        low, high = min(found["each"]), max(found["each"])
        said.append(f"spread over error of each answer {low:.2f} to {high:.2f}")
    return [f"- {system}: {'; '.join(said)}"] if said else []


def measured_as(study: PhaseRetrieval, condition: str) -> str:
    """A sentence on how the recordings of a condition were made, and what is left in them."""
    how, recording = Condition.of(condition), study.recording(condition, 0)
    lit = float(np.mean(recording.y > 0))
    if how.gaussian:
        noise = "prDeep's normal noise of photon strength, in whole electrons"
    else:
        noise = "true photon counts" + (
            "" if how.bits is None else f", {how.bits} bits over the brightest"
        )
    return (
        f"Recordings: {noise}; an electron is {how.electron:.3g} of |F x|^2 (unitary F, x in "
        f"0..1), the brightest pixel has {recording.full_well - 1} of them, and "
        f"{100 * lit:.2g} % of the pixels of the first recording are not 0."
    )


def _row(system: str, condition: str, found: dict) -> list[str]:
    how = Condition.of(condition)
    at = dict(zip(_PUBLISHED_AT, PHASE_SYSTEMS[system].published)).get(how.alpha)
    samples = "spread" in found
    return [
        system,
        f"{found['psnr']:.2f}",
        "" if np.isnan(found["sd"]) else f"{found['sd']:.2f}",
        "" if at is None else f"{at}",
        f"{found['draw psnr']:.2f}" if samples else "",
        f"{found['ssim']:.3f}",
        shares(found["pixels"]) if samples else "",
        f"{found['spread']:.2f}" if samples else "",
        f"{found['misfit']:.3g}",
        f"{found['seconds']:.3g}",
        f"{found['memory']:.0f}",
    ]


def protocol_notes(systems: list[str]) -> str:
    """Markdown: how each row differs from what the published figure is of."""
    lines = [
        "Published: Table 2 of arXiv 2212.03235, whose rows but its own are those of Metzler et "
        "al., ICML 2018 (their definition of the noise; a mean of the six pictures). Every PSNR is "
        "the best over flip and circular shift, with the peak of 255 grey levels. The paper says "
        "of its measurements that they are photon counts with 8 bits; where the zero frequency "
        "sets the range of those bits nearly nothing is left, so that its figures must be of "
        "something milder.",
        "",
    ]
    return "\n".join([*lines, *(f"- {name}: {PHASE_SYSTEMS[name].note}." for name in systems), ""])


def variance_picture(found: dict[str, dict[str, Answer]], truth: np.ndarray) -> Figure | None:
    """Of the first answers, already `aligned`: truth, a draw, the mean, the variance of the draws
    beside the squared error (on one scale), and the error by bins of the stated sd (of 4 draws
    or more).

    A row for every condition and system with draws; None where no system sampled.
    """
    rows = [
        (condition, system, answer.images[0])
        for condition, answers in found.items()
        for system, answer in answers.items()
        if not answer.refusal and answer.images.shape[1] > 1
    ]
    if not rows:
        return None
    figure = Figure(figsize=(13, 2.3 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), 6, squeeze=False)
    for axes, (condition, system, draws) in zip(grid, rows):
        _variance_row(axes, truth, draws)
        axes[0].set_ylabel(f"{condition}\n{system}", fontsize=8)
    return figure


def _variance_row(axes: np.ndarray, truth: np.ndarray, draws: np.ndarray) -> None:
    mean, variance = draws.mean(axis=0), draws.var(axis=0, ddof=1)
    square = (mean - truth) ** 2
    white = np.quantile(square, 0.99)
    pictures = {
        "truth": (truth, 1.0),
        f"a draw, {psnr(draws[0], truth):.1f} dB": (draws[0], 1.0),
        f"mean of {len(draws)}, {psnr(mean, truth):.1f} dB": (mean, 1.0),
        "variance of the draws": (variance, white),
        "squared error of the mean": (square, white),
    }
    for axis, (title, (image, top)) in zip(axes, pictures.items()):
        axis.imshow(image, cmap="gray" if top == 1.0 else "magma", vmin=0, vmax=top)
        axis.set_title(title, fontsize=8)
        axis.set_xticks([])
        axis.set_yticks([])
    if len(draws) < 4:
        axes[-1].set_axis_off()
        return
    _reliability(axes[-1], draws[None], truth[None])


def _reliability(axis, draws: np.ndarray, truths: np.ndarray) -> None:  # noqa: ANN001
    plot_reliability(reliability(draws, truths), axis, unit=None)
    axis.set_title(f"spread over error {spread_over_error(draws, truths):.2f}", fontsize=8)
    axis.xaxis.label.set_size(7)
    axis.yaxis.label.set_size(7)
    axis.tick_params(labelsize=6)
