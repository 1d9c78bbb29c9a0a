"""Where a truth stands among draws: a number that is uniform if both are of one distribution."""

import numpy as np

from .checks import check_beside
from .convergence import ess


def randomised_ranks(
    truths: np.ndarray,
    draws: np.ndarray,
    rng: np.random.Generator,
    kept: np.ndarray | None = None,
) -> np.ndarray:
    """Ranks (k + U)/(L + 1) of `truths` (n, ...) among `draws` (n, L, ...), shaped as `truths`.

    k is the number of draws below the truth, ties broken at random, U uniform on (0, 1): exactly
    uniform on (0, 1) for independent draws of the truth's distribution, whatever L. Divided
    without U they are discrete, and a test for continuous numbers rejects them. `kept`, shaped as
    `draws`: which of them count. Raises ValueError for shapes that do not fit, complex values, ones
    that are not finite, and no draws.
    """
    truths, draws = np.asarray(truths), np.asarray(draws)
    check_beside(truths, draws)
    kept = np.ones(draws.shape, bool) if kept is None else np.asarray(kept)
    if kept.shape != draws.shape:
        raise ValueError(f"kept of shape {kept.shape}: give that of the draws, {draws.shape}")
    size = kept.sum(axis=1)
    if not np.all(size):
        raise ValueError("no draw is left to rank a truth among: keep one or more of each")
    below = ((draws < truths[:, None]) & kept).sum(axis=1)
    equal = ((draws == truths[:, None]) & kept).sum(axis=1)
    return (below + rng.random(truths.shape) * (equal + 1)) / (size + 1)


def thinned(values: np.ndarray) -> np.ndarray:
    """Which of the draws (n, chains, draws, ...) are about independent: a mask of that shape.

    Every t-th, t twice the number of draws over their effective number (Vehtari et al. 2021), for
    each of the n runs and each of its numbers. Neighbours that resemble each other crowd on one
    side of the truth, and ranks among them pile up at the ends of an exact sampler too (Talts et
    al. 2018): once that ratio apart they are still correlated by a seventh, twice by a fiftieth.
    Raises ValueError for fewer axes.
    """
    values = np.asarray(values)
    if values.ndim < 3:
        raise ValueError(f"draws of shape {values.shape}: give (n, chains, draws, ...)")
    runs, chains, draws = values.shape[:3]
    # Draws that never move are one draw.
    moves = np.ptp(values) > 0
    effective = ess(np.moveaxis(values, 0, 2)) if moves else np.ones((runs, *values.shape[3:]))
    apart = np.ceil(2 * chains * draws / np.nan_to_num(effective, nan=1.0))
    order = np.arange(draws).reshape(-1, *(1,) * (values.ndim - 3))
    chosen = order[None] % np.minimum(apart, draws)[:, None] == 0
    return np.broadcast_to(chosen[:, None], values.shape)
