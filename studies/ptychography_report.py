"""What the answers to ptychography are worth: figures, and a table for each condition."""

from typing import NamedTuple

import numpy as np

from ..diagnostics.coverage import coverage
from ..diagnostics.fidelity import nrmse, phase_psnr, psnr
from ..diagnostics.gauge import align
from ..diagnostics.predictive import misfit
from ..diagnostics.spread import spread_over_error
from ..models.optics import GLOBAL_PHASE
from .harness import Answer
from .ptychography import Ptychography
from .ptychography_systems import PTYCHOGRAPHY_SYSTEMS
from .report import LEVELS, refusals, row_of, shares

_PROTOCOL = """\
Mean and standard error over objects, each turned by the global phase that brings it nearest to the
truth, which intensities do not tell. The paper shows this experiment as plots alone: it prints no
figures to put beside ours. What differs: its objects are bone cells of 256 x 256, ours windows of a
reconstructed blood smear; its network is NCSNv2, ours the prior's; its LEDs and its start are in a
supplement that is not at hand, ours are a disc of a square grid, and quasi-Newton. Taken over are
true Poisson counts, 8 bits (`--bits`), PSNR of amplitude and phase, 10 objects (`--objects`), Yeh
et al.'s quasi-Newton, on the exact likelihood, and the baseline: Algorithm 1 as printed without its
prior term, from where the others start.

"""

_HEAD = (
    "system", "amplitude, dB", "phase, dB", "a draw: amplitude", "phase", "complex NRMSE",
    "spread over error", "amplitudes in 50 / 90 %", "phases", "misfit (1)", "s a draw", "MB",
)  # fmt: skip


class Judged(NamedTuple):
    """Figures of one system at one condition; arrays are by object.

    PSNR of amplitude and `phase` in dB and complex `nrmse`, of the mean of the draws and of the
    first draw by itself. `misfit`: of the recording about the draws, 1 is right; below it where an
    estimate explains the noise too. Of those that sample: the spread of the complex draws over the
    error of their mean (1 is right), and the share of pixels inside central intervals of LEVELS
    with its standard error, of amplitudes and of phases. `seconds` of a draw, by the median object,
    so that the first, which compiles, does not count; `memory` in MB.
    """

    amplitude: np.ndarray
    phase: np.ndarray
    draw_amplitude: np.ndarray
    draw_phase: np.ndarray
    nrmse: np.ndarray
    misfit: np.ndarray
    seconds: float
    memory: float
    spread: float | None
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]


def protocol() -> str:
    """Markdown: what is taken over from the paper and what differs, and where systems are from."""
    systems = [f"- {name}: {system.reference}" for name, system in PTYCHOGRAPHY_SYSTEMS.items()]
    return "\n".join([_PROTOCOL, *systems, ""])


def aligned(draws: np.ndarray, truths: np.ndarray) -> np.ndarray:
    """Objects (n, draws, ...), each turned by the global phase that is nearest to its truth."""
    return np.stack([align(x, truth, [GLOBAL_PHASE]) for x, truth in zip(draws, truths)])


def judged_objects(study: Ptychography, condition: str, answer: Answer) -> Judged:
    """Figures of an answer to the first n >= 2 objects of the study."""
    truths = study.truths[: len(answer.images)]
    draws = aligned(answer.images, truths)
    means, samples = draws.mean(axis=1), draws.shape[1] > 1
    return Judged(
        *_fidelity(means, truths),
        *_fidelity(draws[:, 0], truths),
        np.array([nrmse(mean, truth) for mean, truth in zip(means, truths)]),
        np.array([_misfit(study, condition, i, x) for i, x in enumerate(draws)]),
        float(np.median(answer.seconds)) / draws.shape[1],
        answer.memory / 1e6,
        spread_over_error(draws, truths) if samples else None,
        _covered(np.abs(draws), np.abs(truths)) if samples else (),
        _covered(*_phases_about_mean(draws, truths)) if samples else (),
    )


def _fidelity(found: np.ndarray, truths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pairs = list(zip(found, truths))
    amplitude = np.array([psnr(np.abs(x), np.abs(truth)) for x, truth in pairs])
    return amplitude, np.array([phase_psnr(x, truth) for x, truth in pairs])


def _misfit(study: Ptychography, condition: str, index: int, draws: np.ndarray) -> float:
    recording = study.recording(condition, index)
    return misfit(recording.likelihood, recording.y, draws)


def _phases_about_mean(draws: np.ndarray, truths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phases counted from their mean direction, so that the circle is cut opposite to it."""
    direction = np.exp(1j * np.angle(draws)).mean(axis=1).conj()
    return np.angle(draws * direction[:, None]), np.angle(truths * direction)


def _covered(draws: np.ndarray, truths: np.ndarray) -> tuple[float, ...]:
    rng = np.random.default_rng(0)
    found = [coverage(draws, truths, level, rng) for level in LEVELS]
    return tuple(value for share in found for value in (share.share, share.error))


def ptychography_table(
    condition: str, judged: dict[str, Judged], answers: dict[str, Answer]
) -> str:
    """Markdown: a row for each system that answered, and why others did not."""
    lines = [f"## {condition}", "", row_of(_HEAD), "|" + "---|" * len(_HEAD)]
    lines += [row_of(_row(system, found)) for system, found in judged.items()]
    return "\n".join([*lines, "", *refusals(answers)])


def _row(system: str, found: Judged) -> list[str]:
    row = [system, _with_error(found.amplitude, 2), _with_error(found.phase, 2)]
    if found.spread is None:
        calibration = ["", "", f"{found.nrmse.mean():.4f}", "", "", ""]
    else:
        calibration = [
            f"{found.draw_amplitude.mean():.2f}",
            f"{found.draw_phase.mean():.2f}",
            f"{found.nrmse.mean():.4f}",
            f"{found.spread:.2f}",
            shares(found.amplitudes),
            shares(found.phases),
        ]
    cost = [f"{found.seconds:.2g}", f"{found.memory:.0f}"]
    return [*row, *calibration, _with_error(found.misfit, 2), *cost]


def _with_error(values: np.ndarray, digits: int) -> str:
    error = values.std(ddof=1) / np.sqrt(len(values))
    return f"{values.mean():.{digits}f} ± {error:.{digits}f}"
