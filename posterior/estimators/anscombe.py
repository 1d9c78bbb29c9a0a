"""Poisson denoising by a Gaussian denoiser: Anscombe's transform, the denoiser, the exact inverse.

The square root makes the noise of photon counts nearly normal with variance 1 at every brightness;
any denoiser of white Gaussian noise (BM3D, a network) then serves. Makitalo and Foi (2011). Where
counts are few it does so badly; the counts together with a first estimate it serves better, and a
second round mends the first. Azzari and Foi, IEEE Signal Processing Letters 23, 1086 (2016).
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

from ..models.camera import Camera

# Below this the closed form of the inverse, which returns 0 electrons at it, is no longer monotone.
_LEAST = 2 * np.sqrt(3 / 8)
# From here a series of the root is used, which four moments give to 1e-5; sums below.
_MANY = 50.0


def anscombe(electrons: np.ndarray) -> np.ndarray:
    """2 sqrt(N + 3/8): normal with variance 1, nearly, from some four electrons up."""
    return 2 * np.sqrt(np.maximum(electrons, 0) + 3 / 8)


def exact_unbiased_inverse(value: np.ndarray) -> np.ndarray:
    """The mean number of electrons m at which E[anscombe(N)] is `value`, N ~ Poisson(m).

    Makitalo and Foi's closed form (2011, Eq. 10), within 0.03 electrons of it everywhere. The
    algebraic inverse is biased: counts are skew, and a mean of roots is below the root of a mean.
    """
    d = np.maximum(value, _LEAST)
    root = np.sqrt(3 / 2)
    found = d**2 / 4 + root / (4 * d) - 11 / (8 * d**2) + 5 * root / (8 * d**3) - 1 / 8
    return np.maximum(found, 0.0)


def mean_of_roots(mean: np.ndarray, share: float) -> np.ndarray:
    """E[anscombe((share N + (1 - share) m) / share^2)], N ~ Poisson(m), at means m (n,).

    Counts and their mean, divided so that variance and mean are equal, as those of counts are.
    """
    m = np.asarray(mean, float)
    few = np.minimum(m, _MANY)
    counts = np.arange(200)[:, None]
    roots = anscombe((share * counts + (1 - share) * few) / share**2)
    summed = np.sum(stats.poisson.pmf(counts, few) * roots, axis=0)
    # t = (N - m) share / share^2, over the root's argument at the mean: moments of t, and of
    # sqrt(1 + t) = 1 + t/2 - t^2/8 + t^3/16 - 5 t^4/128.
    many = np.maximum(m, _MANY)
    middle = many / share**2 + 3 / 8
    unit = 1 / (share * middle)
    second, third, fourth = many * unit**2, many * unit**3, (3 * many**2 + many) * unit**4
    series = 2 * np.sqrt(middle) * (1 - second / 8 + third / 16 - 5 * fourth / 128)
    return np.where(m < _MANY, summed, series)


def _inverse(value: np.ndarray, share: float) -> np.ndarray:
    """The mean m at which `mean_of_roots` is `value`; 0 below what darkness gives."""
    if share == 1:
        return exact_unbiased_inverse(value)
    # The root is nearly linear between neighbours of a quadratic grid.
    largest = np.sqrt((np.max(value) / 2) ** 2 * share**2 + 1)
    means = np.linspace(0, largest, max(2000, int(20 * largest))) ** 2
    return np.interp(value, mean_of_roots(means, share), means)


def anscombe_denoised(
    y: np.ndarray,
    camera: Camera,
    denoiser: Callable[[np.ndarray, float], np.ndarray],
    shares: Sequence[float] = (1.0,),
) -> np.ndarray:
    """An estimate of the picture from its counts `y` (electrons / full well), same shape and units.

    `denoiser(picture, sigma)` removes white Gaussian noise of that standard deviation from pictures
    with values in about 0..1: the transform is divided by its value at the full well.

    `shares`: of the counts in what is denoised, round by round, the rest being the last estimate: 1
    first. More than one is Azzari and Foi's iteration, whose inverse takes the last estimate for
    the truth. Their choice of shares by the brightness of the recording is left to the caller, and
    their binning is left out. With BM3D, shares of 1, 0.625 and 0.25 gain 0.4 dB on a picture whose
    brightest pixels have 2 electrons, and lose 0.6 dB where they have 100.

    Raises ValueError for a camera that does not count, or has read noise or an ADC that hides
    counts; for what the camera cannot have recorded; for shares outside (0, 1]; and for a denoiser
    that returns another shape, or values that are not finite.
    """
    shares = tuple(float(share) for share in shares)
    if not shares or shares[0] != 1 or not all(0 < share <= 1 for share in shares):
        raise ValueError(
            f"shares {shares}: begin with 1, there is no estimate yet, and keep to 0..1"
        )
    if not camera.counting or camera.read_variance > 0:
        raise ValueError(
            f"camera {type(camera).__name__} with read noise or an ADC, or without counts: "
            "Anscombe's transform is for counts alone, give Poisson(full_well) without bits"
        )
    camera.check(y)
    electrons = 1 / camera.sigma0**2
    counts = np.asarray(y) * electrons
    estimate = counts
    for share in shares:
        mixed = (share * counts + (1 - share) * estimate) / share**2
        scale = float(anscombe(electrons / share**2))
        clean = np.asarray(denoiser(anscombe(mixed) / scale, 1 / scale))
        if clean.shape != counts.shape or not np.all(np.isfinite(clean)):
            raise ValueError(
                f"the denoiser returned {clean.shape}, with {np.sum(~np.isfinite(clean))} values "
                f"that are not finite: it must keep the shape {counts.shape}, and be finite"
            )
        estimate = _inverse(clean * scale, share)
    return estimate / electrons
