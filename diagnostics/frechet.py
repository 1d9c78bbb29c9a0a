"""Do pictures of answers look like those of truths? A Frechet distance beside its own null."""

from typing import NamedTuple

import numpy as np

from .distance import rank_p
from .features import HAAR, Features, check_pictures
from .fidelity import frechet_of_moments


class Frechet(NamedTuple):
    """A distance, what exchangeable pictures would have had in its place, and its p-value."""

    value: float
    floor: float
    floor_sd: float
    p: float


class _Moments(NamedTuple):
    """Samples, their sum (d,) and the sum of their products (d, d), of a picture or several."""

    count: np.ndarray
    sum: np.ndarray
    products: np.ndarray


def frechet_from_truths(
    truths: np.ndarray,
    draws: np.ndarray,
    rng: np.random.Generator,
    features: Features = HAAR,
    relabellings: int = 99,
) -> Frechet:
    """Squared Frechet distance of all `draws` (n, L, h, w[, 3]) from their `truths` (n, h, w[, 3]).

    Of `features`, each divided by its sd over the truths' samples: without unit, and comparable
    between sets of draws of the same truths. Never to be called FID, which is of Inception's.

    Few pictures are far from each other whatever made them. The null here is that of a posterior:
    given a recording, its truth and its exact draws are exchangeable. `floor`, `floor_sd` and `p`
    are of `relabellings` in which one image of each recording, at random, is called its truth; the
    p-value is exact at every size, in steps of 1 / (relabellings + 1), and small for estimates
    (L = 1) that are smoother than pictures. The floor is that of the set of draws at hand: a
    distance below another's is nearer, whatever their floors.

    What it cannot see: which draw is of which recording (handed to the wrong ones they have the
    same distance, and draws of the prior one as small as other pictures have); anything but means
    and covariances of the features; structure larger than a sample of theirs; whether intervals are
    true. Samples of one picture are not independent: the pictures are the unit of the null.

    Raises ValueError for shapes that do not fit, fewer than 2 pictures and 19 relabellings, for
    truths of one value everywhere, and pictures that are complex or not finite.
    """
    truths, draws = np.asarray(truths), np.asarray(draws)
    if len(truths) < 2 or draws.ndim < 3 or draws.shape[:1] + draws.shape[2:] != truths.shape:
        raise ValueError(
            f"draws of shape {draws.shape} for truths of {truths.shape}: give (n, draws, *shape) "
            "and (n, *shape), 2 pictures or more"
        )
    if relabellings < 19:
        raise ValueError(f"{relabellings} relabellings: give 19 or more, fewer never reach 5 %")
    check_pictures(draws)
    _check_truths(truths)
    both = np.concatenate([truths[:, None], draws], axis=1)
    n, size = both.shape[:2]
    found = _moments(features.of(both.reshape(n * size, *truths.shape[1:])))
    moments = _Moments(*(part.reshape(n, size, *part.shape[1:]) for part in found))
    value = _apart(moments, np.zeros(n, int))
    null = np.array([_apart(moments, rng.integers(size, size=n)) for _ in range(relabellings)])
    p = rank_p(value, null, rng)
    return Frechet(value, float(null.mean()), float(null.std(ddof=1)), p)


def frechet_of_halves(
    truths: np.ndarray, rng: np.random.Generator, features: Features = HAAR, repeats: int = 20
) -> float:
    """The same distance between two halves of `truths` (n, h, w[, 3]): of different pictures.

    The mean of `repeats` divisions at random. What n / 2 pictures have from n / 2 others, with
    nothing wrong. Raises ValueError for fewer than 2 or fewer than 1 of `repeats`, truths of one
    value everywhere, and pictures that are complex or not finite.
    """
    truths = np.asarray(truths)
    if len(truths) < 2:
        raise ValueError(f"{len(truths)} pictures have no halves: give 2 or more")
    if repeats < 1:
        raise ValueError(f"{repeats} repeats: give 1 or more")
    _check_truths(truths)
    moments, half, apart = _moments(features.of(truths)), len(truths) // 2, []
    scale = _scale(_pooled(moments))
    for _ in range(repeats):
        order = rng.permutation(len(truths))
        parts = (order[:half], order[half : 2 * half])
        apart.append(
            _distance(*(_pooled(_Moments(*(m[i] for m in moments))) for i in parts), scale)
        )
    return float(np.mean(apart))


def _check_truths(truths: np.ndarray) -> None:
    check_pictures(truths)
    if np.all(truths == truths.flat[0]):
        raise ValueError(
            f"the {len(truths)} truths are {truths.flat[0]:g} everywhere: their features have no "
            "sd to measure a distance by, give pictures"
        )


def _moments(features: np.ndarray) -> _Moments:
    """Of each picture, from (n, samples, d)."""
    n, samples, _ = features.shape
    products = np.einsum("nsi,nsj->nij", features, features, optimize=True)
    return _Moments(np.full(n, samples), features.sum(axis=1), products)


def _apart(moments: _Moments, chosen: np.ndarray) -> float:
    """Distance of the images called truths, one a recording, from all others."""
    rows = np.arange(len(chosen))
    called = _Moments(*(part[rows, chosen].sum(axis=0) for part in moments))
    rest = _Moments(*(part.sum(axis=(0, 1)) - one for part, one in zip(moments, called)))
    return _distance(called, rest, _scale(called))


def _pooled(moments: _Moments) -> _Moments:
    return _Moments(*(part.sum(axis=0) for part in moments))


def _scale(moments: _Moments) -> np.ndarray:
    # A feature that does not vary over the truths may over the draws.
    sd = np.sqrt(np.diag(_normal(moments)[1]))
    return np.where(sd > 0, sd, 1.0)


def _distance(a: _Moments, b: _Moments, scale: np.ndarray) -> float:
    moments = (_normal(m) for m in (a, b))
    scaled = ((mean / scale, covariance / np.outer(scale, scale)) for mean, covariance in moments)
    return frechet_of_moments(*next(scaled), *next(scaled))


def _normal(moments: _Moments) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance."""
    mean = moments.sum / moments.count
    rest = moments.products - moments.count * np.outer(mean, mean)
    return mean, rest / (moments.count - 1)
