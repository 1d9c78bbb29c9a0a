"""Layers of the score networks: one image at a time, channels last, float32 unless told.

Images are (height, width, channels); `jax.vmap` adds the batch, which XLA folds into the batch of
the convolution. Channels come last because XLA's convolutions on a CPU are fastest so.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax


class Conv(eqx.Module):
    """Convolution with zero padding: (h, w, channels in) -> (h/stride, w/stride, channels out).

    Weights start normal with variance gain/fan-in, the bias at zero.
    """

    kernel: jax.Array
    bias: jax.Array
    stride: int = eqx.field(static=True)
    dilation: int = eqx.field(static=True)

    def __init__(
        self,
        channels_in: int,
        channels_out: int,
        key: jax.Array,
        side: int = 3,
        stride: int = 1,
        dilation: int = 1,
        gain: float = 1.0,
    ):
        sd = np.sqrt(gain / (side * side * channels_in))
        shape = (side, side, channels_in, channels_out)
        self.kernel = sd * jax.random.normal(key, shape, jnp.float32)
        self.bias = jnp.zeros(channels_out, jnp.float32)
        self.stride = stride
        self.dilation = dilation

    def __call__(self, x: jax.Array) -> jax.Array:
        """The image convolved."""
        out = lax.conv_general_dilated(
            x[None],
            self.kernel,
            (self.stride, self.stride),
            "SAME",
            rhs_dilation=(self.dilation, self.dilation),
            dimension_numbers=("NHWC", "HWIO", "NHWC"),
        )
        return out[0] + self.bias


class Linear(eqx.Module):
    """x W + b for a vector x."""

    weight: jax.Array
    bias: jax.Array

    def __init__(self, size_in: int, size_out: int, key: jax.Array, gain: float = 1.0):
        sd = np.sqrt(gain / size_in)
        self.weight = sd * jax.random.normal(key, (size_in, size_out), jnp.float32)
        self.bias = jnp.zeros(size_out, jnp.float32)

    def __call__(self, x: jax.Array) -> jax.Array:
        """The vector transformed."""
        return x @ self.weight + self.bias


class LevelEmbedding(eqx.Module):
    """A vector that tells the network the noise level, from sines and cosines of its logarithm."""

    first: Linear
    second: Linear
    frequencies: tuple[float, ...] = eqx.field(static=True)

    def __init__(self, size: int, key: jax.Array):
        keys = jax.random.split(key)
        self.frequencies = tuple(float(f) for f in np.geomspace(0.25, 4.0, 8))
        self.first = Linear(2 * len(self.frequencies), size, keys[0], gain=2.0)
        self.second = Linear(size, size, keys[1], gain=2.0)

    def __call__(self, log_level: jax.Array) -> jax.Array:
        """(size,) from a scalar."""
        angle = log_level * jnp.asarray(self.frequencies, self.first.weight.dtype)
        features = jnp.concatenate([jnp.sin(angle), jnp.cos(angle)])
        return jax.nn.silu(self.second(jax.nn.silu(self.first(features))))


def gather_pixels(x: jax.Array, factor: int = 2) -> jax.Array:
    """(h, w, c) -> (h/factor, w/factor, factor^2 c): each square of pixels becomes one."""
    h, w, c = x.shape
    x = x.reshape(h // factor, factor, w // factor, factor, c)
    return x.transpose(0, 2, 1, 3, 4).reshape(h // factor, w // factor, factor * factor * c)


def scatter_pixels(x: jax.Array, factor: int = 2) -> jax.Array:
    """The inverse of `gather_pixels`."""
    h, w, c = x.shape
    c = c // (factor * factor)
    x = x.reshape(h, w, factor, factor, c)
    return x.transpose(0, 2, 1, 3, 4).reshape(h * factor, w * factor, c)
