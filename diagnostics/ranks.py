"""Where a truth stands among draws: a number that is uniform if both are of one distribution."""

import numpy as np

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
    `draws`: which of them count. Raises ValueError for shapes that do not fit, complex values, NaN,
    and no draws.
    """
    truths, draws = np.asarray(truths), np.asarray(draws)
    check_beside(truths, draws)
    kept = np.ones(draws.shape, bool) if kept is None else kept
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
    """
    runs, chains, draws = values.shape[:3]
    # Draws that never move are one draw.
    moves = np.ptp(values) > 0
    effective = ess(np.moveaxis(values, 0, 2)) if moves else np.ones((runs, *values.shape[3:]))
    apart = np.ceil(2 * chains * draws / np.nan_to_num(effective, nan=1.0))
    order = np.arange(draws).reshape(-1, *(1,) * (values.ndim - 3))
    chosen = order[None] % np.minimum(apart, draws)[:, None] == 0
    return np.broadcast_to(chosen[:, None], values.shape)


def check_beside(truths: np.ndarray, draws: np.ndarray) -> None:
    """Refuse draws (n, L, ...) and truths (n, ...) that do not fit, are complex or not finite."""
    if np.iscomplexobj(truths) or np.iscomplexobj(draws):
        raise ValueError("complex values have no ranks: give abs(), .real or .imag of them")
    if draws.ndim < 2 or draws.shape[:1] + draws.shape[2:] != truths.shape:
        raise ValueError(
            f"draws of shape {draws.shape} for truths of {truths.shape}: give (n, draws, ...) and "
            "(n, ...)"
        )
    for name, array in (("truths", truths), ("draws", draws)):
        if not np.all(np.isfinite(array)):
            raise ValueError(f"{name} hold NaN or infinity: the run has diverged")
