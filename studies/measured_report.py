"""What the answers to real captures are worth, and whether their noise is what the model says."""

import numpy as np

from ..diagnostics.residuals import Residuals, residual_checks
from .harness import Answer
from .measured import CLEAR, Captures, Measured
from .report import judged, refusals, row_of, shares

_HEAD = (
    "system", "mean, dB", "as averaged", "a draw, dB", "SSIM", "CRPS x 1000", "pixels in 50 / 90 %",
    "as averaged", "8x8 means", "as averaged", "spread over error", "left over: square",
    "left over: rows", "s a draw", "MB",
)  # fmt: skip
_MODEL_HEAD = (
    "field",
    "levels a photon",
    "offset",
    "light",
    "square (1)",
    "rows (0)",
    "columns (0)",
    "32x32 blocks (1)",
)

_PROTOCOL = (
    "Published: real data in arXiv 2212.03235, one field of fixed BPAE cells of the same set "
    "(Zhang et al. 2019), two-photon, in colour: 26 dB and SSIM 0.67 as captured, 33 dB and "
    "0.92 by the paper's draws, under networks trained on the 19 other fields of that sample "
    "with simulated noise. The noise it states, 0.025 sqrt(x) for x in 0..1, would leave 32 dB "
    "or more as captured, so that its figures must be of something stronger. Here each colour "
    "is a field by itself, one place of a sample is at hand, the camera is estimated from its "
    "captures, and the prior is of other microscopes unless one of this is named. PSNR and SSIM "
    "are of the mean of the draws against the average of 50 captures, in the light of each.\n"
)


def judged_capture(
    study: Measured, field: str, answer: Answer, scaled: bool
) -> dict[str, float | tuple[float, ...]]:
    """`judged` in shares of white, against the average: as it is, or in each capture's light.

    Fidelity of the draws themselves; coverage, CRPS and spread of the averages that they foretell,
    for the average of some captures has an error of its own.
    """
    patches = range(len(answer.images))
    truths = np.stack([study.truth(field, i, scaled) for i in patches])
    grey = study.fields[field].to_grey(answer.images)
    found = judged(answer._replace(images=grey), truths)
    if answer.images.shape[1] > 1:
        foretold = np.stack([study.predicted(field, i, answer.images[i]) for i in patches])
        calibration = judged(answer._replace(images=foretold), truths)
        for name in ("pixels", "blocks", "crps", "spread"):
            found[name] = calibration[name]
    return found


def left_over(study: Measured, field: str, answer: Answer, name: str) -> tuple[float, float]:
    """A figure of `Residuals` of the recording about draws, and its standard error by patches.

    Truth and draws are exchangeable: where prior and noise model hold it is what it is for the
    truth, and needs no truth to be seen.
    """
    values = []
    for i, draws in enumerate(answer.images):
        recording = study.recording(field, i)
        y, well = np.asarray(recording.y, float), recording.camera.full_well
        checks = [_about(y, draw, well) for draw in np.maximum(draws, 0)]
        values.append(np.mean([getattr(check, name).value for check in checks]))
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))


def _about(y: np.ndarray, draw: np.ndarray, well: int) -> Residuals:
    variance = draw / well
    # By what is expected and not by what was recorded, which would choose among the noises.
    clear = draw + CLEAR * np.sqrt(variance) <= 1
    return residual_checks(y - draw, np.where(clear, variance, 0.0), block=len(y) // 2)


def measured_report(study: Measured, found: dict[str, dict[str, Answer]]) -> str:
    """Markdown: the noise of every field, what each system made of it, and what is published."""
    tables = [measured_table(study, name, answers) for name, answers in found.items()]
    return "\n".join([model_table(study.fields), *tables, _PROTOCOL, ""])


def measured_table(study: Measured, field: str, answers: dict[str, Answer]) -> str:
    """Markdown: a row for each system that answered, in the capture's light unless said."""
    lines = [f"## {field}", "", row_of(_HEAD), "|" + "---|" * len(_HEAD)]
    lines += [
        row_of(_row(study, field, name, answer))
        for name, answer in answers.items()
        if not answer.refusal
    ]
    return "\n".join([*lines, "", *refusals(answers)])


def _row(study: Measured, field: str, system: str, answer: Answer) -> list[str]:
    scaled, plain = (judged_capture(study, field, answer, s) for s in (True, False))
    row = [system, f"{scaled['psnr']:.2f} ± {scaled['psnr error']:.2f}", f"{plain['psnr']:.2f}"]
    if "spread" not in scaled:
        row += ["", f"{scaled['ssim']:.3f}", *[""] * 8]
    else:
        row += [f"{scaled['draw psnr']:.2f}", f"{scaled['ssim']:.3f}"]
        row += [f"{1000 * scaled['crps']:.1f}"]
        row += [shares(f[name]) for name in ("pixels", "blocks") for f in (scaled, plain)]
        row += [f"{scaled['spread']:.2f}"]
        over = [left_over(study, field, answer, name) for name in ("square", "rows")]
        row += [f"{value:.2f} ± {error:.2f}" for value, error in over]
    return [*row, f"{scaled['seconds']:.2g}", f"{scaled['memory']:.0f}"]


def model_table(fields: dict[str, Captures]) -> str:
    """Markdown: the camera of each field, and what its noise model leaves over in each capture."""
    lines = [row_of(_MODEL_HEAD), "|" + "---|" * len(_MODEL_HEAD)]
    for name, field in fields.items():
        found = field.transfer
        camera = [
            f"{found.gain:.2f} ± {found.gain_error:.2f}",
            f"{found.offset:.2f} ± {found.offset_error:.2f}",
        ]
        for i in range(len(field.captures)):
            first = [name, *camera] if i == 0 else ["", "", ""]
            lines.append(row_of([*first, f"{field.light(i):.3f}", *_checks(field.residuals(i))]))
    return "\n".join(["## Does the noise model hold?", "", *lines, ""])


def _checks(found: Residuals) -> list[str]:
    return [f"{check.value:.3f} ± {check.error:.3f}" for check in found]
