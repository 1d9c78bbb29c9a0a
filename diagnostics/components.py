"""What is uncertain together: principal components of the draws, and two draws that differ.

Draws are (chains, draws, *shape), real or complex. Complex draws of intensity data must be in one
gauge (`align`): a phase that nothing fixes would be their first component.
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg

from .checks import check_draws_finite, check_level, check_varies

# Of the largest variance: below it the square root of a rounding error would speak.
_ROUNDING = 1e-12


class Components(NamedTuple):
    """Principal components of a posterior, the largest first.

    An object of it is mean + sum_k z_k patterns[k], where the z_k are uncorrelated and have sd
    `sd[k]`. `mean` has the object's shape; `patterns` (count, *shape) are orthogonal and their
    squares sum to 1 each, so that `sd[k] * patterns[k]` is a change of one sd in the object's unit.
    `share` (count,): of the variance of all pixels together. All in double precision.
    """

    mean: np.ndarray
    patterns: np.ndarray
    sd: np.ndarray
    share: np.ndarray


class Contrast(NamedTuple):
    """Two draws that differ as the posterior allows, and where.

    `first`, `second`: (chain, draw) of each. `difference`: second less first, over the posterior
    sd of the pixel; `along`: the part of it that lies along the first component. Both have the
    object's shape, are complex for complex draws, and nan where a pixel does not vary. `share`: of
    the squared distance of the two, what lies along the first component.
    """

    first: tuple[int, int]
    second: tuple[int, int]
    difference: np.ndarray
    along: np.ndarray
    share: float


def principal_components(values: np.ndarray, count: int = 4) -> Components:
    """The `count` directions in which draws vary most (Jolliffe 2002).

    By the thin singular value decomposition of the centred draws, from the eigenvectors of the
    smaller of their two products; memory is a copy of the draws in double precision. Of complex
    draws they are the eigenvectors of the complex covariance E[z z^H], each turned by the phase at
    which its z_k vary most along the real axis. The sign is that of the largest pixel, positive.

    The leading sd are biased upward where draws are few: those of n independent draws find
    the largest direction among p of equal sd a factor 1 + sqrt(p/n) too large (Marchenko and Pastur
    1967), and its pattern is then noise; believe an sd only well above what that factor makes of
    the rest. n counts independent draws (`ess`), not dependent ones.
    Raises ValueError for draws that are not finite, do not vary, or vary in fewer directions than
    `count`.
    """
    x, mean, shape = _centred(values)
    if int(count) != count or count < 1:
        raise ValueError(f"count {count}: give a whole number of components, 1 or more")
    variance, patterns = _eigenvectors(x, int(count))
    total = np.sum(np.abs(x) ** 2) / (len(x) - 1)
    return Components(
        mean.reshape(shape), patterns.reshape(-1, *shape), np.sqrt(variance), variance / total
    )


def contrast(values: np.ndarray, level: float = 0.9) -> Contrast:
    """What could also be true: two draws, and the place where they differ.

    The draws at the lower and the upper end of the central interval that holds `level` of all,
    along the first component. Each is a plausible picture, as any draw, and no number of draws
    makes them stranger, as it would the two that are furthest apart. In all other directions they
    differ by chance, which is most of `difference` where many pixels are uncertain by themselves;
    `along` is without that.
    Raises ValueError for a level outside (0, 1), and as `principal_components`.
    """
    check_level(level)
    x, _, shape = _centred(values)
    pattern = _eigenvectors(x, 1)[1][0]
    scores = (x @ pattern.conj()).real
    ends = np.quantile(scores, [(1 - level) / 2, (1 + level) / 2], method="nearest")
    one, other = (int(np.argmin(np.abs(scores - end))) for end in ends)
    if one == other:
        raise ValueError(
            f"{len(x)} draws: too few for two at the ends of {100 * level:g} % of them"
        )
    moved = x[other] - x[one]
    along = (scores[other] - scores[one]) * pattern
    sd = np.sqrt(np.sum(np.abs(x) ** 2, axis=0) / (len(x) - 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        difference, along_sd = (np.where(sd > 0, a / sd, np.nan) for a in (moved, along))
    share = float(np.sum(np.abs(along) ** 2) / np.sum(np.abs(moved) ** 2))
    first, second = (
        tuple(map(int, np.unravel_index(i, np.shape(values)[:2]))) for i in (one, other)
    )
    return Contrast(first, second, difference.reshape(shape), along_sd.reshape(shape), share)


def _centred(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """Draws less their mean (n, pixels), the mean, and the object's shape; in double precision."""
    values = np.asarray(values)
    if values.ndim < 3 or values.shape[0] * values.shape[1] < 2:
        raise ValueError(f"draws of shape {values.shape}: give (chains, draws, *shape), 2 or more")
    flat = values.reshape(values.shape[0] * values.shape[1], -1)
    check_draws_finite(flat)
    check_varies(flat, axis=0)
    x = flat.astype(complex if np.iscomplexobj(flat) else float)
    # A pixel that stands still is 0 exactly, whatever its mean rounds to.
    mean = np.where(np.ptp(x.real, axis=0) + np.ptp(x.imag, axis=0) > 0, x.mean(axis=0), x[0])
    x -= mean
    return x, mean, values.shape[2:]


def _eigenvectors(x: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The largest variances (count,) of centred draws (n, pixels), and unit patterns of them."""
    n, pixels = x.shape
    side = min(n, pixels)
    square = x @ x.conj().T if n <= pixels else x.T @ x.conj()
    found, vectors = scipy.linalg.eigh(square, subset_by_index=[max(side - count, 0), side - 1])
    found, vectors = found[::-1], vectors[:, ::-1]
    directions = int(np.sum(found > _ROUNDING * found[0]))
    if directions < count:
        raise ValueError(
            f"{count} components of draws that vary in {directions} directions: ask for "
            f"{directions} or fewer, or give more draws"
        )
    patterns = vectors.conj().T @ x / np.sqrt(found)[:, None] if n <= pixels else vectors.T
    patterns = patterns * _turn(x @ patterns.conj().T, patterns)[:, None]
    return found / (n - 1), patterns


def _turn(scores: np.ndarray, patterns: np.ndarray) -> np.ndarray:
    """The sign or phase (count,) of patterns (count, pixels) whose scores are (n, count)."""
    turn = np.ones(len(patterns), patterns.dtype)
    if np.iscomplexobj(patterns):
        turn = np.exp(0.5j * np.angle(np.mean(scores**2, axis=0)))
    largest = np.argmax(np.abs(patterns), axis=1)[:, None]
    at_largest = np.take_along_axis(patterns, largest, axis=1)[:, 0] * turn
    return np.where(at_largest.real < 0, -turn, turn)
