"""Layers of the score networks: one image at a time, channels last, float32 unless told.

Images are (height, width, channels); `jax.vmap` adds the batch, which XLA folds into the batch of
the convolution. Channels come last because XLA's convolutions on a CPU are fastest so.
"""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax


class Conv(eqx.Module):
    """Convolution with zero padding: (h, w, channels in) -> (h, w, channels out).

    `kernel` (side, side, in, out), odd side; `bias` (out,); `trained`: see `frozen`.
    """

    kernel: jax.Array
    bias: jax.Array
    dilation: int = eqx.field(static=True, default=1)
    trained: bool = eqx.field(static=True, default=True)

    def __call__(self, x: jax.Array) -> jax.Array:
        """The image convolved, in the precision of the weights."""
        convolve = _convolve if self.trained else _convolve_both_ways
        x = x.astype(self.kernel.dtype)
        return convolve(x[None], self.kernel, self.dilation)[0] + self.bias


def new_conv(
    channels_in: int,
    channels_out: int,
    key: jax.Array,
    side: int = 3,
    dilation: int = 1,
    gain: float = 1.0,
) -> Conv:
    """A convolution to be trained: normal weights of variance gain/fan-in, no bias."""
    sd = np.sqrt(gain / (side * side * channels_in))
    shape = (side, side, channels_in, channels_out)
    kernel = sd * jax.random.normal(key, shape, jnp.float32)
    return Conv(kernel, jnp.zeros(channels_out, jnp.float32), dilation)


def frozen(module: eqx.Module) -> eqx.Module:
    """The same network for use and not for training: quicker gradients in the image in loops."""

    def freeze(node: object) -> object:
        return dataclasses.replace(node, trained=False) if isinstance(node, Conv) else node

    return jax.tree.map(freeze, module, is_leaf=lambda node: isinstance(node, Conv))


def in_precision(module: eqx.Module, dtype: str) -> eqx.Module:
    """The same network with its bulk computed in `dtype`, such as "bfloat16".

    Convolutions, and what the noise level does to their features; the level's own embedding, whose
    angles bfloat16 would round by more than levels differ, and normalisation keep their precision.
    """

    def is_layer(node: object) -> bool:
        return isinstance(node, Conv | Linear | LevelEmbedding)

    def cast(node: object) -> object:
        if not isinstance(node, Conv | Linear):
            return node
        return jax.tree.map(lambda a: a.astype(dtype), node)

    return jax.tree.map(cast, module, is_leaf=is_layer)


def _convolve(x: jax.Array, kernel: jax.Array, dilation: int) -> jax.Array:
    return lax.conv_general_dilated(
        x,
        kernel,
        (1, 1),
        "SAME",
        rhs_dilation=(dilation, dilation),
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
    )


@partial(jax.custom_vjp, nondiff_argnums=(2,))
def _convolve_both_ways(x: jax.Array, kernel: jax.Array, dilation: int) -> jax.Array:
    """A convolution whose gradient in x is again a plain one, by the mirrored kernel.

    Inside a compiled loop XLA runs on a CPU what JAX derives up to ten times slower (jax 0.10).
    Batches of it under `vmap` cost more than they should in the gradient for the kernel.
    """
    return _convolve(x, kernel, dilation)


def _forward(
    x: jax.Array, kernel: jax.Array, dilation: int
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    return _convolve(x, kernel, dilation), (x, kernel)


def _backward(
    dilation: int, saved: tuple[jax.Array, jax.Array], out: jax.Array
) -> tuple[jax.Array, jax.Array]:
    x, kernel = saved
    mirrored = jnp.flip(kernel, (0, 1)).swapaxes(2, 3)
    _, for_kernel = jax.vjp(lambda k: _convolve(x, k, dilation), kernel)
    return _convolve_both_ways(out, mirrored, dilation), *for_kernel(out)


_convolve_both_ways.defvjp(_forward, _backward)


class Linear(eqx.Module):
    """x W + b for a vector x."""

    weight: jax.Array
    bias: jax.Array

    def __init__(self, size_in: int, size_out: int, key: jax.Array, gain: float = 1.0):
        sd = np.sqrt(gain / size_in)
        self.weight = sd * jax.random.normal(key, (size_in, size_out), jnp.float32)
        self.bias = jnp.zeros(size_out, jnp.float32)

    def __call__(self, x: jax.Array) -> jax.Array:
        """The vector transformed, in the precision of the weights."""
        return x.astype(self.weight.dtype) @ self.weight + self.bias


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


def mean_pool(x: jax.Array, side: int, stride: int) -> jax.Array:
    """Mean of (h, w, c) over squares; what lies outside the image does not count."""
    window, strides = (side, side, 1), (stride, stride, 1)
    total = lax.reduce_window(x, 0.0, lax.add, window, strides, "SAME")
    count = lax.reduce_window(jnp.ones_like(x), 0.0, lax.add, window, strides, "SAME")
    return total / count
