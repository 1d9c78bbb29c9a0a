"""What the data cannot tell apart: objects brought together over phase, flip and shift."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..models.likelihood import Likelihood
from ..models.optics import CIRCULAR_SHIFT, CONJUGATE_FLIP, GLOBAL_PHASE
from .checks import check_finite

SYMMETRIES = (GLOBAL_PHASE, CONJUGATE_FLIP, CIRCULAR_SHIFT)


class Gauge(NamedTuple):
    """A transformation that leaves the data as they are: flip, then shift, then turn.

    `flipped`: conjugate, reversed along every axis; `shift`: pixels along each axis, circular;
    `turn`: a number of modulus 1, for real objects 1 or -1.
    """

    flipped: bool
    shift: tuple[int, ...]
    turn: complex | float

    def apply(self, x: np.ndarray) -> np.ndarray:
        """`x` (..., *shape) transformed; `shift` says how many axes the object has."""
        axes = tuple(range(-len(self.shift), 0))
        x = np.conj(np.flip(x, axes)) if self.flipped else x
        return np.roll(x, self.shift, axes) * np.asarray(self.turn, x.dtype)


def symmetries_of(likelihood: Likelihood, complex_valued: bool) -> tuple[str, ...]:
    """What a recording leaves open of an object: the symmetries of the optics, by name.

    None where the camera records the field itself. The sign of a real object is left out: the prior
    tells it, by its mean.
    """
    if likelihood.linear:
        return ()
    return tuple(s for s in likelihood.optics.symmetries if complex_valued or s != GLOBAL_PHASE)


def gauge_to(x: np.ndarray, reference: np.ndarray, symmetries: Sequence[str] | Likelihood) -> Gauge:
    """The transformation that brings the object `x` nearest, in mean square, to `reference`.

    `symmetries`: which are allowed, among "global_phase" (the sign, for real objects),
    "conjugate_flip" and "circular_shift": those of `optics.symmetries` that the prior shares. Of a
    likelihood those of `symmetries_of`. Raises ValueError for other names, and objects of different
    shape or not finite.
    """
    x, reference = np.asarray(x), np.asarray(reference)
    names = _checked(x, x.shape, reference, symmetries)
    return _nearest(x, reference, names)


def align(
    values: np.ndarray,
    reference: np.ndarray | None = None,
    symmetries: Sequence[str] | Likelihood | None = None,
) -> np.ndarray:
    """Objects (..., *shape), each under the transformation that brings it nearest `reference`.

    `reference`: an object; None: `values` are draws (chains, draws, *shape), aligned with the mean
    of the draws once all are aligned with the first. `symmetries`: as of `gauge_to`, and always to
    be given: one that the optics do not have would move what the recording tells. Raises ValueError
    without them, for no draws, and as `gauge_to` does.
    """
    values = np.asarray(values)
    if symmetries is None:
        raise ValueError(
            "no symmetries: give the likelihood, or names of those that its optics have "
            "(likelihood.optics.symmetries)"
        )
    if not values.size or (reference is None and values.ndim < 3):
        raise ValueError(
            f"draws of shape {values.shape}: give (chains, draws, *shape), one or more"
        )
    if reference is None:
        values = align(values, values[0, 0], symmetries)
        reference = values.mean(axis=(0, 1))
    reference = np.asarray(reference)
    shape = values.shape[max(0, values.ndim - reference.ndim) :]
    names = _checked(values, shape, reference, symmetries)
    aligned = [_nearest(x, reference, names).apply(x) for x in values.reshape(-1, *shape)]
    return np.array(aligned, values.dtype).reshape(values.shape)


def _nearest(x: np.ndarray, reference: np.ndarray, symmetries: Sequence[str]) -> Gauge:
    flips = (False, True) if CONJUGATE_FLIP in symmetries else (False,)
    found = [_best_shift(np.conj(np.flip(x)) if f else x, reference, symmetries) for f in flips]
    # At a tie the object stays as it is.
    flipped = len(found) == 2 and found[1][0] > found[0][0]
    _, shift, turn = found[flipped]
    return Gauge(flipped, shift, turn)


def _best_shift(
    x: np.ndarray, reference: np.ndarray, symmetries: Sequence[str]
) -> tuple[float, tuple[int, ...], complex | float]:
    """Likeness, shift and turn of the largest overlap <x, reference>."""
    overlap = _overlaps(x, reference, CIRCULAR_SHIFT in symmetries)
    turns = GLOBAL_PHASE in symmetries
    likeness = np.abs(overlap) if turns else overlap.real
    best = np.unravel_index(np.argmax(likeness), overlap.shape)
    top = overlap[best]
    turn = top / np.abs(top) if turns and top != 0 else 1.0
    return float(likeness[best]), tuple(int(i) for i in best), turn


def _overlaps(x: np.ndarray, reference: np.ndarray, shifts: bool) -> np.ndarray:
    """<x shifted by s, reference> at index s; only s = 0 unless `shifts`. Real for a real `x`."""
    if shifts:
        overlap = np.fft.ifftn(np.fft.fftn(reference) * np.conj(np.fft.fftn(x)))
    else:
        overlap = np.vdot(x, reference).reshape((1,) * x.ndim)
    return overlap if np.iscomplexobj(x) else overlap.real


def _checked(
    values: np.ndarray,
    shape: tuple[int, ...],
    reference: np.ndarray,
    symmetries: Sequence[str] | Likelihood,
) -> Sequence[str]:
    """The symmetries' names, once objects of `shape` fit the reference and all is finite."""
    if shape != reference.shape:
        raise ValueError(
            f"objects of shape {shape}, reference of {reference.shape}: give one shape"
        )
    check_finite("objects", values)
    check_finite("reference", reference, "give one without them")
    if isinstance(symmetries, Likelihood):
        return symmetries_of(symmetries, np.iscomplexobj(values))
    for name in symmetries:
        if name not in SYMMETRIES:
            raise ValueError(f"unknown symmetry {name!r}: use {', '.join(SYMMETRIES)}")
    return symmetries
