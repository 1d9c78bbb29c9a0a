"""What a Frechet distance sees of pictures: features of patches, fixed ones or a network's own."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models.priors.learned import LearnedPrior
from ..models.priors.unet import UNet
from .checks import check_finite, check_real

# Side of a patch: three halvings of it are the scales.
PATCH = 8
_SCALES = 3
# Pictures that go through a network at once.
_BATCH = 16


class Features(NamedTuple):
    """`of(images)`: (n, h, w[, 3]) to features (n, samples of a picture, d); `name` for tables."""

    name: str
    of: Callable[[np.ndarray], np.ndarray]


def haar_bands(images: np.ndarray) -> np.ndarray:
    """Contrast of every 8x8 patch by scale and direction: (n, h, w[, 3]) to (n, patches, 10).

    The patch's mean, and the root mean square of its Haar coefficients (Mallat 1989) at 2, 4 and 8
    pixels, across rows, across columns and across both; in the unit of the images. Planes of a
    picture in colour are samples beside each other: how colours go together is not seen. Rows and
    columns over a multiple of 8 are left out; raises ValueError for smaller pictures, and ones that
    are complex or not finite.
    """
    images = np.asarray(images)
    check_pictures(images)
    images = _planes_apart(images.astype(float))
    h, w = (n // PATCH for n in images.shape[2:])
    if min(h, w) < 1:
        raise ValueError(f"pictures of {images.shape[2:]}: give {PATCH} x {PATCH} or larger")
    rest, found = images[..., : h * PATCH, : w * PATCH], []
    for _ in range(_SCALES):
        rest, *details = _haar(rest)
        found += [np.sqrt(_mean_of_patches(detail**2, h, w)) for detail in details]
    # What is left of the last halving is one coefficient a patch, 8 times its mean.
    found.append(rest / PATCH)
    return np.stack(found, axis=-1).reshape(len(images), -1, len(found))


HAAR = Features("Haar bands of 8x8 patches", haar_bands)


def bottleneck_features(prior: LearnedPrior, sigma: float | None = None) -> Features:
    """Features of a U-Net's coarsest level, channel by channel: every place of it is a sample.

    `prior`: one for these pictures; the network sees them as they are, told the level `sigma`
    (None: its finest). Where `prior` also made the draws, the network is judge in its own cause:
    what it does not know of pictures it does not miss in them. Raises ValueError for a network of
    another kind and for priors of complex objects.
    """
    network = prior.denoiser.network
    if not isinstance(network, UNet) or prior.complex_valued:
        raise ValueError(
            f"no bottleneck features of a {type(network).__name__}"
            f"{' for complex objects' if prior.complex_valued else ''}: use the Haar bands"
        )
    sigma = prior.finest if sigma is None else sigma
    denoiser = prior.denoiser

    @eqx.filter_jit
    def one_batch(channels: jax.Array) -> jax.Array:
        of_one = lambda x: denoiser.bottleneck(x, jnp.asarray(sigma))  # noqa: E731
        found = jax.lax.map(of_one, channels, batch_size=_BATCH)
        return found.reshape(len(channels), -1, found.shape[-1])

    def of(images: np.ndarray) -> np.ndarray:
        images = np.asarray(images)
        check_pictures(images)
        channels = images.astype(np.float32)
        return np.asarray(one_batch(channels if channels.ndim == 4 else channels[..., None]), float)

    return Features(f"bottleneck of the prior's network at {sigma:g}", of)


def check_pictures(images: np.ndarray) -> None:
    """Refuse pictures that are complex or not finite."""
    check_real(pictures=images)
    check_finite("pictures", images, "leave out those that hold them")


def _planes_apart(images: np.ndarray) -> np.ndarray:
    """(n, h, w[, planes]) to (n, planes, h, w)."""
    if images.ndim not in (3, 4):
        raise ValueError(f"pictures of shape {images.shape}: give (n, h, w) or (n, h, w, 3)")
    return images[:, None] if images.ndim == 3 else np.moveaxis(images, -1, 1)


def _haar(x: np.ndarray) -> tuple[np.ndarray, ...]:
    """Orthonormal coefficients (..., h/2, w/2): the smooth, and the three kinds of detail."""
    a, b, c, d = x[..., ::2, ::2], x[..., ::2, 1::2], x[..., 1::2, ::2], x[..., 1::2, 1::2]
    return (a + b + c + d) / 2, (a + b - c - d) / 2, (a - b + c - d) / 2, (a - b - c + d) / 2


def _mean_of_patches(x: np.ndarray, h: int, w: int) -> np.ndarray:
    return x.reshape(*x.shape[:2], h, x.shape[2] // h, w, -1).mean((3, 5))
