"""How often truths lie inside intervals, with the image as the unit that is counted."""

from typing import NamedTuple

import numpy as np
import scipy.stats

from .checks import check_level
from .ranks import randomised_ranks


class Coverage(NamedTuple):
    """Share of pixels inside their intervals: on average over n images, and its standard error.

    `p`: of the hypothesis that the share is `level` (Student's t over the images).
    """

    share: float
    error: float
    level: float
    p: float


def coverage(
    draws: np.ndarray, truths: np.ndarray, level: float, rng: np.random.Generator
) -> Coverage:
    """Of the central interval that holds `level` of the draws.

    `draws` (n, L, ...) of n posteriors and their `truths` (n, ...): pixels, means of regions, or
    one number each. A truth is inside by its randomised rank, which is exact for every L; intervals
    between quantiles of a few draws hold less than they say. Pixels of one image share its noise
    and its prior, so that n is the number of images, and never of pixels. Raises ValueError as
    `randomised_ranks` does, for fewer than 2 images and levels outside (0, 1).
    """
    check_level(level)
    if len(truths) < 2:
        raise ValueError("one image: how far its pixels are covered says nothing of others, give 2")
    u = randomised_ranks(truths, draws, rng).reshape(len(truths), -1)
    inside = (np.abs(u - 0.5) < level / 2).mean(axis=1)
    # At least the error of so many independent pixels: images may all agree by chance.
    independent = np.sqrt(level * (1 - level) / u.shape[1])
    error = max(inside.std(ddof=1), independent) / np.sqrt(len(inside))
    t = abs(inside.mean() - level) / error
    p = 2 * scipy.stats.t(len(inside) - 1).sf(t)
    return Coverage(float(inside.mean()), float(error), level, float(p))
