"""What the answers are worth: a table for each condition, and the first picture as each sees it."""

from collections.abc import Iterable

import numpy as np
from matplotlib.figure import Figure

from ..diagnostics.coverage import coverage
from ..diagnostics.features import HAAR, Features
from ..diagnostics.fidelity import crps, psnr, ssim
from ..diagnostics.frechet import frechet_from_truths, frechet_of_halves
from ..diagnostics.regions import as_planes, block_means, image_means
from ..diagnostics.spread import spread_over_error
from .harness import Answer
from .systems import SYSTEMS

LEVELS = (0.5, 0.9)
_HEAD = (
    "system", "mean, dB", "paper, dB", "a draw, dB", "SSIM", "paper, SSIM", "CRPS x 1000",
    "Frechet / floor (p)", "pixels in 50 / 90 %", "8x8 means", "image mean", "spread over error",
    "s a draw", "MB",
)  # fmt: skip
# The paper's Table 1 has these noise levels.
_PUBLISHED_AT = (0.025, 0.05, 0.1, 0.2)

_PROTOCOL = (
    "Published: Table 1 of arXiv 2212.03235, of 1000 faces of CelebA at 64x64 in colour, true "
    "counts behind 8 bits, each system with the paper's own networks; it does not say of how many "
    "draws its figures are. PSNR and SSIM here are of the mean of the draws. Its FID is of the "
    "features of Inception and cannot be compared with the Frechet distances here. DPS it shows on "
    "FFHQ at 256x256 alone (36.8 / 33.8 / 31.5 / 28.6 dB at sigma_0 = 0.025 / 0.05 / 0.1 / 0.2)."
)


def judged(answer: Answer, truths: np.ndarray) -> dict[str, float | tuple[float, ...]]:
    """Figures of an answer against truths (n, h, w[, 3]), n >= 2; errors are by images.

    Fidelity of the mean of the draws, and of draws by themselves; for those that sample the share
    of truths inside the central intervals of LEVELS with its standard error, by randomised ranks,
    and the spread of the draws over the error of their mean (1 is right). `seconds`: the median, so
    that the first recording, which compiles, does not count.
    """
    draws = answer.images
    means = draws.mean(axis=1)
    quality = np.array([psnr(mean, truth) for mean, truth in zip(means, truths)])
    found = {
        "psnr": float(quality.mean()),
        "psnr error": float(quality.std(ddof=1) / np.sqrt(len(quality))),
        "ssim": float(np.mean([ssim(mean, truth) for mean, truth in zip(means, truths)])),
        "seconds": float(np.median(answer.seconds)) / draws.shape[1],
        "memory": answer.memory / 1e6,
    }
    if draws.shape[1] < 2:
        return found
    rng = np.random.default_rng(0)
    drawn, true = (draws, truths) if truths.ndim == 3 else (as_planes(draws), as_planes(truths))
    asked = {"pixels": _same, "blocks": block_means, "image mean": image_means}
    for name, f in asked.items():
        shares = [coverage(f(drawn), f(true), level, rng) for level in LEVELS]
        found[name] = tuple(value for share in shares for value in (share.share, share.error))
    found["draw psnr"] = float(np.mean([psnr(x[0], truth) for x, truth in zip(draws, truths)]))
    found["crps"] = float(np.mean([crps(x, truth).mean() for x, truth in zip(draws, truths)]))
    found["spread"] = spread_over_error(draws, truths)
    return found


def _same(images: np.ndarray) -> np.ndarray:
    return images


def as_table(
    condition: str, answers: dict[str, Answer], truths: np.ndarray, features: Features = HAAR
) -> str:
    """Markdown: a row for each system that answered `condition`, and why others did not.

    Frechet distances are of `features`, beside what exchangeable pictures would have.
    """
    lines = [
        f"## sigma_0 = {condition}",
        "",
        row_of(_HEAD),
        "|" + "---|" * len(_HEAD),
    ]
    for system, answer in answers.items():
        if not answer.refusal:
            row = _row(
                system, condition, judged(answer, truths), _likeness(answer, truths, features)
            )
            lines.append(row_of(row))
    return "\n".join([*lines, "", _legend(truths, features), "", *refusals(answers)])


def row_of(cells: Iterable[str]) -> str:
    """A row of a table in Markdown."""
    return "| " + " | ".join(cells) + " |"


def _likeness(answer: Answer, truths: np.ndarray, features: Features) -> str:
    rng = np.random.default_rng(0)
    found = frechet_from_truths(truths, answer.images, rng, features)
    return f"{found.value:.2g} / {found.floor:.2g} ({found.p:.2f})"


def _legend(truths: np.ndarray, features: Features) -> str:
    halves = frechet_of_halves(truths, np.random.default_rng(0), features)
    return (
        f"Frechet: squared distance of all answers' images from the truths' by {features.name}, "
        "each feature over its sd of the truths; floor: on average where one of the images of each "
        "recording, truth or answer, is called its truth at random, and p by these. Two halves of "
        f"the truths, which are of different pictures, are {halves:.2g} apart."
    )


def refusals(answers: dict[str, Answer]) -> list[str]:
    """A line for each system that did not answer, and why; an empty one after them."""
    lines = [
        f"- {system}: no answer to {' '.join(answer.refusal.split())}"
        for system, answer in answers.items()
        if answer.refusal
    ]
    return [*lines, *([""] if lines else [])]


def _row(system: str, condition: str, found: dict, likeness: str) -> list[str]:
    known = SYSTEMS[system]
    quality, percent = (_at(condition, p) for p in (known.published, known.published_ssim))
    row = [
        system,
        f"{found['psnr']:.2f} ± {found['psnr error']:.2f}",
        "" if quality is None else f"{quality}",
    ]
    likenesses = [f"{found['ssim']:.3f}", "" if percent is None else f"{percent / 100:.2f}"]
    if "spread" not in found:
        row += ["", *likenesses, "", likeness, *[""] * 4]
    else:
        row += [f"{found['draw psnr']:.2f}", *likenesses, f"{1000 * found['crps']:.1f}", likeness]
        row += [shares(found[name]) for name in ("pixels", "blocks", "image mean")]
        row += [f"{found['spread']:.2f}"]
    return [*row, f"{found['seconds']:.2g}", f"{found['memory']:.0f}"]


def _at(condition: str, published: tuple[float, ...]) -> float | None:
    return dict(zip(_PUBLISHED_AT, published)).get(float(condition))


def protocol(systems: list[str], about: str) -> str:
    """Markdown: `about` the recordings, what the published are of, where systems are from."""
    references = [f"- {name}: {SYSTEMS[name].reference}." for name in systems]
    return "\n".join([about, "", _PROTOCOL, "", *references, ""])


def shares(found: tuple[float, ...]) -> str:
    """Coverage at LEVELS in percent, with the error of the last."""
    half, _, most, error = found
    return f"{100 * half:.0f} / {100 * most:.0f} ± {100 * error:.0f}"


def picture(answers: dict[str, dict[str, Answer]], truths: dict[str, np.ndarray]) -> Figure:
    """A row for each condition: its first truth, and the mean of each system's answer to it."""
    names = list(dict.fromkeys(name for found in answers.values() for name in found))
    size = (1.5 * (len(names) + 1), 2 * len(answers))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(answers), len(names) + 1, squeeze=False)
    for row, (condition, found) in zip(axes, answers.items()):
        truth = truths[condition]
        row[0].set_ylabel(condition, fontsize=8)
        _show(row[0], truth, "truth", truth.max())
        for axis, name in zip(row[1:], names):
            answer = found.get(name)
            if answer is None or answer.refusal:
                axis.set_axis_off()
                continue
            mean = answer.images[0].mean(axis=0)
            _show(axis, mean, f"{name}\n{psnr(mean, truth):.1f} dB", truth.max())
    return figure


def _show(axis, image: np.ndarray, title: str, white: float) -> None:  # noqa: ANN001
    axis.imshow(np.clip(image / white, 0, 1), cmap="gray", vmin=0, vmax=1)
    axis.set_title(title, fontsize=7)
    axis.set_xticks([])
    axis.set_yticks([])
