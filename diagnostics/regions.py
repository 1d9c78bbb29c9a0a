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


def within_grey_levels(images: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Images (..., h, w), each value moved at random by up to half a grey level of its image.

    The light behind a grey level is known no better, and a share of pixels above a threshold of a
    truth in steps asks on which side of it whole levels fall, which draws that are no steps cannot
    know. A grey level is the least distance of two values of an image below its brightest, which
    may be clipped; next to nothing in images of floating-point numbers. An image of one value is
    left as it is.
    """
    images = np.asarray(images)
    pictures = images.reshape(-1, *images.shape[-2:])
    steps = np.array([_grey_level(picture) for picture in pictures])
    moved = rng.random(pictures.shape) - 0.5
    return (pictures + steps[:, None, None] * moved).reshape(images.shape)


def _grey_level(image: np.ndarray) -> float:
    below = np.unique(image[image < image.max()])
    return float(np.diff(below).min()) if below.size > 1 else 0.0


def as_planes(images: np.ndarray) -> np.ndarray:
    """Pictures in colour (..., h, w, 3) as planes (..., 3, h, w)."""
    return np.moveaxis(images, -1, -3)
