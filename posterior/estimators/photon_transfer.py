"""Gain and offset of a camera from repeated captures of one scene: the photon transfer curve.

Photon noise has variance gain x (mean - offset), both in grey levels. Pixels are gathered into
bins of like brightness, and each pair of captures gives a point of that line for every bin.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

# Enough tiles for an error of 20 %, and each still holds all brightnesses of the scene.
_TILES = 16
_CLIPPED = 1e-3


class PhotonTransfer(NamedTuple):
    """Grey levels a photon, grey level of darkness, and their standard errors."""

    gain: float
    offset: float
    gain_error: float
    offset_error: float


def photon_transfer(
    captures: np.ndarray, saturation: float = np.inf, bins: int = 24
) -> PhotonTransfer:
    """From `captures` (n, h, w), n >= 3, of one still scene; grey levels, integer or float.

    A bin's noise is its variance over pixels less its scene's, which the covariance of two captures
    tells; a light that was brighter in one of them is allowed for. Bins are by the mean of the
    captures that are not of the pair, so that no pixel's own noise decides where it is counted.
    Integers are taken as rounded (1/12 is subtracted), and bins with more than one value in 1000 at
    `saturation` or above are left out. Errors are by a jackknife over 16 tiles.

    Approximations: read noise is part of the offset, which is too low by read variance / gain; and
    rounding is taken as independent of the count, which it is not where a photon is a few whole
    grey levels and counts are few (0.5 % of the gain at 6.4 levels a photon and 1 to 12 photons).
    Raises ValueError for another shape, values that are not finite, and captures whose variance
    does not grow with the light. Reference: Janesick, Photon Transfer, 2007.
    """
    captures = np.asarray(captures)
    if captures.ndim != 3 or len(captures) < 3:
        raise ValueError(f"captures of shape {captures.shape}: give (n, h, w) with n >= 3")
    if min(captures.shape[1:]) < _TILES or captures[0].size < _TILES * bins:
        raise ValueError(f"captures of {captures.shape[1:]} pixels: give at least 64 x 64")
    if not np.all(np.isfinite(captures)):
        raise ValueError("captures hold values that are not finite: leave out dead columns first")
    rounding = 1 / 12 if np.issubdtype(captures.dtype, np.integer) else 0.0
    tile = _tiles(captures.shape[1:]).ravel()
    flat = captures.reshape(len(captures), -1).astype(float)
    whole = _line(flat, saturation, bins, rounding)
    left = np.array([_line(flat[:, tile != k], saturation, bins, rounding) for k in range(_TILES)])
    errors = np.sqrt((_TILES - 1) * np.mean((left - left.mean(axis=0)) ** 2, axis=0))
    return PhotonTransfer(*whole, *map(float, errors))


def _tiles(shape: tuple[int, ...]) -> np.ndarray:
    """Which of 4 x 4 tiles each pixel lies in."""
    rows, columns = (np.arange(n) * 4 // n for n in shape)
    return 4 * rows[:, None] + columns


def _line(
    captures: np.ndarray, saturation: float, bins: int, rounding: float
) -> tuple[float, float]:
    """Gain and offset of captures (n, pixels)."""
    points = np.concatenate(
        [
            _points(captures, pair, saturation, bins)
            for pair in combinations(range(len(captures)), 2)
        ]
    )
    if len(points) < 2:
        raise ValueError(f"captures are saturated at {saturation} nearly everywhere: expose less")
    mean, variance = points[:, 0], points[:, 1] - rounding
    # A variance is known to a share of itself: weigh with the line's, not with its own noise.
    weight = np.ones(len(mean))
    for _ in range(5):
        slope, level = np.polyfit(mean, variance, 1, w=weight)
        weight = 1 / np.maximum(slope * mean + level, 1e-3 * variance.max())
    if not slope > 0:
        raise ValueError(
            "the variance of the captures does not grow with their light: they are not photon "
            "counts of one still scene"
        )
    return float(slope), float(-level / slope)


def _points(
    captures: np.ndarray, pair: tuple[int, int], saturation: float, bins: int
) -> np.ndarray:
    """(mean, variance) of each bin that is not clipped."""
    one, other = captures[list(pair)]
    rest = np.delete(captures, pair, axis=0).mean(axis=0)
    order = np.argsort(rest, kind="stable")
    # Noises of captures are independent: what each shares with the rest is its light.
    ratio = np.cov(one, rest)[0, 1] / np.cov(other, rest)[0, 1]
    found = []
    for pixels in np.array_split(order, bins):
        a, b = one[pixels], other[pixels]
        if np.mean((a >= saturation) | (b >= saturation)) <= _CLIPPED:
            (var_a, shared), (_, var_b) = np.cov(a, b)
            noise = (var_a + var_b - (ratio + 1 / ratio) * shared) / 2
            found.append(((a + b).mean() / 2, noise))
    return np.array(found).reshape(-1, 2)
