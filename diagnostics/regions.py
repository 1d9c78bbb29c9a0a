"""What is asked of whole regions of a picture, where errors of pixels add up or cancel."""

import numpy as np


def block_means(images: np.ndarray, side: int = 8) -> np.ndarray:
    """Means (..., h // side, w // side) of whole square blocks of images (..., h, w)."""
    h, w = (n // side for n in images.shape[-2:])
    whole = images[..., : h * side, : w * side]
    return whole.reshape(*images.shape[:-2], h, side, w, side).mean((-3, -1))


def image_means(images: np.ndarray) -> np.ndarray:
    """Means (...) of images (..., h, w)."""
    return images.mean((-2, -1))


def bright_areas(images: np.ndarray, threshold: float) -> np.ndarray:
    """Shares (...) of the pixels of images (..., h, w) that are above `threshold`."""
    return (images > threshold).mean((-2, -1))


def as_planes(images: np.ndarray) -> np.ndarray:
    """Pictures in colour (..., h, w, 3) as planes (..., 3, h, w)."""
    return np.moveaxis(images, -1, -3)
