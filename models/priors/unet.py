"""The default network: a compact U-Net without normalisation, made for a CPU.

The bulk works on squares of 2x2 pixels gathered into channels; a thin path at full resolution
carries what that would blur. Levels of half the size and more channels follow, one residual block
or more a level on the way down and on the way up. The noise level scales and shifts the features
of every block.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from .layers import Conv, LevelEmbedding, Linear, gather_pixels, new_conv, scatter_pixels


class UNet(eqx.Module):
    """(h, w, channels) and a log noise level -> (h, w, channels).

    `widths`: channels of each level, fine to coarse; `blocks`: residual blocks a level and
    direction; `fine`: channels of the path at full resolution. Sides must be multiples of
    `stride` = 2^levels.
    """

    embedding: LevelEmbedding
    fine_in: Conv
    coarse_in: Conv
    down: list[list["Block"]]
    shrink: list[Conv]
    middle: "Block"
    grow: list[Conv]
    up: list[list["Block"]]
    coarse_out: Conv
    fine_block: "Block"
    fine_out: Conv
    channels: int = eqx.field(static=True)
    stride: int = eqx.field(static=True)

    def __init__(
        self,
        channels: int,
        key: jax.Array,
        widths: tuple[int, ...] = (32, 64, 96),
        blocks: int = 1,
        fine: int = 16,
        embedding: int = 64,
    ):
        if not widths or min(*widths, blocks, fine, channels, 2) < 1:
            raise ValueError(
                f"widths {widths}, blocks {blocks}, fine {fine}: every one must be 1 or more"
            )
        keys = iter(jax.random.split(key, 8 + len(widths) * (2 * blocks + 2)))
        self.channels = channels
        self.stride = 2 ** len(widths)
        self.embedding = LevelEmbedding(embedding, next(keys))
        self.fine_in = new_conv(channels, fine, next(keys))
        self.coarse_in = new_conv(4 * channels, widths[0], next(keys))
        steps = list(zip(widths[:-1], widths[1:]))
        self.down = [[Block(w, embedding, next(keys)) for _ in range(blocks)] for w in widths]
        self.shrink = [new_conv(4 * a, b, next(keys), side=1) for a, b in steps]
        self.middle = Block(widths[-1], embedding, next(keys))
        self.grow = [new_conv(b, 4 * a, next(keys), side=1) for a, b in steps]
        self.up = [[Block(w, embedding, next(keys)) for _ in range(blocks)] for w in widths[:-1]]
        self.coarse_out = new_conv(widths[0], 4 * fine, next(keys), side=1)
        self.fine_block = Block(fine, embedding, next(keys))
        self.fine_out = new_conv(fine, channels, next(keys), gain=1e-2)

    def __call__(self, x: jax.Array, log_level: jax.Array) -> jax.Array:
        """The network's raw output; preconditioning is in denoiser.py."""
        level = self.embedding(log_level)
        fine = self.fine_in(x)
        h, skips = self._shrunk(x, level)
        for i in reversed(range(len(self.grow))):
            h = skips[i] + scatter_pixels(self.grow[i](h))
            h = _through(self.up[i], h, level)
        fine = fine + scatter_pixels(self.coarse_out(jax.nn.silu(h)))
        return self.fine_out(jax.nn.silu(self.fine_block(fine, level)))

    def bottleneck(self, x: jax.Array, log_level: jax.Array) -> jax.Array:
        """Features of the coarsest level, (h / stride, w / stride, its width)."""
        return self._shrunk(x, self.embedding(log_level))[0]

    def _shrunk(self, x: jax.Array, level: jax.Array) -> tuple[jax.Array, list[jax.Array]]:
        """Those features, and what is handed over on the way down."""
        h, skips = self.coarse_in(gather_pixels(x)), []
        for i, blocks in enumerate(self.down):
            h = _through(blocks, h, level)
            if i < len(self.shrink):
                skips.append(h)
                h = self.shrink[i](gather_pixels(h))
        return self.middle(h, level), skips


class Block(eqx.Module):
    """x + conv(silu(scale, shift(conv(silu(x))))), scale and shift given by the noise level."""

    first: Conv
    second: Conv
    modulation: Linear

    def __init__(self, width: int, embedding: int, key: jax.Array):
        keys = jax.random.split(key, 3)
        self.first = new_conv(width, width, keys[0], gain=2.0)
        # A small start of the branch lets many blocks follow each other without normalisation.
        self.second = new_conv(width, width, keys[1], gain=0.1)
        self.modulation = Linear(embedding, 2 * width, keys[2], gain=1e-2)

    def __call__(self, x: jax.Array, level: jax.Array) -> jax.Array:
        """(h, w, width) -> the same shape."""
        scale, shift = jnp.split(self.modulation(level), 2)
        h = self.first(jax.nn.silu(x)) * (1 + scale) + shift
        return x + self.second(jax.nn.silu(h))


def _through(blocks: list[Block], h: jax.Array, level: jax.Array) -> jax.Array:
    for block in blocks:
        h = block(h, level)
    return h
