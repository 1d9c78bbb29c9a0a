"""Distance to a known posterior, printed beside the noise floor of two exact sets."""

import numpy as np


def sliced_wasserstein(
    a: np.ndarray, b: np.ndarray, rng: np.random.Generator, projections: int = 200
) -> float:
    """Sliced 1-Wasserstein distance of two sets of draws, in units of the object.

    `a` (m, *shape), `b` (n, *shape), real or complex; the mean over random directions of the real
    view of the mean distance of quantiles (Bonneel et al. 2015). To be read in posterior standard
    deviations: divide by the root mean square sd of a component.
    """
    a, b = _flat(a), _flat(b)
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"draws of {a.shape[1]} and of {b.shape[1]} dimensions: not one problem")
    directions = rng.standard_normal((a.shape[1], projections))
    directions /= np.linalg.norm(directions, axis=0)
    level = (np.arange(min(len(a), len(b))) + 0.5) / min(len(a), len(b))
    quantiles = [np.quantile(x @ directions, level, axis=0) for x in (a, b)]
    return float(np.mean(np.abs(quantiles[0] - quantiles[1])))


def noise_floor(
    reference: np.ndarray, size: int, rng: np.random.Generator, repeats: int = 8
) -> float:
    """Mean sliced Wasserstein distance of two exact sets of `size` draws, split off `reference`."""
    if 2 * size > len(reference):
        raise ValueError(f"two sets of {size} need a reference of {2 * size}, not {len(reference)}")
    found = []
    for _ in range(repeats):
        order = rng.permutation(len(reference))
        found.append(
            sliced_wasserstein(reference[order[:size]], reference[order[size : 2 * size]], rng)
        )
    return float(np.mean(found))


def _flat(x: np.ndarray) -> np.ndarray:
    x = np.asarray(x).reshape(len(x), -1)
    return np.concatenate([x.real, x.imag], axis=1) if np.iscomplexobj(x) else x
