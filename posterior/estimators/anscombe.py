"""Poisson denoising by a Gaussian denoiser: Anscombe's transform, the denoiser, the exact inverse.

The square root makes the noise of photon counts nearly normal with variance 1 at every brightness;
any denoiser of white Gaussian noise (BM3D, a network) then serves. Makitalo and Foi (2011).
"""

from collections.abc import Callable

import numpy as np

from ..models.camera import Camera

# Below this the closed form of the inverse, which returns 0 electrons at it, is no longer monotone.
_LEAST = 2 * np.sqrt(3 / 8)


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


def anscombe_denoised(
    y: np.ndarray, camera: Camera, denoiser: Callable[[np.ndarray, float], np.ndarray]
) -> np.ndarray:
    """An estimate of the picture from its counts `y` (electrons / full well), same shape and units.

    `denoiser(picture, sigma)` removes white Gaussian noise of that standard deviation from pictures
    with values in about 0..1: the transform is divided by its value at the full well. Raises
    ValueError for a camera that does not count, or that has read noise.
    """
    if not camera.counting or camera.read_variance > 0:
        raise ValueError(
            f"camera {type(camera).__name__}: Anscombe's transform is for photon counts without "
            "read noise, give a Poisson camera"
        )
    electrons = 1 / camera.sigma0**2
    scale = float(anscombe(electrons))
    clean = denoiser(anscombe(np.asarray(y) * electrons) / scale, 1 / scale)
    return exact_unbiased_inverse(clean * scale) / electrons
