"""The pupil of a microscope, off the grid of Fourier samples: aberrated, and moved for each LED.

An LED in the direction s moves the spectrum of the object by s / wavelength, which is no whole
number of Fourier samples. Ptychography crops at the nearest whole one; the rest moves the pupil the
other way, and leaves the intensity as it is (the shift theorem: the field only gets a phase ramp).
"""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

# Without piston and tilts, which no intensity shows.
NOLL_FIRST = 4

_EDGE = 0.5  # samples: a disc's edge, averaged over a sample, is about so soft
_BEYOND = 1.5  # radii, where polynomials of the sixth order are no longer wanted
_PASSING = 1e-3


def pupils(
    shape: Sequence[int], radii: Sequence[float], offsets: ArrayLike, aberration: ArrayLike
) -> jax.Array:
    """Pupils (M, n0, n1), complex, the zero frequency at the middle (index n // 2).

    - `radii`: (2,) semi-axes of the disc, in Fourier samples: na / wavelength x field of view.
    - `offsets`: (M, 2) samples (row, column) by which the disc is moved.
    - `aberration`: radians rms, of Noll's Zernike polynomials from the fourth on: defocus,
      astigmatism (oblique, vertical), coma (vertical, horizontal), trefoil (vertical, oblique),
      spherical, and so on; angles run from the columns to the rows.

    The edge is soft, a logistic function of scale 0.5 samples, so that the pupil is differentiable
    in all arguments; less than 0.1 % is cut to 0. Source of the polynomials: Noll, J. Opt. Soc. Am.
    66, 207 (1976).
    """
    offsets = jnp.asarray(offsets)
    axes = [
        (jnp.arange(n) - n // 2 - offsets[:, axis, None]) / radii[axis]
        for axis, n in enumerate(shape)
    ]
    row, column = axes[0][:, :, None], axes[1][:, None, :]
    # The root of zero has no gradient.
    radius = jnp.sqrt(row**2 + column**2 + 1e-12)
    disc = jax.nn.sigmoid((1 - radius) * jnp.mean(jnp.asarray(radii)) / _EDGE)
    inside = jnp.minimum(1.0, _BEYOND / radius)
    phase = wavefront(row * inside, column * inside, aberration)
    return jnp.where(disc > _PASSING, disc, 0.0) * jnp.exp(1j * phase)


def wavefront(row: jax.Array, column: jax.Array, aberration: ArrayLike) -> jax.Array:
    """Phase (radians) at places in the pupil, in radii from its middle; `aberration` as above."""
    coefficients = jnp.asarray(aberration)
    terms = (c * _zernike(NOLL_FIRST + i, row, column) for i, c in enumerate(coefficients))
    return sum(terms, jnp.zeros_like(row * column))


def _zernike(noll: int, row: jax.Array, column: jax.Array) -> jax.Array:
    """Zernike's polynomial of an index of Noll's, of unit variance over the disc."""
    n = int((math.isqrt(8 * noll - 7) - 1) // 2)
    within = noll - n * (n + 1) // 2
    m = 2 * (within // 2) if n % 2 == 0 else 2 * ((within - 1) // 2) + 1
    square = row**2 + column**2
    radial = sum(
        (-1) ** k
        * math.comb(n - k, k)
        * math.comb(n - 2 * k, (n - m) // 2 - k)
        * square ** ((n - m) // 2 - k)
        for k in range((n - m) // 2 + 1)
    )
    angular = (column + 1j * row) ** m if m else jnp.ones(())
    part = angular.real if noll % 2 == 0 or m == 0 else angular.imag
    return math.sqrt((n + 1) * (2 if m else 1)) * radial * part
