"""What a training minimises: errors of pixels, and of averages that pixels hardly tell.

The mean square of errors hardly sees one that n pixels share, being 1 / n of it, where data know
their average n times as well as a pixel. E[error | input] = 0 minimises the square of any weighted
sum of errors whose weights follow from the input, so that adding such squares moves no minimum.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from .perturbation import folded_score


class CoarseErrors(NamedTuple):
    """Weights beside errors of pixels: `averages` of `block_errors`, `areas` of
    `equally_bright_errors`, both times the `share` of a level.
    """

    averages: float = 0.0
    areas: float = 0.0
    share: float | jax.Array = 1.0


PIXELS_ALONE = CoarseErrors()


def block_errors(error: jax.Array) -> jax.Array:
    """Mean squares of averages of errors (h, w, channels), summed over kinds of averages.

    Of the whole patch and of squares of 2, 4, 8, ... pixels a side that fill it, each average in
    units of the sd that independent errors of 1 would give it.
    """
    h, w, channels = error.shape
    total = jnp.zeros((), error.dtype)
    sides = [2**k for k in range(1, 16) if h % 2**k == w % 2**k == 0 and 2**k < max(h, w)]
    for rows, columns in [*((side, side) for side in sides), (h, w)]:
        blocks = error.reshape(h // rows, rows, w // columns, columns, channels).mean((1, 3))
        total += rows * columns * jnp.mean(jnp.square(blocks))
    return total


def equally_bright_errors(error: jax.Array, shade: jax.Array) -> jax.Array:
    """As `block_errors`, over pixels that are about equally bright in `shade` (h, w, channels).

    In the order of brightness they are averaged by 16 and by 64, where these divide their number. A
    rim that is everywhere a little too bright is such an error: no pixel is wrong for it and no
    square, but the area above a threshold is. `shade` must follow from the input alone.
    """
    h, w, channels = error.shape
    ordered = error.reshape(h * w, channels)[jnp.argsort(shade.mean(-1).reshape(-1))]
    total = jnp.zeros((), error.dtype)
    for length in (16, 64):
        if h * w % length == 0:
            runs = ordered.reshape(h * w // length, length, channels).mean(1)
            total += length * jnp.mean(jnp.square(runs))
    return total


def _squared(
    error: jax.Array, of_equals: jax.Array, denoised: jax.Array, coarse: CoarseErrors
) -> jax.Array:
    """Errors of pixels and `coarse` ones, those that are asked for; `of_equals`: errors in units
    that are the same for equally bright pixels.
    """
    total = jnp.mean(jnp.square(error))
    if coarse.averages:
        total += coarse.averages * coarse.share * block_errors(error)
    if coarse.areas:
        shade = jax.lax.stop_gradient(denoised)
        total += coarse.areas * coarse.share * equally_bright_errors(of_equals, shade)
    return total


def denoising_loss(
    denoised: jax.Array, clean: jax.Array, perturbation: str, coarse: CoarseErrors = PIXELS_ALONE
) -> jax.Array:
    """Mean squared error, with `coarse` ones if asked for; for "signal" of pixels alone, over their
    clean value (at or above the floor): what minimises it is a harmonic mean, which averages of
    errors would move.
    """
    error = denoised - clean
    if perturbation == "signal":
        return jnp.mean(jnp.square(error) / clean)
    return _squared(error, error, denoised, coarse)


def count_loss(
    denoised: jax.Array,
    clean: jax.Array,
    z: jax.Array,
    sigma: jax.Array,
    mean: float,
    coarse: CoarseErrors = PIXELS_ALONE,
) -> jax.Array:
    """Errors over 2 sqrt(z), as of square roots, squared: E[clean | z] minimises it.

    The weight has a floor between sigma^2, one count, and the pictures' mean. It depends on the
    perturbed z alone: one that looked at the clean picture would move the minimum. Among pixels
    that are equally bright it is of what is denoised, which also follows from z, so that those with
    more counts do not weigh less.
    """
    floor = sigma**2 * mean / (sigma**2 + mean)
    error = denoised - clean
    of_pixels = error / (2 * jnp.sqrt(z + floor))
    of_equals = error / (2 * jnp.sqrt(jax.lax.stop_gradient(denoised) + floor))
    return _squared(of_pixels, of_equals, denoised, coarse)


def signal_score_loss(
    score: jax.Array, clean: jax.Array, x: jax.Array, sigma: jax.Array, floor: float
) -> jax.Array:
    """eq:DNN_poisson, folded, in units of the error, for scores that come from an energy.

    The weight depends on the perturbed `x` >= 0 alone: one that looked at the clean picture would
    move the minimum.
    """
    target = folded_score(x, clean, sigma)
    return jnp.mean(sigma**2 * jnp.maximum(x, floor) * jnp.square(score - target))
