"""How near an estimate, or a set of draws, is to a truth that is known.

None of these says whether a stated uncertainty is true: for that see `coverage` and `sbc`.
"""

import numpy as np
import scipy.linalg
import scoringrules
from scipy.spatial.distance import pdist
from skimage.metrics import structural_similarity

from .checks import check_finite, check_kinds, check_real

# Side of the window of SSIM: Gaussian weights to 3.5 sd of 1.5 pixels on both sides.
_WINDOW = 11


def psnr(found: np.ndarray, truth: np.ndarray, peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB: 10 log10(peak^2 / mean |found - truth|^2); inf if equal.

    Of one object, real or complex. Of an amplitude: give np.abs of both. Raises ValueError for
    objects of different shape, one real and the other complex, values that are not finite, and a
    peak that is not positive.
    """
    found, truth = _alike(found, truth)
    _check_peak(peak)
    error = np.mean(np.abs(_difference(found, truth)) ** 2)
    return float(np.inf) if error == 0 else float(10 * np.log10(peak**2 / error))


def phase_psnr(found: np.ndarray, truth: np.ndarray) -> float:
    """PSNR in dB of the phase of a complex object, with the peak 2 pi (paper, section 4, footnote).

    The error is periodic, and its mean square is that at the best global offset: the variance on
    the circle, found exactly, by cutting the circle between any two phases. Raises ValueError for
    real objects, whose phase is a sign, for ones that are 0 everywhere, which have none, and as
    `psnr` does.
    """
    found, truth = _alike(found, truth)
    if not np.iscomplexobj(truth):
        raise ValueError("a real object has no phase: give complex ones")
    for name, x in (("object found", found), ("truth", truth)):
        _check_not_zero(name, x, "it has no phase")
    error = np.sort(np.angle(found * np.conj(truth)), axis=None).astype(float)
    # Cut after the k-th phase: those before it are taken 2 pi further on.
    count = np.arange(len(error))
    before = np.concatenate([[0.0], np.cumsum(error)[:-1]])
    mean = error.mean() + 2 * np.pi * count / len(error)
    square = np.mean(error**2) + (4 * np.pi * before + 4 * np.pi**2 * count) / len(error)
    # Rounding may leave a difference of equal numbers a little below 0.
    variance = np.maximum(square - mean**2, 0.0).min()
    return float(np.inf) if variance == 0 else float(10 * np.log10((2 * np.pi) ** 2 / variance))


def nrmse(found: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square of the error over that of the truth; real or complex.

    Raises ValueError for a truth that is 0 everywhere, and as `psnr` does.
    """
    found, truth = _alike(found, truth)
    _check_not_zero("truth", truth, "no error is relative to it")
    apart = np.ravel(_difference(found, truth))
    return float(np.linalg.norm(apart) / np.linalg.norm(np.ravel(truth + 0.0)))


def ssim(found: np.ndarray, truth: np.ndarray, peak: float = 1.0) -> float:
    """Structural similarity of real pictures (h, w) or (h, w, 3) (Wang et al. 2004).

    Gaussian windows of 1.5 pixels and population moments, as published; `peak` is the range of the
    values. Raises ValueError for complex pictures, ones that are smaller than the window, 11 x 11,
    and as `psnr` does.
    """
    if np.iscomplexobj(found) or np.iscomplexobj(truth):
        raise ValueError("SSIM is for real pictures: give np.abs() of complex ones")
    found, truth = _alike(found, truth)
    _check_peak(peak)
    if truth.ndim not in (2, 3) or min(truth.shape[:2]) < _WINDOW:
        raise ValueError(
            f"pictures of shape {truth.shape}: give (h, w) or (h, w, 3), h and w {_WINDOW} or more"
        )
    return float(
        structural_similarity(
            found.astype(float), truth.astype(float), data_range=peak,
            channel_axis=-1 if truth.ndim == 3 else None,
            gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        )
    )  # fmt: skip


def crps(draws: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Continuous ranked probability score of each pixel: `truth`'s shape, in its unit; 0 is best.

    `draws` (draws, *shape), real. Unbiased for so many draws ("fair", Ferro 2014), so that sets of
    different size compare; for one draw it would be undefined. On average it is least for the true
    posterior (Gneiting and Raftery 2007). Raises ValueError for shapes that do not fit, fewer than
    2 draws, and values that are complex or not finite.
    """
    draws, truth = _checked_draws(draws, truth)
    return scoringrules.crps_ensemble(truth, draws, m_axis=0, estimator="pwm")


def energy_score(draws: np.ndarray, truth: np.ndarray) -> float:
    """Energy score of whole objects: CRPS with the distance of objects; 0 is best.

    `draws` (draws, *shape), real or complex; in the object's unit. It sees correlations, which CRPS
    does not, if weakly. "Fair" as `crps`. Raises ValueError as that does, for draws and truth of
    which one is real and the other complex.
    """
    draws, truth = _checked_draws(draws, truth, real=False)
    flat = np.concatenate([truth[None], draws]).reshape(len(draws) + 1, -1)
    flat = np.concatenate([flat.real, flat.imag], axis=1) if np.iscomplexobj(flat) else flat
    near = np.linalg.norm(flat[1:] - flat[0], axis=1).mean()
    # Pair by pair: all differences at once would not fit for pictures.
    return float(near - pdist(flat[1:]).mean() / 2)


def frechet_distance(features: np.ndarray, others: np.ndarray) -> float:
    """Frechet distance of two sets of features (n, d), each taken for normal.

    |m - m'|^2 + tr(C + C' - 2 (C C')^(1/2)) (Dowson and Landau 1982). It depends on the features,
    and is called FID only where they are Inception's. With n not much larger than d it is far from
    0 for sets of one kind too: print it beside that. Raises ValueError for other shapes, and
    features that are complex or not finite.
    """
    sets = [np.asarray(s) for s in (features, others)]
    check_real(features=sets[0], others=sets[1])
    if any(s.ndim != 2 or len(s) < 2 for s in sets) or sets[0].shape[1] != sets[1].shape[1]:
        raise ValueError(
            f"features of shape {sets[0].shape} and {sets[1].shape}: give (n, d), n of 2 or more"
        )
    for s in sets:
        check_finite("features", s, "leave those pictures out")
    moments = [(s.mean(axis=0), np.atleast_2d(np.cov(s.T))) for s in sets]
    return frechet_of_moments(*moments[0], *moments[1])


def frechet_of_moments(
    mean: np.ndarray, covariance: np.ndarray, other_mean: np.ndarray, other_covariance: np.ndarray
) -> float:
    """Squared Frechet distance of two normals: means (d,), covariances (d, d)."""
    # The trace of the root of a product is that of a symmetric matrix, whose eigenvalues are real.
    root = _root(covariance)
    overlap = np.trace(_root(root @ other_covariance @ root))
    apart = np.sum((mean - other_mean) ** 2)
    return float(apart + np.trace(covariance) + np.trace(other_covariance) - 2 * overlap)


def _root(matrix: np.ndarray) -> np.ndarray:
    values, vectors = scipy.linalg.eigh(matrix)
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T


def _difference(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    # Codes of a camera would wrap around.
    return np.subtract(found, truth, dtype=np.result_type(found, truth, 0.0))


def _alike(found: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two objects as arrays, if they can be compared."""
    found, truth = np.asarray(found), np.asarray(truth)
    if found.shape != truth.shape or not truth.size:
        raise ValueError(f"objects of shape {found.shape} and {truth.shape}: give one size")
    check_kinds("an object", found, "a truth", truth)
    check_finite("object found", found)
    check_finite("truth", truth, "give one without them")
    return found, truth


def _check_peak(peak: float) -> None:
    if not 0 < peak < np.inf:
        raise ValueError(f"peak {peak}: give the range of the values, a positive number")


def _check_not_zero(name: str, x: np.ndarray, why: str) -> None:
    if not np.any(x):
        raise ValueError(f"the {name} is 0 everywhere: {why}, compare by psnr")


def _checked_draws(
    draws: np.ndarray, truth: np.ndarray, real: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Draws and their truth as arrays, if they can be compared."""
    draws, truth = np.asarray(draws), np.asarray(truth)
    if real:
        check_real(draws=draws, truths=truth)
    else:
        check_kinds("draws", draws, "a truth", truth)
    if draws.shape[1:] != truth.shape or len(draws) < 2 or not truth.size:
        raise ValueError(
            f"draws of shape {draws.shape} for a truth of {truth.shape}: give (draws, *shape), 2 "
            "draws or more"
        )
    check_finite("draws", draws)
    check_finite("truth", truth, "give one without them")
    return draws, truth
