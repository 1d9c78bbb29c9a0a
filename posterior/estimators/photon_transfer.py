"""Gain and offset of a camera from repeated captures of one scene: the photon transfer curve.

Photon noise has variance gain x (mean - offset), both in grey levels. Pixels are gathered into
bins of like brightness, and each pair of captures gives a point of that line for every bin.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

# Enough tiles for an error of 20 %, and each still holds all brightnesses of the scene.
_TILES = 16
_LEAST_SIDE = 64
# Standard deviations from a bin's mean to saturation: with fewer, its noise is cut off.
_CLEAR = 4


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
    Integers are taken as rounded (1/12 is subtracted), and bins whose mean is within four standard
    deviations of `saturation` are left out. Errors are by a jackknife over 16 tiles.

    Approximations: read noise is part of the offset, which is too low by read variance / gain; and
    rounding is taken as independent of the count, which it is not where a photon is a few whole
    grey levels and counts are few (0.5 % of the gain at 6.4 levels a photon and 1 to 12 photons).
    Raises ValueError for another shape, values that are not finite, captures that do not differ or
    are saturated, and captures whose variance does not grow with the light. Reference: Janesick,
    Photon Transfer, 2007.
    """
    captures = np.asarray(captures)
    if captures.ndim != 3 or len(captures) < 3:
        raise ValueError(f"captures of shape {captures.shape}: give (n, h, w) with n >= 3")
    if min(captures.shape[1:]) < _LEAST_SIDE:
        raise ValueError(f"captures of {captures.shape[1:]} pixels: give at least 64 x 64")
    if not np.all(np.isfinite(captures)):
        raise ValueError("captures hold values that are not finite: leave out dead columns first")
    if np.all(captures == captures[0]):
        raise ValueError("captures do not differ: give captures of one scene below saturation")
    rounding = 1 / 12 if np.issubdtype(captures.dtype, np.integer) else 0.0
    tile = _tiles(captures.shape[1:]).ravel()
    flat = captures.reshape(len(captures), -1).astype(float)
    pairs = [_moments(flat, pair, tile, bins) for pair in combinations(range(len(captures)), 2)]
    limit = _limit(pairs, saturation)
    pairs = [_dimmer(tiles, limit) for tiles in pairs]
    # A pair tells how its light compares only where some brightnesses are left.
    pairs = [tiles for tiles in pairs if tiles.shape[1] > 1]
    if not pairs:
        raise ValueError("captures are saturated nearly everywhere: expose less")
    whole = _line([tiles.sum(axis=0) for tiles in pairs], rounding)
    left = np.array(
        [
            _line([np.delete(t, k, axis=0).sum(axis=0) for t in pairs], rounding)
            for k in range(_TILES)
        ]
    )
    errors = np.sqrt((_TILES - 1) * np.mean((left - left.mean(axis=0)) ** 2, axis=0))
    return PhotonTransfer(*whole, *map(float, errors))


def _tiles(shape: tuple[int, ...]) -> np.ndarray:
    """Which of 4 x 4 tiles each pixel lies in."""
    rows, columns = (np.arange(n) * 4 // n for n in shape)
    return 4 * rows[:, None] + columns


def _moments(
    captures: np.ndarray, pair: tuple[int, int], tile: np.ndarray, bins: int
) -> np.ndarray:
    """Sums (tiles, bins, 4, 4) over pixels of the products of (1, one, other, mean of the rest)."""
    one, other = captures[list(pair)]
    rest = np.delete(captures, pair, axis=0).mean(axis=0)
    place = np.empty(len(rest), int)
    place[np.argsort(rest, kind="stable")] = np.arange(len(rest)) * bins // len(rest)
    values = np.stack([np.ones_like(one), one, other, rest])
    cell = tile * bins + place
    products = [np.bincount(cell, a * b, minlength=_TILES * bins) for a in values for b in values]
    return np.stack(products, axis=-1).reshape(_TILES, bins, 4, 4)


def _limit(pairs: list[np.ndarray], saturation: float) -> float:
    """Grey level m with m + `_CLEAR` sd(m) = saturation.

    The sd is of a line through all bins below: one bin's own would keep the bins that came out
    quieter than they are.
    """
    if not np.isfinite(saturation):
        return np.inf
    mean, covariance = _covariance(np.concatenate([tiles.sum(axis=0) for tiles in pairs]))
    mean = mean[:, :2].ravel()
    variance = np.diagonal(covariance, axis1=1, axis2=2)[:, :2].ravel()
    limit = np.median(mean)
    for _ in range(10):
        below = mean <= limit
        if len(np.unique(mean[below])) < 2:
            break
        slope, level = np.polyfit(mean[below], variance[below], 1)
        # m + c sqrt(slope m + level) = saturation, solved for saturation - m.
        half = _CLEAR**2 * slope / 2
        square = half**2 + _CLEAR**2 * max(slope * saturation + level, 0)
        limit = saturation + half - np.sqrt(square)
    return limit


def _dimmer(tiles: np.ndarray, limit: float) -> np.ndarray:
    """The bins of `_moments` in which both captures of the pair have a mean up to `limit`."""
    mean, _ = _covariance(tiles.sum(axis=0))
    return tiles[:, np.all(mean[:, :2] <= limit, axis=1)]


def _line(pairs: list[np.ndarray], rounding: float) -> tuple[float, float]:
    """Gain and offset from the moments (bins, 4, 4) of each pair of captures."""
    points = np.concatenate([_points(moments) for moments in pairs], axis=1)
    mean, variance = points[0], points[1] - rounding
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


def _points(moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and noise variance of a pair of captures in each bin."""
    mean, covariance = _covariance(moments)
    _, whole = _covariance(moments.sum(axis=0))
    # Noises of captures are independent: what each shares with the rest is its light.
    ratio = whole[0, 2] / whole[1, 2]
    shared = (ratio + 1 / ratio) * covariance[:, 0, 1]
    noise = (covariance[:, 0, 0] + covariance[:, 1, 1] - shared) / 2
    return mean[:, :2].mean(axis=1), noise


def _covariance(moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (..., 3) and unbiased covariance (..., 3, 3) of what `_moments` sums."""
    count = moments[..., :1, :1]
    mean = moments[..., 0, 1:] / count[..., 0]
    square = moments[..., 1:, 1:] - count * mean[..., :, None] * mean[..., None, :]
    return mean, square / (count - 1)
