"""A dear elementwise function that few pixels need, computed for these alone.

`jax.lax.cond` leaves work out, but not under `vmap`: where the predicate differs over the batch,
both branches are computed for all. A calibration batches recordings, so that the saturated pixels
of one would cost the sum for every pixel of all. Here a batch becomes more pixels of one problem.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

_BLOCK = 32  # pixels that are done together


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def where_asked(
    compute: Callable[[jax.Array], Any], otherwise: float, asked: jax.Array, x: jax.Array
) -> Any:
    """compute(x) where it is `asked` for, and the constant `otherwise` elsewhere.

    `compute`: elementwise, from an array of any shape to one of its shape and dtype, or to a tree
    of them; it must not close over arrays that are traced. `asked`: booleans of the shape of `x`.
    May be jitted, vmapped, and differentiated any number of times with respect to `x`.
    """
    return _batchable(compute, otherwise)(asked, x)


@where_asked.defjvp
def _where_asked_jvp(compute, otherwise, primals, tangents):  # noqa: ANN001
    # Value and slope by one loop, forwards: reverse mode would store every term of every sum.
    asked, x = primals

    def with_slope(x: jax.Array) -> tuple[Any, Any]:
        return jax.jvp(compute, (x,), (jnp.ones_like(x),))

    value, slope = where_asked(with_slope, otherwise, asked, x)
    return value, jax.tree.map(lambda s: jnp.where(asked, s, 0) * tangents[1], slope)


def _batchable(compute: Callable[[jax.Array], Any], otherwise: float) -> Callable:
    """The same of (asked, x), where `asked` may have length 1 along axes of `x`."""

    @jax.custom_batching.custom_vmap
    def found(asked: jax.Array, x: jax.Array) -> Any:
        return _in_blocks(compute, otherwise, asked, x)

    @found.def_vmap
    def _(size: int, batched: list[bool], asked: jax.Array, x: jax.Array) -> tuple[Any, Any]:
        asked = asked if batched[0] else asked[None]
        x = x if batched[1] else jnp.broadcast_to(x, (size, *x.shape))
        values = found(asked, x)
        return values, jax.tree.map(lambda _: True, values)

    return found


def _in_blocks(
    compute: Callable[[jax.Array], Any], otherwise: float, asked: jax.Array, x: jax.Array
) -> Any:
    """As many blocks as hold all pixels that ask, which come first."""
    if not x.ndim:
        found = _in_blocks(compute, otherwise, asked[None], x[None])
        return jax.tree.map(lambda f: f[0], found)
    shapes = jax.eval_shape(compute, x)
    blank = jax.tree.map(lambda s: jnp.full(s.shape, otherwise, s.dtype), shapes)
    if not x.size:
        return blank
    flat = asked.ravel()
    order = jnp.argsort(~flat)
    size = min(_BLOCK, flat.size)
    # The last block is filled up with the pixel that asks least.
    order = jnp.pad(order, (0, -flat.size % size), mode="edge")

    def block(number: jax.Array, values: Any) -> Any:
        chosen = jax.lax.dynamic_slice(order, (number * size,), (size,))
        # (size, 1, ...) along the axes of `asked`, all of the other axes.
        index, asks = _index(chosen, asked.shape, x.shape), flat[chosen]
        computed = compute(x[index])
        asks = asks.reshape(size, *(1,) * x.ndim)
        return jax.tree.map(
            lambda v, c: v.at[index].set(jnp.where(asks, c, otherwise)), values, computed
        )

    blocks = (jnp.sum(flat) + size - 1) // size
    return jax.lax.fori_loop(0, blocks, block, blank)


def _index(
    chosen: jax.Array, asked: tuple[int, ...], shape: tuple[int, ...]
) -> tuple[jax.Array, ...]:
    """Indices (size, ...) into an array of `shape`, of places `chosen` among those of `asked`."""
    parts = jnp.unravel_index(chosen, asked)
    whole = []
    for axis, (few, all_, part) in enumerate(zip(asked, shape, parts)):
        if few == all_:
            whole.append(part.reshape(-1, *(1,) * len(shape)))
        else:
            along = [1] * (len(shape) + 1)
            along[axis + 1] = all_
            whole.append(jnp.arange(all_).reshape(along))
    return tuple(whole)
