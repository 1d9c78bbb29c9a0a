"""The paper's network: NCSNv2 (Song and Ermon 2020), a RefineNet over dilated residual blocks.

Four stages of residual blocks, the first at full resolution, the second at half of it, the third
and fourth dilated instead of shrunk; four refinement blocks gather them from coarse to fine. All
normalisation is "instance norm++", which adds back the means of the channels that plain instance
normalisation forgets. The original divides its output by sigma; here preconditioning does that
(denoiser.py), and the norms are scaled and shifted by the noise level, as in the first NCSN.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .layers import Conv, LevelEmbedding, Linear, mean_pool, new_conv


class NCSNv2(eqx.Module):
    """(h, w, channels) and a log noise level -> (h, w, channels).

    `width`: channels of the first stage, doubled after it; `blocks`: residual blocks a stage.
    Sides must be multiples of `stride` = 2.
    """

    embedding: LevelEmbedding
    first: Conv
    stages: list[list["ResidualBlock"]]
    refine: list["RefineBlock"]
    norm: "InstanceNormPlus"
    last: Conv
    channels: int = eqx.field(static=True)
    stride: int = eqx.field(static=True)

    def __init__(
        self, channels: int, key: jax.Array, width: int = 64, blocks: int = 2, embedding: int = 64
    ):
        if min(channels, width, blocks) < 1:
            raise ValueError(f"width {width}, blocks {blocks}: both must be 1 or more")
        self.channels, self.stride = channels, 2
        keys = iter(jax.random.split(key, 8 + 4 * blocks))
        self.embedding = LevelEmbedding(embedding, next(keys))
        self.first = new_conv(channels, width, next(keys))
        widths, dilations = (width, 2 * width, 2 * width, 2 * width), (1, 1, 2, 4)
        self.stages, before = [], width
        for i, (after, dilation) in enumerate(zip(widths, dilations)):
            sizes = [before, *[after] * blocks]
            self.stages.append(
                [
                    ResidualBlock(a, b, embedding, dilation, i == 1 and j == 0, next(keys))
                    for j, (a, b) in enumerate(zip(sizes[:-1], sizes[1:]))
                ]
            )
            before = after
        # From the coarsest stage to the finest; each but the first also takes the one before it.
        outs = (2 * width, 2 * width, width, width)
        ins = ((2 * width,), (2 * width, outs[0]), (2 * width, outs[1]), (width, outs[2]))
        self.refine = [RefineBlock(i, o, embedding, next(keys)) for i, o in zip(ins, outs)]
        self.norm = InstanceNormPlus(width, embedding, next(keys))
        self.last = new_conv(width, channels, next(keys), gain=1e-2)

    def __call__(self, x: jax.Array, log_level: jax.Array) -> jax.Array:
        """The network's raw output; preconditioning is in denoiser.py."""
        level = self.embedding(log_level)
        h, found = self.first(x), []
        for stage in self.stages:
            for block in stage:
                h = block(h, level)
            found.append(h)
        h = self.refine[0]([found[3]], level)
        for block, skip in zip(self.refine[1:], reversed(found[:3])):
            h = block([skip, h], level)
        return self.last(jax.nn.elu(self.norm(h, level)))


class InstanceNormPlus(eqx.Module):
    """Each channel to mean 0 and variance 1 over the image, plus its mean standardised over the
    channels; then scaled and shifted by the noise level.
    """

    kept: jax.Array
    modulation: Linear

    def __init__(self, width: int, embedding: int, key: jax.Array):
        self.kept = jnp.ones(width, jnp.float32)
        self.modulation = Linear(embedding, 2 * width, key, gain=1e-2)

    def __call__(self, x: jax.Array, level: jax.Array) -> jax.Array:
        """(h, w, width) -> the same shape."""
        means = jnp.mean(x, axis=(0, 1))
        plain = (x - means) * lax.rsqrt(jnp.var(x, axis=(0, 1)) + 1e-5)
        standard = (means - jnp.mean(means)) * lax.rsqrt(jnp.var(means) + 1e-5)
        scale, shift = jnp.split(self.modulation(level), 2)
        return (plain + self.kept * standard) * (1 + scale) + shift


class ResidualBlock(eqx.Module):
    """Two normalised convolutions beside a shortcut; halves the sides if `shrink`."""

    norms: list[InstanceNormPlus]
    convs: list[Conv]
    shortcut: Conv | None
    shrink: bool = eqx.field(static=True)

    def __init__(
        self,
        width_in: int,
        width_out: int,
        embedding: int,
        dilation: int,
        shrink: bool,
        key: jax.Array,
    ):
        keys = jax.random.split(key, 5)
        self.norms = [
            InstanceNormPlus(width_in, embedding, keys[0]),
            InstanceNormPlus(width_out, embedding, keys[1]),
        ]
        self.convs = [
            new_conv(width_in, width_out, keys[2], dilation=dilation, gain=2.0),
            new_conv(width_out, width_out, keys[3], dilation=dilation, gain=0.5),
        ]
        same = width_in == width_out
        self.shortcut = None if same else new_conv(width_in, width_out, keys[4], side=1)
        self.shrink = shrink

    def __call__(self, x: jax.Array, level: jax.Array) -> jax.Array:
        """(h, w, width in) -> (h, w, width out), or half the sides."""
        h = x
        for norm, conv in zip(self.norms, self.convs):
            h = conv(jax.nn.elu(norm(h, level)))
        h = h + (x if self.shortcut is None else self.shortcut(x))
        return mean_pool(h, 2, 2) if self.shrink else h


class RefineBlock(eqx.Module):
    """Adapts one or two feature maps, adds them at the finer one's size, and pools in chains."""

    adapt: list["ConvUnit"]
    merge: list[Conv]
    chain: list[Conv]
    finish: "ConvUnit"

    def __init__(self, widths_in: tuple[int, ...], width: int, embedding: int, key: jax.Array):
        keys = iter(jax.random.split(key, 2 * len(widths_in) + 3))
        self.adapt = [ConvUnit(w, embedding, next(keys)) for w in widths_in]
        self.merge = [new_conv(w, width, next(keys)) for w in widths_in]
        self.chain = [new_conv(width, width, next(keys), gain=0.5) for _ in range(2)]
        self.finish = ConvUnit(width, embedding, next(keys))

    def __call__(self, maps: list[jax.Array], level: jax.Array) -> jax.Array:
        """Feature maps, the finest first -> (h, w, width)."""
        h, w = maps[0].shape[:2]
        parts = [m(a(x, level)) for m, a, x in zip(self.merge, self.adapt, maps)]
        total = sum(jax.image.resize(p, (h, w, p.shape[-1]), "bilinear") for p in parts)
        total = path = jax.nn.elu(total)
        for conv in self.chain:
            path = conv(mean_pool(path, 5, 1))
            total = total + path
        return self.finish(total, level)


class ConvUnit(eqx.Module):
    """x + two normalised convolutions."""

    norms: list[InstanceNormPlus]
    convs: list[Conv]

    def __init__(self, width: int, embedding: int, key: jax.Array):
        keys = jax.random.split(key, 4)
        self.norms = [InstanceNormPlus(width, embedding, k) for k in keys[:2]]
        self.convs = [new_conv(width, width, k, gain=g) for k, g in zip(keys[2:], (2.0, 0.1))]

    def __call__(self, x: jax.Array, level: jax.Array) -> jax.Array:
        """(h, w, width) -> the same shape."""
        h = x
        for norm, conv in zip(self.norms, self.convs):
            h = conv(jax.nn.elu(norm(h, level)))
        return x + h
