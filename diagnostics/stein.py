"""Kernel Stein discrepancy: how far draws are from a posterior of which only the score is known."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from .checks import check_draws_finite
from .distance import BLOCK, Distance, flat, median_distance, rank_p, squared_distances

Score = Callable[[jax.Array], jax.Array]


def ksd(
    draws: np.ndarray, score: Score, rng: np.random.Generator, bandwidth: float | None = None
) -> float:
    """Squared kernel Stein discrepancy of draws from a posterior, by its U-statistic.

    `draws` (n, *shape), real or complex; `score`: the gradient of the log-posterior of one object,
    shaped as it, d/dRe + j d/dIm if complex, such as `Posterior.score`. Of the inverse
    multiquadric kernel (1 + |x - y|^2 / h^2)^(-1/2) in the real view, which also sees draws that
    miss the posterior's tails (Gorham and Mackey 2017); in inverse squared units of the object.
    `bandwidth` h in units of the object; None: the median distance of the draws, over 500 of them
    picked by `rng` where there are more. Unbiased, hence 0 on average and often negative for exact
    draws, and in itself no small or large number: see `ksd_beside_floor`.

    It needs no exact draws, and it does not see all that they would. Of separated modes it sees
    neither a lost one nor a wrong mass, for the score is right in each. A wrong spread it sees late
    where the posterior is wide in some directions and narrow in others: the wide ones rule the
    kernel, the narrow ones the score. It sees more in whitened coordinates: with a root L of the
    covariance, draws L^-1 x and their score z -> L^T score(L z).
    Raises ValueError for draws or scores that are not finite, fewer than 2 draws, scores of another
    shape, and where the median distance is 0.
    """
    return _beside(draws, score, rng, bandwidth, 0)[0]


def ksd_beside_floor(
    draws: np.ndarray,
    score: Score,
    rng: np.random.Generator,
    bandwidth: float | None = None,
    bootstraps: int = 999,
) -> Distance:
    """`ksd`, and its noise floor and p-value by the wild bootstrap, without exact draws.

    The floor: the same sum with independent random signs of the draws, which has the distribution
    of the discrepancy of n exact draws for large n (Chwialkowski et al. 2016). The draws must be
    independent: those of a chain must be thinned to their effective number first (`ess`), or the
    p-value comes out too small. Arguments and errors as in `ksd`.
    """
    if bootstraps < 19:
        raise ValueError(f"{bootstraps} bootstraps: give 19 or more, fewer never reach 5 %")
    value, null = _beside(draws, score, rng, bandwidth, bootstraps)
    return Distance(value, float(null.mean()), float(null.std(ddof=1)), rank_p(value, null, rng))


def _beside(
    draws: np.ndarray,
    score: Score,
    rng: np.random.Generator,
    bandwidth: float | None,
    bootstraps: int,
) -> tuple[float, np.ndarray]:
    """The U-statistic, and `bootstraps` of it with random signs."""
    x, scores = flat(draws), _scores(draws, score)
    n = len(x)
    if n < 2:
        raise ValueError("1 draw: give 2 or more")
    if bandwidth is None:
        bandwidth = median_distance(x, rng)
    elif not bandwidth > 0:
        raise ValueError(f"bandwidth {bandwidth}: it must be above 0")
    # The first column is the statistic itself: all signs alike.
    signs = np.concatenate([np.ones((n, 1)), rng.choice([-1.0, 1.0], (n, bootstraps))], axis=1)
    total = np.zeros(1 + bootstraps)
    x = x - x.mean(axis=0)
    for i in range(0, n, BLOCK):
        rows = slice(i, i + BLOCK)
        pairs = _stein_kernel(x[rows], scores[rows], x, scores, bandwidth)
        # A draw and itself are no pair of independent draws.
        pairs[np.arange(len(pairs)), i + np.arange(len(pairs))] = 0.0
        total += np.sum(signs[rows] * (pairs @ signs), axis=0)
    total /= n * (n - 1)
    return float(total[0]), total[1:]


def _stein_kernel(
    x: np.ndarray, score_x: np.ndarray, y: np.ndarray, score_y: np.ndarray, bandwidth: float
) -> np.ndarray:
    """The Langevin Stein operator on both arguments of the kernel, for all pairs (m, n)."""
    square = squared_distances(x, y) / bandwidth**2
    base = 1 / (1 + square)
    root = np.sqrt(base)
    # (score_x - score_y) . (x - y), without an array of all differences.
    along = np.sum(score_x * x, axis=1)[:, None] + np.sum(score_y * y, axis=1)
    along = along - score_x @ y.T - x @ score_y.T
    second = x.shape[1] - 3 * square * base
    return root * (score_x @ score_y.T + base * (along + second) / bandwidth**2)


def _scores(draws: np.ndarray, score: Score) -> np.ndarray:
    """Real views (n, d) of the scores; block by block, for optics need room of their own."""
    draws = np.asarray(draws)
    blocks = [jnp.asarray(draws[i : i + BLOCK]) for i in range(0, len(draws), BLOCK)]
    found = np.concatenate([np.asarray(jax.vmap(score)(block)) for block in blocks])
    if found.shape != draws.shape or np.iscomplexobj(found) != np.iscomplexobj(draws):
        raise ValueError(
            f"scores of shape {found.shape}, {found.dtype}, of draws {draws.shape}, "
            f"{draws.dtype}: give the gradient of the log-posterior of one object, shaped as it"
        )
    nowhere = "the draws lie where there is no density, give those of a run that does not leave it"
    check_draws_finite(found, "scores", nowhere)
    return flat(found)
