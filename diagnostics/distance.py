"""Distance to a known posterior, printed beside the noise floor of two exact sets.

A distance is a function (a, b, rng) of two sets of draws (m, *shape) and (n, *shape), real or
complex. No two exact sets are at distance 0: read each of them by `beside_floor`.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.distance import pdist

from .checks import check_draws_finite

if TYPE_CHECKING:
    from sklearn.base import ClassifierMixin

TwoSample = Callable[[np.ndarray, np.ndarray, np.random.Generator], float]

# Rows of a matrix of all pairs that are held at once.
BLOCK = 512
# Draws that a median of distances is taken over: its own error then hardly moves a kernel.
_MEDIAN_OF = 500


class Distance(NamedTuple):
    """A distance, and what exact draws would have had in its place.

    `floor` and `floor_sd`: mean and standard deviation of the distances of exact sets of this size.
    `p`: probability that independent, exact draws come out as far or further.
    """

    value: float
    floor: float
    floor_sd: float
    p: float


def sliced_wasserstein(
    a: np.ndarray, b: np.ndarray, rng: np.random.Generator, projections: int = 200
) -> float:
    """Sliced 1-Wasserstein distance of two sets of draws, in units of the object.

    `a` (m, *shape), `b` (n, *shape), real or complex; the mean over random directions of the real
    view of the mean distance of quantiles (Bonneel et al. 2015). To be read in posterior standard
    deviations: divide by the root mean square sd of a component.
    Raises ValueError for draws that are not finite, or of different dimension, and for projections
    that are no whole number, 1 or more.
    """
    a, b = _pair(a, b)
    if int(projections) != projections or projections < 1:
        raise ValueError(f"projections {projections}: give a whole number, 1 or more")
    directions = rng.standard_normal((a.shape[1], int(projections)))
    directions /= np.linalg.norm(directions, axis=0)
    level = (np.arange(min(len(a), len(b))) + 0.5) / min(len(a), len(b))
    quantiles = [np.quantile(x @ directions, level, axis=0) for x in (a, b)]
    return float(np.mean(np.abs(quantiles[0] - quantiles[1])))


def mmd(
    a: np.ndarray, b: np.ndarray, rng: np.random.Generator, bandwidth: float | None = None
) -> float:
    """Squared maximum mean discrepancy of two sets of draws, without unit, by its U-statistic.

    `a` (m, *shape), `b` (n, *shape), real or complex. Unbiased, hence 0 on average and often
    negative for exact draws (Gretton et al. 2012, equation 3). Kernel exp(-|x - y|^2 / (2 h^2)) in
    the real view; `bandwidth` h in units of the object; None: the median distance of the draws of
    both sets together, over 500 of them picked by `rng` where there are more.
    It weighs large deviations of the whole object: components that vary much hide those that vary
    little, so divide the draws by their sd where these differ.
    Raises ValueError for draws that are not finite, of different dimension, or fewer than 2 a set,
    and where the median distance is 0.
    """
    a, b = _pair(a, b)
    if min(len(a), len(b)) < 2:
        raise ValueError(f"sets of {len(a)} and {len(b)} draws: give 2 or more of each")
    if bandwidth is None:
        bandwidth = median_distance(np.concatenate([a, b]), rng)
    elif not bandwidth > 0:
        raise ValueError(f"bandwidth {bandwidth}: it must be above 0")
    within = sum((_kernel_sum(x, x, bandwidth) - len(x)) / (len(x) * (len(x) - 1)) for x in (a, b))
    return within - 2 * _kernel_sum(a, b, bandwidth) / (len(a) * len(b))


def c2st(
    a: np.ndarray,
    b: np.ndarray,
    rng: np.random.Generator,
    folds: int = 5,
    classifier: "ClassifierMixin | None" = None,
) -> float:
    """How often a classifier tells draws of `a` from those of `b`: 0.5 is by chance, 1 always.

    `a`, `b` (n, *shape), as many of each, real or complex; `b` is the reference, whose mean and sd
    standardise both. Mean accuracy on folds that it was not trained on (Lopez-Paz and Oquab 2017).
    `classifier`: any of scikit-learn; None: a support vector machine with a Gaussian kernel, which
    sees means, spread and correlations. 0.5 is no proof: another classifier, or more draws, may see
    more.
    Raises ValueError for draws that are not finite, of different dimension, fewer than `folds`, or
    all the same, and for sets of different size.
    """
    # Imported here: who asks for no classifier does not wait for it.
    from sklearn.model_selection import StratifiedKFold, cross_val_score
    from sklearn.svm import SVC

    a, b = _pair(a, b)
    if len(a) != len(b):
        raise ValueError(
            f"sets of {len(a)} and {len(b)} draws: give as many of each, or a classifier that "
            "names the larger one looks as if it saw a difference"
        )
    if not 2 <= folds <= len(a):
        raise ValueError(f"{folds} folds of {len(a)} draws: give 2 or more, and as many draws")
    both = _standardised(np.concatenate([a, b]), b)
    labels = np.repeat([0, 1], len(a))
    parts = StratifiedKFold(folds, shuffle=True, random_state=int(rng.integers(2**31)))
    classifier = SVC() if classifier is None else classifier
    return float(cross_val_score(classifier, both, labels, cv=parts, scoring="accuracy").mean())


def noise_floor(
    reference: np.ndarray,
    size: int,
    rng: np.random.Generator,
    repeats: int = 8,
    distance: TwoSample = sliced_wasserstein,
) -> float:
    """Mean `distance` of two exact sets of `size` draws, split off `reference` (n, *shape).

    Raises ValueError for a reference of fewer than 2 `size` draws, or of draws that are all the
    same, a size below 1, fewer than 2 repeats, and as `distance` does.
    """
    return float(np.mean(_of_exact_sets(reference, size, rng, repeats, distance)))


def two_sample_p(
    a: np.ndarray,
    b: np.ndarray,
    rng: np.random.Generator,
    distance: TwoSample = sliced_wasserstein,
    permutations: int = 199,
) -> float:
    """p-value of the hypothesis that both sets of draws are of one distribution.

    `a` (m, *shape), `b` (n, *shape). By how many divisions of all draws into two sets of these
    sizes are as far apart. Exact at every size if the draws are independent, in steps of
    1 / (permutations + 1); equal distances are ordered at random. Chains must be thinned first.
    Raises ValueError for fewer than 19 permutations, and as `distance` does.
    """
    return _permuted(a, b, rng, distance, permutations)[1]


def beside_floor(
    draws: np.ndarray,
    reference: np.ndarray,
    rng: np.random.Generator,
    distance: TwoSample = sliced_wasserstein,
    repeats: int = 8,
    permutations: int = 199,
) -> Distance:
    """`distance` of `draws` (n, *shape) from as many of `reference`, and the noise floor beside it.

    `reference` (2 n or more, *shape): exact draws. The floor is that of `repeats` pairs of sets of
    n split off it, which share draws: its sd is a little small where the reference is. p by
    `two_sample_p`. Raises ValueError as `noise_floor` and `two_sample_p` do.
    """
    draws, reference = np.asarray(draws), np.asarray(reference)
    floors = _of_exact_sets(reference, len(draws), rng, repeats, distance)
    chosen = reference[rng.permutation(len(reference))[: len(draws)]]
    value, p = _permuted(draws, chosen, rng, distance, permutations)
    return Distance(value, float(np.mean(floors)), float(np.std(floors, ddof=1)), p)


def flat(x: np.ndarray) -> np.ndarray:
    """Real view (n, d) of draws (n, *shape), in double precision."""
    x = np.asarray(x)
    if x.ndim == 0 or x.size == 0:
        raise ValueError(f"draws of shape {x.shape}: give (draws, *shape), one or more")
    x = x.reshape(len(x), -1)
    x = np.concatenate([x.real, x.imag], axis=1) if np.iscomplexobj(x) else x
    check_draws_finite(x)
    return x.astype(float)


def squared_distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """|x - y|^2 of all pairs, (m, n); of sets that were centred, or rounding would speak."""
    square = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2 * a @ b.T
    return np.maximum(square, 0.0)


def median_distance(x: np.ndarray, rng: np.random.Generator) -> float:
    """Median distance of the draws x (n, d); above 0, or a ValueError."""
    if len(x) > _MEDIAN_OF:
        x = x[rng.choice(len(x), _MEDIAN_OF, replace=False)]
    found = np.median(pdist(x))
    if not found > 0:
        raise ValueError(
            f"the median distance of draws is {found:.3g}: most are the same, give a bandwidth, "
            "or look at the sampler"
        )
    return float(found)


def rank_p(value: float, null: np.ndarray, rng: np.random.Generator) -> float:
    """p-value of `value` among the values of a null hypothesis, equal ones in random order."""
    above, equal = np.sum(null > value), np.sum(null == value)
    return float((1 + above + rng.integers(equal + 1)) / (1 + len(null)))


def _permuted(
    a: np.ndarray, b: np.ndarray, rng: np.random.Generator, distance: TwoSample, permutations: int
) -> tuple[float, float]:
    """The distance, and its p-value."""
    a, b = np.asarray(a), np.asarray(b)
    if permutations < 19:
        raise ValueError(f"{permutations} permutations: give 19 or more, fewer never reach 5 %")
    value = distance(a, b, rng)
    both = np.concatenate([a, b])
    null = np.empty(permutations)
    for i in range(permutations):
        mixed = both[rng.permutation(len(both))]
        null[i] = distance(mixed[: len(a)], mixed[len(a) :], rng)
    return value, rank_p(value, null, rng)


def _of_exact_sets(
    reference: np.ndarray, size: int, rng: np.random.Generator, repeats: int, distance: TwoSample
) -> list[float]:
    reference = np.asarray(reference)
    if int(size) != size or size < 1:
        raise ValueError(f"sets of {size} draws: give a whole number, 1 or more")
    if 2 * size > len(reference):
        raise ValueError(f"two sets of {size} need a reference of {2 * size}, not {len(reference)}")
    if repeats < 2:
        raise ValueError(f"{repeats} repeats: give 2 or more")
    if np.all(reference == reference[:1]):
        raise ValueError(
            f"all {len(reference)} draws of the reference are the same, which have no distance to "
            "read others by: give exact draws"
        )
    found = []
    for _ in range(repeats):
        order = rng.permutation(len(reference))
        parts = reference[order[:size]], reference[order[size : 2 * size]]
        found.append(distance(*parts, rng))
    return found


def _pair(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if np.iscomplexobj(a) != np.iscomplexobj(b):
        raise ValueError("draws of a complex and of a real object: give two sets of one problem")
    a, b = flat(a), flat(b)
    if a.shape[1] != b.shape[1]:
        raise ValueError(
            f"draws of {a.shape[1]} and of {b.shape[1]} dimensions: give two sets of one problem"
        )
    return a, b


def _kernel_sum(a: np.ndarray, b: np.ndarray, bandwidth: float) -> float:
    centre = b.mean(axis=0)
    a, b = a - centre, b - centre
    blocks = (squared_distances(a[i : i + BLOCK], b) for i in range(0, len(a), BLOCK))
    return float(sum(np.exp(square / (-2 * bandwidth**2)).sum() for square in blocks))


def _standardised(x: np.ndarray, reference: np.ndarray) -> np.ndarray:
    sd = reference.std(axis=0)
    if not sd.any():
        raise ValueError(f"all {len(reference)} draws of the reference are the same: give others")
    # Where the reference does not vary, a draw that differs still does.
    return (x - reference.mean(axis=0)) / np.where(sd > 0, sd, 1.0)
