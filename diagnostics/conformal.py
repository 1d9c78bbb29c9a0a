"""Intervals widened until they hold on pictures whose truth is known, with a guarantee."""

import itertools
from typing import NamedTuple

import numpy as np

from .checks import check_beside, check_level
from .spread import ends_at_ranks, interval


class Repair(NamedTuple):
    """Factor by which to widen the central `level` intervals about the median, and its guarantee.

    With probability `confidence` over the `images` that it was found on, on average at most `miss`
    of the pixels of new images lie outside. `before` and `after`: shares outside on those images.
    """

    factor: float
    level: float
    miss: float
    confidence: float
    images: int
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"intervals {self.factor:.3g} times as wide: with {self.confidence:.0%} confidence at "
            f"most {self.miss:.0%} of the pixels of images like these {self.images} lie outside, "
            f"on average ({self.before:.1%} of these did, {self.after:.1%} do now)"
        )


def repair_intervals(
    draws: np.ndarray, truths: np.ndarray, level: float = 0.9, confidence: float = 0.9
) -> Repair:
    """The smallest widening of the central `level` intervals that controls their misses.

    `draws` (n, L, *shape) of n posteriors and their `truths` (n, *shape), real. Risk-controlling
    prediction sets (Bates et al. 2021; for images Angelopoulos et al. 2022): the share of pixels
    outside, image by image, has an upper confidence bound that follows its variance, and the factor
    is about the least for which the bound is below 1 - `level`. It holds for
    images exchangeable with these: of the same specimens, prior, optics and exposure. Pixels are
    repaired on average, not each; draws are not repaired.
    Raises ValueError for too few images (none outside would not be enough), fewer draws than
    `interval` takes, draws and truths that do not fit or are not finite, and pixels without spread.
    """
    check_level(level)
    check_level(confidence, "confidence")
    draws, truths = np.asarray(draws), np.asarray(truths)
    check_beside(truths, draws)
    n, miss = len(truths), 1 - level
    if not _controlled(np.zeros(n), miss, confidence):
        sizes = itertools.count(n + 1)
        needed = next(m for m in sizes if _controlled(np.zeros(m), miss, confidence))
        raise ValueError(
            f"{n} images cannot tell that {100 * miss:g} % or less lie outside, with "
            f"{100 * confidence:g} % confidence: give {needed} or more"
        )
    needed = _needed_factors(draws, truths, level)
    candidates = np.unique(needed)
    # Shares outside fall as the factor grows, and with them, nearly always, goes the bet: the
    # factor found by halving is safe, and about the least.
    low, high = 0, len(candidates) - 1
    while low < high:
        middle = (low + high) // 2
        if _controlled((needed > candidates[middle]).mean(axis=1), miss, confidence):
            high = middle
        else:
            low = middle + 1
    factor = float(candidates[low])
    before, after = ((needed > f).mean() for f in (1.0, factor))
    return Repair(factor, level, miss, confidence, n, float(before), float(after))


def widened(values: np.ndarray, repair: Repair) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the repaired intervals of draws (chains, draws, *shape), in the draws' unit.

    Raises ValueError as `interval` does.
    """
    low, high = interval(values, repair.level)
    middle = np.median(values, axis=(0, 1))
    return middle - repair.factor * (middle - low), middle + repair.factor * (high - middle)


def _needed_factors(draws: np.ndarray, truths: np.ndarray, level: float) -> np.ndarray:
    """By what the interval of each pixel must be widened to hold its truth, (n, pixels)."""
    low, high = ends_at_ranks(draws, level, axis=1)
    middle = np.median(draws, axis=1)
    side = np.where(truths > middle, high - middle, middle - low)
    off = np.abs(truths - middle)
    if np.any((side == 0) & (off > 0)):
        raise ValueError("draws do not vary in some pixels: no factor widens an interval of 0")
    return np.where(off > 0, off / np.where(side > 0, side, 1.0), 0.0).reshape(len(truths), -1)


def _controlled(outside: np.ndarray, miss: float, confidence: float) -> bool:
    """Whether the mean of numbers from 0 to 1 (n,) is below `miss`, with this confidence.

    A bet against the mean being `miss`, whose stakes follow the variance so far: whoever wins more
    than 1/(1 - confidence) times his capital was right so often (Waudby-Smith and Ramdas 2024).
    """
    n, count = len(outside), np.arange(1, len(outside) + 1)
    mean = (0.5 + np.cumsum(outside)) / (1 + count)
    variance = (0.25 + np.cumsum((outside - mean) ** 2)) / (1 + count)
    known = np.concatenate([[0.25], variance[:-1]])
    stake = np.minimum(1.0, np.sqrt(2 * np.log(1 / (1 - confidence)) / (n * known)))
    capital = np.cumsum(np.log1p(-stake * (outside - miss)))
    return bool(capital.max() >= np.log(1 / (1 - confidence)))
