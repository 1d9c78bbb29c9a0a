"""Optics: the linear map H from the object o to the field that the camera squares or records.

Every operator gives H o, its adjoint H^H, the norms of its rows (how much of an error on the object
reaches each measurement), and the largest eigenvalue of H^H H (how large a step a gradient method
may take). The equations cited are those of the paper, arXiv 2212.03235.
"""

import abc
import functools
import math
import operator
from collections.abc import Sequence
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

GLOBAL_PHASE = "global_phase"
CONJUGATE_FLIP = "conjugate_flip"
CIRCULAR_SHIFT = "circular_shift"

_POWER_ITERATIONS = 30
_POWER_SAFETY = 1.1
_LARGEST_NA = 1.6
_SAME_LED = 1e-6


class Optics(eqx.Module):
    """A linear map H from an object of shape `in_shape` to a field of shape `out_shape`.

    Precision follows the object: float32 and complex64 give complex64, float64 and complex128 give
    complex128 (or the real dtypes, where `real` holds and the object is real). A batch of objects
    goes through `jax.vmap`.

    A new operator defines `_apply`, `_adjoint` and `row_norms`, and `norm_squared` where it is
    known; the shape check in front of them is the same for all.

    - `real`: whether a real object gives a real field.
    - `symmetries`: transformations of the object known to leave |H o| unchanged, among
      "global_phase" (o exp(j phi)), "conjugate_flip" (conj(o) reversed along every axis) and
      "circular_shift". The list need not be complete.
    """

    in_shape: tuple[int, ...] = eqx.field(static=True)
    out_shape: tuple[int, ...] = eqx.field(static=True)
    real: bool = eqx.field(static=True, default=False, kw_only=True)
    symmetries: tuple[str, ...] = eqx.field(static=True, default=(GLOBAL_PHASE,), kw_only=True)

    @final
    def __call__(self, o: ArrayLike) -> jax.Array:
        """Field H o, of `out_shape`, for an object of `in_shape`.

        Raises ValueError if `o` has another shape, or is not float32/64 or complex64/128.
        """
        return self._apply(_checked("object", o, self.in_shape))

    @final
    def adjoint(self, field: ArrayLike) -> jax.Array:
        """H^H field, of `in_shape`, for a field of `out_shape`: <H x, y> = <x, H^H y>.

        Complex, unless `real` holds and the field is real. Raises ValueError as `__call__` does.
        """
        return self._adjoint(_checked("field", field, self.out_shape))

    @abc.abstractmethod
    def _apply(self, o: jax.Array) -> jax.Array: ...

    @abc.abstractmethod
    def _adjoint(self, field: jax.Array) -> jax.Array: ...

    @abc.abstractmethod
    def row_norms(self) -> jax.Array:
        """||h_i|| of each row h_i of H, exact: real, of `out_shape`, in JAX's default float."""

    def norm_squared(self) -> jax.Array:
        """Upper bound on the largest eigenvalue of H^H H: a real scalar in JAX's default float.

        Exact in every operator of this module. This default, for an operator that knows no closed
        form, is an estimate and no proof: 30 power iterations from a random object (Golub and Van
        Loan, Matrix Computations, 7.3.1), which approach from below, times 1.1.
        """
        start = jax.random.normal(jax.random.key(0), self.in_shape, complex)

        def iterate(_: int, v: jax.Array) -> jax.Array:
            return self.adjoint(self(v / jnp.linalg.norm(v).astype(v.dtype)))

        v = jax.lax.fori_loop(0, _POWER_ITERATIONS, iterate, start)
        return _POWER_SAFETY * jnp.linalg.norm(v)


@final
class Identity(Optics):
    """H = I: the object is recorded as it is (denoising; paper, Eq. poisson).

    `shape`: of the object and of the field. Raises ValueError for a bad shape.
    """

    def __init__(self, shape: Sequence[int]):
        self.in_shape = self.out_shape = _shape("shape", shape)
        self.real = True

    def _apply(self, o: jax.Array) -> jax.Array:
        return o

    def _adjoint(self, field: jax.Array) -> jax.Array:
        return field

    def row_norms(self) -> jax.Array:
        """Ones, of the object's shape."""
        return jnp.ones(self.out_shape)

    def norm_squared(self) -> jax.Array:
        """1, exact."""
        return jnp.ones(())


@final
class Fourier(Optics):
    """Far field: the unitary Fourier transform of the zero-padded object (phase retrieval).

    The H of the paper's Eq. non_linear_transorm with H = F. The zero frequency is at index 0 of the
    field; the object lies at the start of the padded array.

    - `shape`: of the object, any number of axes.
    - `oversampling`: integer >= 1; each axis of the field is that many times longer.
    - `support`: boolean mask of `shape`, outside which the object counts as zero.

    |H o| is always blind to a global phase; to the conjugate flip inside the object's box, unless
    the support changes in it; to a circular shift, if nothing bounds the object. Raises ValueError
    for a bad shape, oversampling or support.
    """

    support: jax.Array | None

    def __init__(
        self, shape: Sequence[int], oversampling: int = 1, support: ArrayLike | None = None
    ):
        self.in_shape = _shape("shape", shape)
        factor = _count("oversampling", oversampling)
        self.out_shape = tuple(factor * n for n in self.in_shape)
        mask = np.ones(self.in_shape, bool) if support is None else _support(support, self.in_shape)
        self.support = None if support is None else jnp.asarray(mask)
        unbounded = factor == 1 and mask.all()
        self.symmetries = (
            GLOBAL_PHASE,
            *([CONJUGATE_FLIP] if np.array_equal(mask, np.flip(mask)) else []),
            *([CIRCULAR_SHIFT] if unbounded else []),
        )

    def _apply(self, o: jax.Array) -> jax.Array:
        return jnp.fft.fftn(self._bounded(o), s=self.out_shape, norm="ortho")

    def _adjoint(self, field: jax.Array) -> jax.Array:
        padded = jnp.fft.ifftn(field, norm="ortho")
        return self._bounded(padded[tuple(slice(n) for n in self.in_shape)])

    def _bounded(self, o: jax.Array) -> jax.Array:
        return o if self.support is None else jnp.where(self.support, o, 0)

    def row_norms(self) -> jax.Array:
        """sqrt(pixels in the support / pixels of the padded array), everywhere."""
        inside = math.prod(self.in_shape) if self.support is None else jnp.sum(self.support)
        return jnp.ones(self.out_shape) * jnp.sqrt(inside / math.prod(self.out_shape))

    def norm_squared(self) -> jax.Array:
        """1, exact: the transform is unitary and the padding keeps the norm."""
        return jnp.ones(())


@final
class FourierPtychography(Optics):
    """A microscope that records low-resolution fields, each from another part of the spectrum.

    H_m o = sqrt(n_low / n_high) F^-1[ pupil * crop_m(F o) ], the paper's Eq. ptychography, with
    unitary transforms on n_high pixels (object) and n_low pixels (camera): a plane wave of unit
    amplitude that the pupil lets through gives a field of unit amplitude. The irradiance rho, one
    number or one for each LED, belongs to `IntensityLikelihood`.

    - `shape`: (h, w) of the high-resolution object.
    - `centres`: (M, 2) integers, the (row, column) frequency at the middle of each crop, in Fourier
      samples of the object. A new array of the same length does not recompile.
    - `pupil`: (n0, n1), complex, zero frequency at the middle (index n // 2), as after fftshift;
      or (M, n0, n1), one for each LED: a pupil moved by the fraction of a sample that its centre
      was rounded by leaves no rounding (models/pupil.py).
    - `rim`: (2,) camera pixels on each side of the field that are not recorded. The transforms are
      periodic, a specimen is not: what lies just outside shines into the images, and the rim holds
      it.

    The field has shape (M, n0 - 2 rim, n1 - 2 rim). Raises ValueError for arrays of the wrong shape
    or type, a rim that leaves nothing, and where the support of the pupil around a centre leaves
    the band of the object.

    Approximations: a thin object, coherent light from each LED, one pupil for the whole field of
    view, and crops on whole Fourier samples. With P(k - k_m) on F o, the centre lies on the side of
    the LED: light that travels along direction s has its centre at -s.
    """

    centres: jax.Array
    pupil: jax.Array
    largest: jax.Array
    rim: tuple[int, int] = eqx.field(static=True)

    def __init__(
        self,
        shape: Sequence[int],
        centres: ArrayLike,
        pupil: ArrayLike,
        rim: Sequence[int] = (0, 0),
    ):
        self.in_shape = _plane(shape)
        centres, pupil = _centres(centres), _pupil(pupil, len(np.asarray(centres)))
        _check_band(self.in_shape, centres, pupil)
        self.rim = _rim(rim, pupil.shape[-2:])
        recorded = (n - 2 * r for n, r in zip(pupil.shape[-2:], self.rim))
        self.out_shape = (len(centres), *recorded)
        self.centres = jnp.asarray(centres)
        self.pupil = jnp.asarray(pupil + 0j)
        # Found once, here: a sampler asks for it at every step.
        gain = math.prod(pupil.shape[-2:]) / math.prod(self.in_shape)
        self.largest = jnp.asarray(_transmission(self.in_shape, centres, pupil).max() * gain)

    @classmethod
    def from_radius(
        cls,
        shape: Sequence[int],
        centres: ArrayLike,
        radius: float,
        upsampling: int,
    ) -> "FourierPtychography":
        """With a plain disc for a pupil.

        - `radius`: of the disc, in Fourier samples, at most half the low-resolution width.
        - `upsampling`: integer, object pixels per camera pixel along an axis; divides `shape`.

        Raises ValueError as the constructor does, for a bad radius or upsampling, and for a centre
        that is there twice.
        """
        low = _low_shape(_plane(shape), upsampling)
        refuse_same_direction(_centres(centres))
        if _positive("radius", radius) > min(low) / 2:
            raise ValueError(
                f"radius {radius} leaves the band of the low-resolution shape {low}; "
                f"use at most {min(low) / 2}, or a smaller upsampling."
            )
        return cls(shape, centres, _disc(low, (radius, radius)))

    @classmethod
    def from_microscope(
        cls,
        shape: Sequence[int],
        *,
        upsampling: int,
        na: float,
        wavelength: float,
        pixel_size: float,
        led_na: ArrayLike | None = None,
        led_positions: ArrayLike | None = None,
        led_height: float | None = None,
        aberration: ArrayLike | None = None,
    ) -> "FourierPtychography":
        """From the numbers of a microscope, lengths in metres.

        - `shape`: (h, w) of the object, `upsampling` times that of a camera image.
        - `na`: numerical aperture of the objective, below 1.6.
        - `wavelength`: in vacuum.
        - `pixel_size`: camera pixel / magnification, the pixel of the low-resolution image.
        - `led_na`: (M, 2), the sines (row, column) of the directions in which the object sees the
          LEDs, times the refractive index; or `led_positions`: (M, 2) metres from the optical axis,
          with `led_height`: metres from the object to the LED plane, in air. Both along the axes of
          the object: where the camera turns the image over, pass the negative.
        - `aberration`: (n0, n1) phase of the pupil, radians, zero frequency at the middle.

        A Fourier sample is 1 / (field of view) wide, so the pupil is the disc |k| <= na /
        wavelength, and each centre is led_na / wavelength rounded to the nearest sample: an
        approximation, wrong by up to half a sample. LED positions count from the middle of the
        field of view (Zheng, Horstmeyer and Yang, Nature Photonics 7, 739, 2013).

        Raises ValueError for values that are not physical, a pixel too large for the aperture,
        LEDs beyond the band of the object, or an LED that is there twice.
        """
        low = _low_shape(_plane(shape), upsampling)
        check_aperture(na, _positive("wavelength", wavelength), _positive("pixel_size", pixel_size))
        view = np.array(low) * pixel_size
        sines = _led_sines(led_na, led_positions, led_height)
        refuse_same_direction(sines)
        centres = np.rint(sines / wavelength * view).astype(int)
        pupil = _disc(low, na / wavelength * view)
        needed = int(np.max(np.ceil(_needed_shape(centres, pupil) / np.array(low))))
        if needed > upsampling:
            raise ValueError(
                f"LEDs leave the band of the object at upsampling {upsampling}; use upsampling "
                f"{needed} (shape {tuple(needed * n for n in low)}), or leave out the outer LEDs."
            )
        if aberration is not None:
            pupil = pupil * np.exp(1j * _array("aberration", aberration, shape=low, real=True))
        return cls(shape, centres, pupil)

    @property
    def low_shape(self) -> tuple[int, int]:
        """(n0, n1) camera pixels, those of the rim among them."""
        return self.pupil.shape[-2:]

    @property
    def field_of_view(self) -> tuple[slice, slice]:
        """Where in the object what is recorded lies."""
        borders = (r * h // n for r, h, n in zip(self.rim, self.in_shape, self.low_shape))
        return tuple(slice(b, h - b) for b, h in zip(borders, self.in_shape))

    def frequencies(self) -> int:
        """How many frequencies of the object reach the camera, by a tenth of a pupil's power."""
        pupil = np.asarray(self.pupil)
        total = _transmission(self.in_shape, np.asarray(self.centres), pupil)
        return int(np.count_nonzero(total > 0.1 * np.abs(pupil).max() ** 2))

    def _apply(self, o: jax.Array) -> jax.Array:
        spectrum = jnp.fft.fftshift(jnp.fft.fftn(o, norm="ortho"))
        low = self.low_shape
        spectrum = jnp.pad(spectrum, [(n, n) for n in low])
        crop = functools.partial(jax.lax.dynamic_slice, spectrum, slice_sizes=low)
        passed = jax.vmap(crop)(self._corners()) * self._gained_pupil(o)
        field = jnp.fft.ifftn(passed, axes=(1, 2), norm="ortho") * self._recentring(o)
        (top, left), (n0, n1) = self.rim, low
        return field[:, top : n0 - top, left : n1 - left]

    def _adjoint(self, field: jax.Array) -> jax.Array:
        field = jnp.pad(field.astype(_complex_dtype(field)), [(0, 0), *((r, r) for r in self.rim)])
        field = field * self._recentring(field).conj()
        spectra = jnp.fft.fftn(field, axes=(1, 2), norm="ortho")
        spectrum = self._overlap_add(spectra * self._gained_pupil(field).conj())
        return jnp.fft.ifftn(jnp.fft.ifftshift(spectrum), norm="ortho")

    def _gained_pupil(self, o: jax.Array) -> jax.Array:
        """sqrt(n_low / n_high) pupil, shape (1 or M, n0, n1), in the precision of `o`."""
        gain = jnp.sqrt(math.prod(self.low_shape) / math.prod(self.in_shape))
        gained = (gain.astype(self.pupil.dtype) * self.pupil).astype(_complex_dtype(o))
        return gained.reshape(-1, *self.low_shape)

    def _recentring(self, o: jax.Array) -> jax.Array:
        """Phase, shape (1, n0, n1), that undoes a spectrum left with its zero in the middle.

        Cheaper than an fftshift of every crop, by the shift theorem.
        """
        phases = [np.exp(-2j * np.pi * (n // 2 * np.arange(n) % n) / n) for n in self.low_shape]
        return jnp.asarray(np.multiply.outer(*phases)).astype(_complex_dtype(o))[None]

    def _corners(self) -> jax.Array:
        """First index (row, column) of each crop in the centred spectrum, padded by one crop.

        The padding is for windows that leave the band where the pupil is zero; it does not depend
        on the centres, so that new ones need no new compilation.
        """
        middle = [h // 2 - n // 2 + n for h, n in zip(self.in_shape, self.low_shape)]
        return self.centres + jnp.asarray(middle, self.centres.dtype)[None]

    def _overlap_add(self, crops: jax.Array) -> jax.Array:
        """Sum of crops (M, n0, n1), each at its place in the centred spectrum (h, w)."""
        shape = pad = self.low_shape

        def add(total: jax.Array, item: tuple) -> tuple:
            corner, crop = item
            old = jax.lax.dynamic_slice(total, corner, shape)
            return jax.lax.dynamic_update_slice(total, old + crop, corner), None

        padded = jnp.zeros([h + 2 * n for h, n in zip(self.in_shape, pad)], crops.dtype)
        total, _ = jax.lax.scan(add, padded, (self._corners(), crops))
        return total[pad[0] : -pad[0], pad[1] : -pad[1]]

    def row_norms(self) -> jax.Array:
        """sqrt(sum |pupil|^2 / n_high), everywhere in the field of an LED."""
        power = jnp.sum(jnp.abs(self.pupil) ** 2, axis=(-2, -1)).reshape(-1, 1, 1)
        return jnp.ones(self.out_shape) * jnp.sqrt(power / math.prod(self.in_shape))

    def norm_squared(self) -> jax.Array:
        """Largest value of sum_m |sqrt(n_low / n_high) pupil(k - k_m)|^2.

        Exact without a rim, else a bound from above.
        """
        return self.largest


@final
class CodedDiffraction(Optics):
    """Far fields of the object behind one mask after another: field_m = F (mask_m o), F unitary.

    Candes, Li and Soltanolkotabi, Applied and Computational Harmonic Analysis 39, 277 (2015).

    `masks`: (M, *shape), real or complex. The field has the same shape. Raises ValueError for masks
    without an object axis, not finite, or zero everywhere.
    """

    masks: jax.Array

    def __init__(self, masks: ArrayLike):
        masks = _filter_array("masks", masks)
        if masks.ndim < 2:
            raise ValueError(f"masks must have shape (M, *object shape), got {masks.shape}.")
        self.in_shape, self.out_shape = masks.shape[1:], masks.shape
        self.masks = jnp.asarray(masks)

    def _apply(self, o: jax.Array) -> jax.Array:
        masks = self.masks.astype(_complex_dtype(o))
        return jnp.fft.fftn(masks * o[None].astype(masks.dtype), axes=self._axes, norm="ortho")

    def _adjoint(self, field: jax.Array) -> jax.Array:
        behind = jnp.fft.ifftn(field, axes=self._axes, norm="ortho")
        return jnp.sum(self.masks.conj().astype(behind.dtype) * behind, axis=0)

    @property
    def _axes(self) -> tuple[int, ...]:
        return tuple(range(1, len(self.out_shape)))

    def row_norms(self) -> jax.Array:
        """sqrt(mean |mask_m|^2), the same for every pixel of field m."""
        norms = jnp.sqrt(jnp.mean(jnp.abs(self.masks) ** 2, axis=self._axes, keepdims=True))
        return jnp.broadcast_to(norms, self.out_shape)

    def norm_squared(self) -> jax.Array:
        """Largest value of sum_m |mask_m|^2 over the pixels, exact."""
        return jnp.max(jnp.sum(jnp.abs(self.masks) ** 2, axis=0))


@final
class Propagation(Optics):
    """Free-space propagation by the angular spectrum.

    Goodman, Introduction to Fourier Optics, 3.10:
    H o = F^-1[ T F o ], T(f) = exp(2 pi j distance sqrt(1/wavelength^2 - |f|^2)).

    - `shape`: of the object and of the field, one or two axes.
    - `wavelength`, `pixel_size`, `distance`: metres, in the medium; a negative distance goes back.

    Approximations: evanescent waves (|f| > 1/wavelength) are dropped; the boundary is periodic, so
    light that leaves one side comes back at the other: leave a margin around the object of distance
    times the tangent of its steepest ray. Raises ValueError for lengths that are not physical.
    """

    transfer: jax.Array

    def __init__(self, shape: Sequence[int], wavelength: float, pixel_size: float, distance: float):
        self.in_shape = self.out_shape = _shape("shape", shape)
        if len(self.in_shape) > 2:
            raise ValueError(f"shape must have one or two axes, got {self.in_shape}.")
        _positive("wavelength", wavelength)
        _positive("pixel_size", pixel_size)
        _real_number("distance", distance)
        # In float64 whatever JAX's precision: the phase is thousands of turns.
        frequencies = [np.fft.fftfreq(n, pixel_size) ** 2 for n in self.in_shape]
        along = wavelength**-2 - functools.reduce(np.add.outer, frequencies)
        phase = 2 * np.pi * distance * np.sqrt(np.maximum(along, 0))
        self.transfer = jnp.asarray(np.where(along >= 0, np.exp(1j * phase), 0))

    def _apply(self, o: jax.Array) -> jax.Array:
        return _filtered(o.astype(_complex_dtype(o)), self.transfer)

    def _adjoint(self, field: jax.Array) -> jax.Array:
        return _filtered(field.astype(_complex_dtype(field)), self.transfer.conj())

    def row_norms(self) -> jax.Array:
        """sqrt(mean |T|^2), everywhere: the part of the frequencies that propagate."""
        return _filter_row_norms(self.transfer)

    def norm_squared(self) -> jax.Array:
        """1, exact: the zero frequency always propagates."""
        return jnp.ones(())


@final
class Blur(Optics):
    """Circular convolution with a real point-spread function: incoherent imaging.

    - `shape`: of the object and of the field.
    - `psf`: real, as many axes; along each either an odd length or the full one. Its middle, index
      n // 2, is the pixel that stays in place.

    Approximation: the boundary is periodic. Raises ValueError for a psf of the wrong shape, not
    real, not finite or zero everywhere.
    """

    transfer: jax.Array

    def __init__(self, shape: Sequence[int], psf: ArrayLike):
        self.in_shape = self.out_shape = _shape("shape", shape)
        psf = _filter_array("psf", psf, ndim=len(self.in_shape), real=True)
        if any(k > n or (k % 2 == 0 and k != n) for k, n in zip(psf.shape, self.in_shape)):
            raise ValueError(
                f"psf has shape {psf.shape}; each axis must be odd and no longer than the object's "
                f"{self.in_shape}, or equal to it: crop the psf, or pad it with zeros."
            )
        padded = np.pad(psf, [(0, n - k) for k, n in zip(psf.shape, self.in_shape)])
        centred = np.roll(padded, [-(k // 2) for k in psf.shape], range(psf.ndim))
        self.transfer = jnp.asarray(np.fft.fftn(centred))
        self.real = True

    def _apply(self, o: jax.Array) -> jax.Array:
        return _filtered(o, self.transfer)

    def _adjoint(self, field: jax.Array) -> jax.Array:
        return _filtered(field, self.transfer.conj())

    def row_norms(self) -> jax.Array:
        """||psf||, everywhere."""
        return _filter_row_norms(self.transfer)

    def norm_squared(self) -> jax.Array:
        """Largest |F psf|^2, exact; (sum psf)^2 for a psf without negative values."""
        return jnp.max(jnp.abs(self.transfer) ** 2)


@final
class Matrix(Optics):
    """Any H, written out.

    - `matrix`: (m, d), real or complex.
    - `in_shape`: of the object, of d elements; (d,) if not given.

    The field has shape (m,). Raises ValueError for a matrix of the wrong shape, not finite or zero
    everywhere, or if `in_shape` does not hold d elements.
    """

    matrix: jax.Array

    def __init__(self, matrix: ArrayLike, in_shape: Sequence[int] | None = None):
        matrix = _filter_array("matrix", matrix, ndim=2)
        m, d = matrix.shape
        self.in_shape = (d,) if in_shape is None else _shape("in_shape", in_shape)
        if math.prod(self.in_shape) != d:
            raise ValueError(
                f"in_shape {self.in_shape} holds {math.prod(self.in_shape)} elements, but a matrix "
                f"of shape {matrix.shape} takes {d}."
            )
        self.out_shape = (m,)
        self.matrix = jnp.asarray(matrix)
        self.real = not np.iscomplexobj(matrix)

    def _apply(self, o: jax.Array) -> jax.Array:
        return _product(self.matrix, o.ravel())

    def _adjoint(self, field: jax.Array) -> jax.Array:
        return _product(self.matrix.conj().T, field).reshape(self.in_shape)

    def row_norms(self) -> jax.Array:
        """Norm of each row of the matrix."""
        return jnp.linalg.norm(self.matrix, axis=1)

    def norm_squared(self) -> jax.Array:
        """Largest eigenvalue of the smaller of H^H H and H H^H, exact; O(m d min(m, d))."""
        m, d = self.matrix.shape
        h = self.matrix if m <= d else self.matrix.conj().T
        return jnp.linalg.eigvalsh(_product(h, h.conj().T))[-1]


def _complex_dtype(o: jax.Array) -> np.dtype:
    return jnp.complex128 if jnp.finfo(o.dtype).bits == 64 else jnp.complex64


def _product(a: jax.Array, b: jax.Array) -> jax.Array:
    """a @ b in the precision of `b`, without the reduced precision that is a GPU's default."""
    both_real = not (jnp.iscomplexobj(a) or jnp.iscomplexobj(b))
    dtype = b.dtype if both_real else _complex_dtype(b)
    return jnp.matmul(a.astype(dtype), b.astype(dtype), precision=jax.lax.Precision.HIGHEST)


def _filtered(o: jax.Array, transfer: jax.Array) -> jax.Array:
    """F^-1[transfer F o]; a real `o` stands for a transfer that keeps it real."""
    transfer = transfer.astype(_complex_dtype(o))
    if jnp.iscomplexobj(o):
        return jnp.fft.ifftn(transfer * jnp.fft.fftn(o))
    half = transfer[..., : o.shape[-1] // 2 + 1]
    return jnp.fft.irfftn(half * jnp.fft.rfftn(o), s=o.shape)


def _filter_row_norms(transfer: jax.Array) -> jax.Array:
    """Norm of the impulse response, by Parseval, for every pixel."""
    return jnp.ones(transfer.shape) * jnp.sqrt(jnp.mean(jnp.abs(transfer) ** 2))


def _disc(shape: tuple[int, int], radii: Sequence[float]) -> np.ndarray:
    """1 inside the centred ellipse of these semi-axes in samples, 0 outside."""
    axes = [((np.arange(n) - n // 2) / r) ** 2 for n, r in zip(shape, radii)]
    return (np.add.outer(*axes) <= 1).astype(float)


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> jax.Array:
    value = jnp.asarray(value)
    if value.shape != shape:
        raise ValueError(
            f"{name} has shape {value.shape}, but these optics take {shape}; "
            "reshape it, or use jax.vmap for a batch."
        )
    if value.dtype not in (jnp.float32, jnp.float64, jnp.complex64, jnp.complex128):
        raise ValueError(
            f"{name} has dtype {value.dtype}; convert it to float32, float64, complex64 or "
            "complex128."
        )
    return value


def _shape(name: str, shape: Sequence[int]) -> tuple[int, ...]:
    try:
        lengths = tuple(operator.index(n) for n in shape)
    except TypeError:
        lengths = ()
    if not lengths or min(lengths) < 1:
        raise ValueError(
            f"{name} must be a tuple of positive integers such as (64, 64), got {shape}."
        )
    return lengths


def _plane(shape: Sequence[int]) -> tuple[int, int]:
    shape = _shape("shape", shape)
    if len(shape) != 2:
        raise ValueError(f"shape must be (height, width), got {shape}.")
    return shape


def _count(name: str, value: int) -> int:
    if isinstance(value, bool) or not hasattr(value, "__index__") or operator.index(value) < 1:
        raise ValueError(f"{name} must be an integer of at least 1, got {value}.")
    return operator.index(value)


def _real_number(name: str, value: float) -> float:
    number = np.asarray(value)
    if number.shape != () or number.dtype.kind not in "iuf" or not np.isfinite(number):
        raise ValueError(f"{name} must be one finite real number, got {value}.")
    return float(value)


def _positive(name: str, value: float) -> float:
    if _real_number(name, value) <= 0:
        raise ValueError(f"{name} must be positive, got {value}.")
    return float(value)


def _array(
    name: str,
    value: ArrayLike,
    *,
    ndim: int | None = None,
    shape: tuple[int, ...] | None = None,
    real: bool = False,
) -> np.ndarray:
    """A concrete, finite array in double precision."""
    array = np.asarray(value)
    if array.dtype.kind not in ("biuf" if real else "biufc"):
        wanted = "real" if real else "real or complex"
        raise ValueError(f"{name} must hold {wanted} numbers, got dtype {array.dtype}.")
    if shape is not None and array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}.")
    if ndim is not None and array.ndim != ndim:
        raise ValueError(f"{name} must have {ndim} axes, got shape {array.shape}.")
    if not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} holds {array[index]} at {index}; replace what is not finite.")
    return array.astype(np.result_type(array.dtype, np.float64))


def _filter_array(name: str, value: ArrayLike, **checks: int | bool) -> np.ndarray:
    """As `_array`, and something passes through."""
    array = _array(name, value, **checks)
    if not array.any():
        raise ValueError(
            f"{name} of shape {array.shape} is 0 everywhere; give one that passes light."
        )
    return array


def _support(support: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    mask = np.asarray(support)
    if mask.shape != shape or mask.dtype != bool:
        raise ValueError(
            f"support must be a boolean mask of shape {shape}, got {mask.dtype} of {mask.shape}; "
            "compare it with a threshold."
        )
    if not mask.any():
        raise ValueError(f"support is False everywhere (shape {shape}); mark at least one pixel.")
    return mask


def _centres(centres: ArrayLike) -> np.ndarray:
    array = np.asarray(centres)
    if array.ndim != 2 or array.shape[1] != 2 or len(array) == 0:
        raise ValueError(f"centres must have shape (M, 2), got {array.shape}.")
    if array.dtype.kind not in "iu":
        raise ValueError(
            f"centres must be integers, got dtype {array.dtype} ({array[0].tolist()} first); "
            "round them to Fourier samples."
        )
    return array.astype(int)


def _pupil(pupil: ArrayLike, leds: int) -> np.ndarray:
    array = np.asarray(pupil)
    if array.ndim == 3 and len(array) != leds:
        raise ValueError(f"pupil has shape {array.shape}: give one for each of the {leds} LEDs")
    return _filter_array("pupil", pupil, ndim=3 if array.ndim == 3 else 2)


def _reach(centres: np.ndarray, pupil: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest frequency (M, 2) that the pupil lets through around each centre."""
    middle = np.array(pupil.shape[-2:]) // 2
    passing = [np.argwhere(p) - middle for p in (pupil != 0).reshape(-1, *pupil.shape[-2:])]
    low, high = (np.array([f(o, axis=0) for o in passing]) for f in (np.min, np.max))
    return centres + low, centres + high


def _transmission(shape: tuple[int, ...], centres: np.ndarray, pupil: np.ndarray) -> np.ndarray:
    """Power that each frequency passes on, summed over the LEDs; one crop of zeros around it."""
    low = pupil.shape[-2:]
    total = np.zeros([h + 2 * n for h, n in zip(shape, low)])
    corners = centres + [h // 2 - n // 2 + n for h, n in zip(shape, low)]
    powers = np.broadcast_to(np.abs(pupil) ** 2, (len(centres), *low))
    for (row, column), power in zip(corners, powers):
        total[row : row + low[0], column : column + low[1]] += power
    return total


def _rim(rim: Sequence[int], low: tuple[int, int]) -> tuple[int, int]:
    rim = tuple(rim)
    if len(rim) != 2 or not all(isinstance(r, int | np.integer) and r >= 0 for r in rim):
        raise ValueError(f"rim {rim}: give two whole numbers of pixels, 0 or more")
    if any(2 * r >= n for r, n in zip(rim, low)):
        raise ValueError(f"rim {rim} leaves nothing of {low} pixels: give a narrower one")
    return tuple(int(r) for r in rim)


def _needed_shape(centres: np.ndarray, pupil: np.ndarray) -> np.ndarray:
    """Smallest (h, w) whose band, -(h // 2) to (h - 1) // 2, holds every pupil."""
    low, high = _reach(centres, pupil)
    return np.maximum(-2 * low, 2 * high + 1).max(axis=0)


def _check_band(shape: tuple[int, int], centres: np.ndarray, pupil: np.ndarray) -> None:
    low, high = _reach(centres, pupil)
    size = np.array(shape)
    outside = ((low < -(size // 2)) | (high > (size - 1) // 2)).any(axis=1)
    if outside.any():
        centre = tuple(centres[outside][0].tolist())
        needed = tuple(np.maximum(size, _needed_shape(centres, pupil)).tolist())
        raise ValueError(
            f"around centre {centre} the pupil leaves the band of an object of shape {shape}; "
            f"use a shape of at least {needed}, or leave that centre out."
        )


def _low_shape(shape: tuple[int, int], upsampling: int) -> tuple[int, int]:
    factor = _count("upsampling", upsampling)
    if any(n % factor for n in shape):
        raise ValueError(f"upsampling {factor} must divide shape {shape}; pad or crop the object.")
    return tuple(n // factor for n in shape)


def check_aperture(na: float, wavelength: float, pixel_size: float) -> None:
    """Raises ValueError unless `na` can be, and pixels (metres) sample what passes it."""
    if not 0 < _real_number("na", na) < _LARGEST_NA:
        raise ValueError(f"na must lie between 0 and {_LARGEST_NA}, got {na}.")
    largest = wavelength / (2 * na)
    if pixel_size > largest * (1 + 1e-9):
        raise ValueError(
            f"pixel_size {pixel_size} m is too coarse for na {na}; use at most {largest:.6g} m "
            "(wavelength / 2 na), through a larger magnification."
        )


def _led_sines(
    led_na: ArrayLike | None, led_positions: ArrayLike | None, led_height: float | None
) -> np.ndarray:
    """Direction sines times refractive index of the LEDs, (M, 2)."""
    leds = {"led_na": led_na, "led_positions": led_positions, "led_height": led_height}
    given = [name for name, value in leds.items() if value is not None]
    if given == ["led_positions", "led_height"]:
        positions = _pairs("led_positions", led_positions)
        height = _positive("led_height", led_height)
        return positions / np.hypot(np.linalg.norm(positions, axis=1, keepdims=True), height)
    if given != ["led_na"]:
        raise ValueError(f"give either led_na, or led_positions with led_height; got {given}.")
    return checked_sines(led_na)


def checked_sines(led_na: ArrayLike) -> np.ndarray:
    """`led_na` (M, 2) in double precision; raises ValueError for what are no sines."""
    sines = _pairs("led_na", led_na)
    steepest = sines[np.argmax(np.linalg.norm(sines, axis=1))]
    if np.linalg.norm(steepest) >= _LARGEST_NA:
        raise ValueError(
            f"led_na {tuple(steepest.tolist())} is not below {_LARGEST_NA}; "
            "give sines times the refractive index, not angles."
        )
    return sines


def refuse_same_direction(leds: np.ndarray) -> None:
    """Raises ValueError for two LEDs (M, 2) in one direction: sines, or Fourier samples."""
    apart = np.linalg.norm(leds[:, None] - leds[None], axis=-1)
    twice = np.argwhere(np.triu(apart < _SAME_LED, 1))
    if len(twice):
        first, second = twice[0]
        raise ValueError(
            f"LEDs {first} and {second} are in the same direction: add their images up, or leave "
            "one out"
        )


def _pairs(name: str, value: ArrayLike) -> np.ndarray:
    array = np.asarray(value)
    if array.ndim != 2 or array.shape[1] != 2 or len(array) == 0:
        raise ValueError(f"{name} must have shape (M, 2), got {array.shape}.")
    return _array(name, array, shape=array.shape, real=True)
