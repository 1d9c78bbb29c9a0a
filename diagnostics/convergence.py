"""Convergence of chains: R-hat, effective sample size and Monte-Carlo error (Vehtari et al. 2021).

Every function takes draws (chains, draws, *shape), real, and returns an array of `shape`: nan where
draws do not vary, for nothing can be said there. All pixels are done at once, some thousand at a
time, so that memory beyond the draws is bounded. Raises ValueError for draws that are complex, not
finite, too few, or the same everywhere.

The array functions of arviz-stats are computed anew here on purpose: they go pixel by pixel, these
over maps, more than five times as fast on 4 chains of 1000 draws and more than that on fewer; they
are equal to rounding, and the tests hold them together.
"""

from collections.abc import Callable

import numpy as np
import scipy.fft
from scipy.special import ndtri

from .checks import check_finite

_PART = 2**16  # numbers of a part: they stay in the processor's cache
_PARTS = 4  # parts fetched together


def rhat(values: np.ndarray) -> np.ndarray:
    """Rank-normalised split R-hat, the larger of bulk and tail; of two chains or more."""
    if np.shape(values)[0] < 2:
        raise ValueError("draws of one chain: R-hat compares chains, give 2 or more")
    return _by_parts(_rhat, values)


def ess(values: np.ndarray, method: str = "bulk") -> np.ndarray:
    """Effective sample size; `method` "bulk", "tail", "mean" or "sd"."""
    if method not in _PREPARED:
        raise ValueError(f"unknown method {method!r}: use {', '.join(_PREPARED)}")
    prepared = _PREPARED[method]
    return _by_parts(lambda x: np.min([_ess(part) for part in prepared(x)], axis=0), values)


def mcse(values: np.ndarray, method: str = "mean") -> np.ndarray:
    """Monte-Carlo standard error of the mean or the sd; `method` "mean" or "sd"."""
    if method not in _ERRORS:
        raise ValueError(f"unknown method {method!r}: use {', '.join(_ERRORS)}")
    return _by_parts(_ERRORS[method], values)


def nested_rhat(values: np.ndarray, superchains: int) -> np.ndarray:
    """R-hat of many short chains, in groups that share a start (Margossian et al. 2024).

    `values` (chains, draws, *shape), one draw a chain or more; the first chains / superchains of
    them are the first superchain, and so on. How far superchains differ, over how much draws vary
    within them: with M independent draws in each about sqrt(1 + 1/M), and that, not 1, is what to
    compare it with. Rank-normalised, the larger of bulk and tail, as `rhat`; chains of four draws
    or more are split.
    Raises ValueError as the others here, for fewer than two superchains, chains that do not fill
    them, and superchains of one chain of one draw, within which nothing varies.
    """
    chains, draws = (*np.shape(values), 1, 1)[:2]
    if int(superchains) != superchains or superchains < 2:
        raise ValueError(f"{superchains} superchains: R-hat compares them, give 2 or more")
    if chains % superchains:
        raise ValueError(
            f"{chains} chains in {superchains} superchains: give as many chains in each, "
            "one superchain after the other"
        )
    if chains * draws == superchains:
        raise ValueError(
            "superchains of one chain of one draw do not vary within: give more chains in each, "
            "or more draws"
        )
    return _by_parts(lambda x: _nested_rhat(x, int(superchains)), values, fewest=1)


def _rhat(x: np.ndarray) -> np.ndarray:
    return _of_bulk_and_tail(_ratio, _split(x))


def _nested_rhat(x: np.ndarray, superchains: int) -> np.ndarray:
    x = _split(x) if x.shape[2] >= 4 else x
    return _of_bulk_and_tail(lambda x: _nested_ratio(x, superchains), x)


def _of_bulk_and_tail(ratio: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """The larger `ratio` of the rank-normalised draws and of their distances to the median."""
    folded = np.abs(x - _median(x))
    return np.fmax(ratio(_normal_scores(x)), ratio(_normal_scores(folded)))


def _median(x: np.ndarray) -> np.ndarray:
    """By a sort, which is twice as fast as NumPy's partition here."""
    ordered = np.sort(x.reshape(len(x), -1), axis=1)
    size = ordered.shape[1]
    return ordered[:, (size - 1) // 2 : size // 2 + 1].mean(axis=1)[:, None, None]


def _ratio(x: np.ndarray) -> np.ndarray:
    """R-hat of (pixels, chains, draws)."""
    length = x.shape[2]
    between, within = x.mean(axis=2).var(axis=1, ddof=1), x.var(axis=2, ddof=1).mean(axis=1)
    # Chains that stand still, each elsewhere, are infinitely far from agreement.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sqrt(between / within + (length - 1) / length)


def _nested_ratio(x: np.ndarray, superchains: int) -> np.ndarray:
    """Nested R-hat of (pixels, chains, draws): their equations 6 to 8."""
    means = x.mean(axis=2).reshape(len(x), superchains, -1)
    # Of a single draw, or a single chain, there is no variance to add.
    within = x.var(axis=2, ddof=1).mean(axis=1) if x.shape[2] > 1 else np.zeros(len(x))
    if means.shape[2] > 1:
        within = within + means.var(axis=2, ddof=1).mean(axis=1)
    between = means.mean(axis=2).var(axis=1, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sqrt(1 + between / within)


def _ess(x: np.ndarray) -> np.ndarray:
    """By Geyer's initial monotone sequence, of (pixels, chains, draws)."""
    length = x.shape[2]
    # Of most chains the sequence ends early, and fewer lags are made in half the time.
    found, ended = _geyer(x, max(length // 8, min(length, 64)))
    if not ended.all():
        found[~ended] = _geyer(x[~ended], length)[0]
    return found


def _geyer(x: np.ndarray, lags: int) -> tuple[np.ndarray, np.ndarray]:
    """Effective sizes by the first `lags` autocovariances, and for which pixels these suffice."""
    _, chains, length = x.shape
    means = x.mean(axis=2)
    covariance = _autocovariance(x, means, lags)
    within, total = covariance[:, 0] * length / (length - 1), covariance[:, 0]
    if chains > 1:
        total = total + means.var(axis=1, ddof=1)
    varies = total > 0
    rho = 1 - (within[:, None] - covariance) / np.where(varies, total, 1.0)[:, None]
    rho[:, 0] = 1.0
    last = max(-(-(min(lags + 1, length) - 2) // 2) - 1, 0)
    pairs = rho[:, 0 : 2 * last + 1 : 2] + rho[:, 1 : 2 * last + 2 : 2]
    ended = np.any(pairs <= 0, axis=1)
    count = np.where(ended, np.argmax(pairs <= 0, axis=1), last)
    kept = np.arange(pairs.shape[1]) < count[:, None]
    monotone = np.where(kept, np.minimum.accumulate(pairs, axis=1), 0.0).sum(axis=1)
    rest = np.take_along_axis(rho, 2 * count[:, None], axis=1)[:, 0]
    tau = -1 + 2 * monotone + np.where(ended, np.maximum(rest, 0.0), rest)
    # More draws than there are, where they alternate; not more than so many times.
    size = chains * length
    found = np.where(varies, size / np.maximum(tau, 1 / np.log10(size)), size)
    return found, ended | ~varies | (lags == length)


def _autocovariance(x: np.ndarray, means: np.ndarray, lags: int) -> np.ndarray:
    """Of draws, divided by their number at every lag, and averaged over chains."""
    pixels, chains, length = x.shape
    # As many zeros as lags: what wraps around does not reach them.
    size = scipy.fft.next_fast_len(length + lags, real=True)
    padded = np.zeros((pixels, chains, size))
    np.subtract(x, means[:, :, None], out=padded[:, :, :length])
    # Real and imaginary parts in turn, summed over chains without an array of squares.
    parts = scipy.fft.rfft(padded).view(float)
    squares = np.einsum("pck,pck->pk", parts, parts)
    power = squares[:, ::2] + squares[:, 1::2]
    return scipy.fft.irfft(power, size)[:, :lags] / (chains * length)


def _normal_scores(x: np.ndarray) -> np.ndarray:
    """Ranks among all draws of a pixel as quantiles of the normal distribution (Blom 1958).

    As by SciPy's `rankdata`, which takes seven times as long as the sort it makes.
    """
    flat = x.reshape(len(x), -1)
    size = flat.shape[1]
    untied = _blom(np.arange(1, size + 1), size)
    scores = np.empty_like(flat)
    # A pixel at a time: it stays in the nearest cache.
    for values, its_scores in zip(flat, scores):
        order = np.argsort(values)
        its_scores[order] = untied
        ordered = values[order]
        same = ordered[1:] == ordered[:-1]
        if same.any():
            tied, rank = _tied(same)
            its_scores[order[tied]] = _blom(rank, size)
    return scores.reshape(x.shape)


def _blom(rank: np.ndarray, size: int) -> np.ndarray:
    return ndtri((rank - 3 / 8) / (size + 1 / 4))


def _tied(same: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of the values in order that have an equal, and their mean rank.

    `same`: whether each of them is the next.
    """
    padded = np.concatenate([[False], same, [False]])
    before, after = padded[:-1], padded[1:]
    first, last = np.flatnonzero(after & ~before), np.flatnonzero(before & ~after)
    return np.flatnonzero(before | after), np.repeat((first + last) / 2 + 1, last - first + 1)


def _split(x: np.ndarray) -> np.ndarray:
    """Each chain as two, one after the other; of an odd number the draw between is left out."""
    half, odd = divmod(x.shape[2], 2)
    return (np.delete(x, half, axis=2) if odd else x).reshape(len(x), -1, half)


def _tails(x: np.ndarray) -> list[np.ndarray]:
    """Which draws are below the 5 % and the 95 % quantile."""
    ordered = np.sort(x.reshape(len(x), -1), axis=1)
    # A quantile lies between two draws or on the lower: only that one is needed.
    places = (np.array([0.05, 0.95]) * (ordered.shape[1] - 1)).astype(int)
    return [_split((x <= ordered[:, place, None, None]).astype(float)) for place in places]


def _squares(x: np.ndarray) -> np.ndarray:
    return (x - x.mean(axis=(1, 2), keepdims=True)) ** 2


_PREPARED: dict[str, Callable[[np.ndarray], list[np.ndarray]]] = {
    "bulk": lambda x: [_normal_scores(_split(x))],
    "tail": _tails,
    "mean": lambda x: [_split(x)],
    "sd": lambda x: [_split(_squares(x))],
}


def _error_of_mean(x: np.ndarray) -> np.ndarray:
    flat = x.reshape(len(x), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    variance = np.einsum("pt,pt->p", flat, flat) / (flat.shape[1] - 1)
    return np.sqrt(variance / _ess(_split(x)))


def _error_of_sd(x: np.ndarray) -> np.ndarray:
    squares = _squares(x).reshape(len(x), -1)
    variance = squares.mean(axis=1)
    fourth = np.einsum("pt,pt->p", squares, squares) / squares.shape[1]
    # Of two values as often each the squares are all the same, but for rounding.
    return np.sqrt(np.maximum(fourth - variance**2, 0) / _ess(_split(x)) / variance) / 2


_ERRORS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "mean": _error_of_mean,
    "sd": _error_of_sd,
}


def _by_parts(
    statistic: Callable[[np.ndarray], np.ndarray], values: np.ndarray, fewest: int = 4
) -> np.ndarray:
    """`statistic` of (pixels, chains, draws), over all pixels that vary."""
    values = _checked(values, fewest)
    chains, draws, *shape = values.shape
    flat = values.reshape(chains * draws, -1)
    found = np.full(flat.shape[1], np.nan)
    size = max(1, _PART // len(flat))
    for start in range(0, len(found), _PARTS * size):
        # Draws of one pixel lie far apart: some parts are fetched together, close to each other.
        near = flat[:, start : start + _PARTS * size].copy()
        for first in range(0, near.shape[1], size):
            x = near[:, first : first + size].T.astype(float, order="C")
            varies = x.max(axis=1) > x.min(axis=1)
            if varies.any():
                x = (x if varies.all() else x[varies]).reshape(-1, chains, draws)
                part = found[start + first : start + first + size]
                part[varies] = statistic(x)
    if np.isnan(found).all():
        raise ValueError("draws do not vary: the chains have not moved")
    return found.reshape(shape)[()]


def _checked(values: np.ndarray, fewest: int) -> np.ndarray:
    values = np.asarray(values)
    if np.iscomplexobj(values):
        raise ValueError("complex draws: give .real, .imag or abs() of them, one at a time")
    if values.ndim < 2 or values.shape[1] < fewest:
        raise ValueError(
            f"draws of shape {values.shape}: give (chains, draws, ...), {fewest} draws or more"
        )
    # A sum is not finite where a draw is not: one pass, and no array of answers as large.
    with np.errstate(over="ignore", invalid="ignore"):
        total = values.sum()
    if not np.isfinite(total):
        check_finite("draws", values)
    return values
