"""What the draws say: maps of mean and spread, fidelity to the truth, coverage, convergence."""

from typing import NamedTuple

import numpy as np

from ..diagnostics.convergence import ess, rhat
from ..diagnostics.fidelity import psnr
from ..diagnostics.gauge import align, gauge_to, symmetries_of
from ..diagnostics.modes import modes
from ..diagnostics.plots import complex_maps
from ..diagnostics.predictive import misfit
from ..diagnostics.spread import held_by, interval, widest
from ..draws import Draws
from ..models.likelihood import Likelihood
from ..models.optics import FourierPtychography
from ..presets import DENOISING, PHASE_RETRIEVAL, Question
from ..samplers import Sampler
from ..samplers.base import PopulationSampler, RunSampler

LEVEL = 0.9
MIXED = 1.05
_RANKED = round(2 / (1 - LEVEL)) - 1
_COMPARED = 50  # draws of a chain, for modes: all pairs are compared


class Summary(NamedTuple):
    """Draws (chains, draws, *shape) with what the data cannot tell aligned, and what they say.

    Of the field of view alone, where the object has a rim beyond it.
    `maps` are the pictures to write, by file name; `sd`, `width` and its `level`, which is below
    LEVEL of few draws, are as `overview` takes them.
    """

    values: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    width: np.ndarray
    level: float
    maps: dict[str, np.ndarray]
    results: dict[str, float]


def summarise(draws: Draws, question: Question, problem: str, sampler: Sampler) -> Summary:
    """Align the draws, map their mean and spread, compare them with the truth where it is known."""
    truth, optics = question.truth, question.problem.likelihood.optics
    seen = optics.field_of_view if isinstance(optics, FourierPtychography) else ()
    truth = None if truth is None else truth[seen]
    values = _aligned(draws.values[..., *seen], question.problem.likelihood, truth)
    mean = values.mean(axis=(0, 1))
    results = {}
    if truth is not None and problem == DENOISING:
        results["psnr_data"] = _psnr(question.y, truth)
    if truth is not None:
        results["psnr_mean"] = _psnr(mean, truth)
        results |= _coverages(values, truth)
    results |= _convergence(values, sampler)
    found = misfit(question.problem.likelihood, question.y, draws.values[:, -1])
    if np.isfinite(found):
        results["misfit"] = found
    if question.microscope is not None:
        results["dispersion"] = float(np.median(question.microscope["dispersion"]))
    # Draws that follow each other step by step would each seem a mode of their own.
    each_alone = isinstance(sampler, RunSampler) and values.shape[0] * values.shape[1] > 2
    if problem == PHASE_RETRIEVAL and each_alone:
        weights = modes(values[:, :: max(1, values.shape[1] // _COMPARED)]).weights
        results |= {"modes": len(weights), "largest_mode": float(weights[0])}
    if np.iscomplexobj(values):
        maps = complex_maps(values, LEVEL)
        sd = np.stack([maps.sd_amplitude, maps.sd_phase])
        width = np.stack([maps.width_amplitude, maps.width_phase])
        pictures = {f"{n}.tif": getattr(maps, n) for n in maps._fields if "width" not in n}
    else:
        sd, width = values.std(axis=(0, 1)), widest(values, LEVEL)
        pictures = {"mean.tif": mean, "sd.tif": sd}
    level = held_by(values.shape[0] * values.shape[1], LEVEL)
    return Summary(values, mean, sd, width, level, pictures, results)


def _aligned(values: np.ndarray, likelihood: Likelihood, truth: np.ndarray | None) -> np.ndarray:
    """Draws that the data cannot tell apart, brought together.

    Then, where the truth is known, all of them are brought to it as one.
    """
    symmetries = symmetries_of(likelihood, np.iscomplexobj(values))
    if not symmetries:
        return values
    values = align(values, symmetries=symmetries)
    if truth is None:
        return values
    return gauge_to(values.mean(axis=(0, 1)), truth, symmetries).apply(values)


def _psnr(estimate: np.ndarray, truth: np.ndarray) -> float:
    """In dB, the peak being 1, or the largest amplitude of a complex truth."""
    peak = np.abs(truth).max() if np.iscomplexobj(truth) else 1.0
    return psnr(estimate, truth, peak)


def _coverages(values: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """The part of the pixels whose interval holds the truth; amplitude and phase apart.

    Nothing of fewer than 19 draws: no interval between them holds 90 %.
    """
    if values.shape[0] * values.shape[1] < _RANKED:
        return {}
    if not np.iscomplexobj(values):
        return {"coverage": _coverage(values, truth)}
    # Referred to the phase of the mean, no interval straddles the cut at +-pi.
    turn = np.exp(-1j * np.angle(values.mean(axis=(0, 1))))
    return {
        "coverage_amplitude": _coverage(np.abs(values), np.abs(truth)),
        "coverage_phase": _coverage(np.angle(values * turn), np.angle(truth * turn)),
    }


def _coverage(values: np.ndarray, truth: np.ndarray) -> float:
    low, high = interval(values, LEVEL)
    return float(np.mean((low <= truth) & (truth <= high)))


def _convergence(values: np.ndarray, sampler: Sampler) -> dict[str, float]:
    """Largest R-hat and smallest effective sample size of all pixels (Re and Im apart).

    Of independent draws their number alone: the largest of many R-hats would only be noise.
    """
    if sampler.independent:
        return {"ess": float(values.shape[0] * values.shape[1])}
    if len(values) < 2 or values.shape[1] < 4:
        return {}
    parts = (values.real, values.imag) if np.iscomplexobj(values) else (values,)
    parts = [part for part in parts if np.ptp(part) > 0]
    # Pixels that never move have no R-hat: as bad as can be.
    worst = [np.nan_to_num(rhat(part), nan=np.inf) for part in parts] or np.inf
    found = {"rhat": float(np.max(worst)), "unmixed": float(np.mean(np.greater(worst, MIXED)))}
    # Particles have no order: counting their correlation would say nothing.
    if not isinstance(sampler, PopulationSampler):
        found["ess"] = float(np.min([np.nan_to_num(ess(part)) for part in parts] or 0.0))
    return found
