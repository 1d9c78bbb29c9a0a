"""Training pictures of any sizes as one array, from which compiled code cuts random patches."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

# What patches may be turned by: nothing, left and right, or all eight symmetries of a square.
SYMMETRIES = ("none", "mirror", "square")


class Pictures(eqx.Module):
    """Pictures (h, w, channels), real, of one number of channels, as a single device array."""

    values: jax.Array
    offsets: jax.Array
    heights: jax.Array
    widths: jax.Array

    def __init__(self, pictures: Sequence[np.ndarray]):
        if not pictures:
            raise ValueError("no pictures: give at least one")
        channels = {p.shape[2:] for p in pictures}
        if len(channels) != 1 or any(p.ndim != 3 for p in pictures):
            raise ValueError(
                f"pictures of shapes {sorted({p.shape for p in pictures})}: mixed kinds"
            )
        sizes = [p.shape[0] * p.shape[1] for p in pictures]
        if sum(sizes) >= 2**31:
            raise ValueError(f"{sum(sizes)} pixels in all: at most {2**31 - 1} can be held")
        flat = [np.asarray(p, np.float32).reshape(-1, p.shape[2]) for p in pictures]
        self.values = jnp.asarray(np.concatenate(flat))
        self.offsets = jnp.asarray(np.cumsum([0, *sizes[:-1]]), jnp.int32)
        self.heights = jnp.asarray([p.shape[0] for p in pictures], jnp.int32)
        self.widths = jnp.asarray([p.shape[1] for p in pictures], jnp.int32)

    def patch(self, key: jax.Array, size: int, symmetry: str = "square") -> jax.Array:
        """A random patch (size, size, channels) under a random one of the symmetries.

        Every place in every picture is equally likely; all sides must be at least `size`.
        """
        key_picture, key_place, key_flip = jax.random.split(key, 3)
        free_rows, free_columns = self.heights - size + 1, self.widths - size + 1
        places = (free_rows * free_columns).astype(jnp.float32)
        i = jax.random.categorical(key_picture, jnp.log(places))
        place = jax.random.uniform(key_place, (2,))
        top = jnp.minimum((place[0] * free_rows[i]).astype(jnp.int32), free_rows[i] - 1)
        left = jnp.minimum((place[1] * free_columns[i]).astype(jnp.int32), free_columns[i] - 1)
        rows, columns = _turned(key_flip, size, symmetry)
        return self.values[self.offsets[i] + (top + rows) * self.widths[i] + left + columns]


def _turned(key: jax.Array, size: int, symmetry: str) -> tuple[jax.Array, jax.Array]:
    """Row and column of every pixel of a patch, under a random one of the symmetries."""
    whole, half = symmetry == "square", symmetry != "none"
    turned = jax.random.bernoulli(key, shape=(3,))
    flip_rows, flip_columns, transpose = turned & jnp.array([whole, half, whole])
    index = jnp.arange(size)
    rows = jnp.where(flip_rows, index[::-1], index)[:, None]
    columns = jnp.where(flip_columns, index[::-1], index)[None, :]
    rows, columns = jnp.broadcast_arrays(rows, columns)
    return jnp.where(transpose, rows.T, rows), jnp.where(transpose, columns.T, columns)
