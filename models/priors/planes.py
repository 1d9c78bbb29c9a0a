"""A prior of grey pictures for those in colour: each of the three channels by itself."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .field import GaussianField
from .learned import LearnedPrior

CHANNELS = 3


class _ByPlanes(eqx.Module):
    """A network of one channel, on each of three (h, w, 3) as if it were alone."""

    network: eqx.Module
    channels: int = eqx.field(static=True, default=CHANNELS)

    @property
    def stride(self) -> int:
        """Of the network."""
        return self.network.stride

    def __call__(self, x: jax.Array, level: jax.Array) -> jax.Array:
        """(h, w, 3) -> the same shape."""
        planes = jnp.moveaxis(x, -1, 0)[..., None]
        found = jax.vmap(lambda plane: self.network(plane, level))(planes)
        return jnp.moveaxis(found[..., 0], 0, -1)


def by_planes(prior: GaussianField | LearnedPrior) -> GaussianField | LearnedPrior:
    """The prior (h, w, 3) of three independent pictures of a real `prior` (h, w).

    An approximation: the channels of a picture in colour look alike, and this prior does not know.
    Raises ValueError for a prior of another shape, or of complex objects.
    """
    if len(prior.shape) != 2 or prior.complex_valued:
        raise ValueError(f"a prior of shape {prior.shape}: by planes goes one of grey pictures")
    shape = (*prior.shape, CHANNELS)
    if isinstance(prior, GaussianField):
        # White along the third axis: the planes are independent.
        power = np.repeat(np.asarray(prior.power)[..., None], CHANNELS, axis=-1)
        return GaussianField(power, np.asarray(prior.mean)[..., None], shape)
    network = _ByPlanes(prior.denoiser.network)
    denoiser = eqx.tree_at(lambda d: d.network, prior.denoiser, network)
    return type(prior)(denoiser, shape, prior.sampling_steps)
