"""Stationary Gaussian random field: an image-size prior that stays exact, by the FFT."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..realview import normal_like
from .base import Prior, check_finite, checked_shape, is_complex_kind


class GaussianField(Prior):
    """Stationary Gaussian field on a periodic grid, diagonal in Fourier space.

    `power` (shape, in the order of `np.fft.fftn`) is the variance of each coefficient of the
    unitary Fourier transform of one real component: its mean over frequencies is the variance of a
    pixel. Real fields need power(k) = power(-k). Re and Im of a complex field are independent, each
    with this spectrum. `mean` is a number or an array of `shape`. Exact at every sigma; the one
    approximation is the periodic boundary. Raises ValueError on a power that is not positive.
    """

    power: jax.Array
    mean: jax.Array
    shape: tuple[int, ...] = eqx.field(static=True)
    complex_valued: bool = eqx.field(static=True)
    perturbation: str = eqx.field(static=True, default="gaussian")

    def __init__(
        self,
        power: np.ndarray,
        mean: np.ndarray | complex = 0.0,
        shape: tuple[int, ...] | None = None,
        dtype: type = float,
    ):
        power = np.asarray(power, dtype=float)
        self.shape = checked_shape(power.shape if shape is None else shape)
        self.complex_valued = is_complex_kind(dtype)
        self.perturbation = "gaussian"
        mean = np.asarray(mean)
        check_finite(power=power, mean=mean)
        if power.shape != self.shape:
            raise ValueError(f"power of shape {power.shape}: the object has shape {self.shape}")
        if power.min() <= 0:
            raise ValueError(f"power has the value {power.min():.3g}: it must be positive")
        mirrored = np.roll(np.flip(power), 1, axis=tuple(range(power.ndim)))
        if not self.complex_valued and not np.allclose(power, mirrored, rtol=1e-4, atol=0):
            raise ValueError("power(k) differs from power(-k): a real field cannot have it")
        if np.iscomplexobj(mean) and not self.complex_valued:
            raise ValueError(f"complex mean {mean}: build the field with dtype=complex")
        self.power = jnp.asarray(power)
        self.mean = jnp.broadcast_to(jnp.asarray(mean, self.dtype), self.shape)

    @classmethod
    def fit(
        cls,
        pictures: Sequence[np.ndarray] | np.ndarray,
        shape: tuple[int, int] | None = None,
        dtype: type = float,
    ) -> "GaussianField":
        """Fit mean and isotropic spectrum to pictures; evaluate them on a grid of `shape`.

        `pictures`: one (h, w) array, a stack, or a list of arrays of any sizes, in the units of the
        object; complex pictures need `dtype=complex`, whose spectrum is the mean of Re's and Im's.
        Each periodogram is taken under a Hann window, against the leakage of non-periodic edges,
        averaged over rings of spatial frequency and interpolated in log-log. `shape` defaults to
        that of the first picture.
        """
        is_stack = isinstance(pictures, np.ndarray) and pictures.ndim == 2
        pictures = [np.asarray(p) for p in ([pictures] if is_stack else pictures)]
        check_finite(**{f"picture {i}": p for i, p in enumerate(pictures)})
        small = [p.shape for p in pictures if p.ndim != 2 or min(p.shape) < 8]
        if small or not pictures:
            raise ValueError(f"pictures of shape {small}: give 2-D pictures of 8x8 or more")
        if any(np.iscomplexobj(p) for p in pictures) and not is_complex_kind(dtype):
            raise ValueError("complex pictures: build the field with dtype=complex")
        mean = np.mean(np.concatenate([p.ravel() for p in pictures]))
        rings = [_ring_spectrum(p - mean) for p in pictures]
        frequency = np.unique(np.concatenate([f for f, _ in rings]))
        log_power = np.mean(
            [np.interp(np.log(frequency), np.log(f), np.log(p)) for f, p in rings], axis=0
        )
        shape = checked_shape(pictures[0].shape if shape is None else shape)
        radius = np.maximum(_radial_frequency(shape), frequency[0])
        power = np.exp(np.interp(np.log(radius), np.log(frequency), log_power))
        return cls(power, mean, shape, dtype)

    @property
    def scale(self) -> jax.Array:
        """Standard deviation of one pixel, per real component."""
        return jnp.sqrt(self.power.mean())

    @property
    def stiffness(self) -> jax.Array:
        """Of the frequency that varies least."""
        return jnp.max(1 / self.power)

    def sample(self, key: jax.Array) -> jax.Array:
        """One field: white noise, coloured in Fourier space."""
        white = normal_like(key, jnp.zeros(self.shape, self.dtype))
        return self.mean + self._like_object(
            jnp.fft.ifftn(jnp.sqrt(self.power) * jnp.fft.fftn(white))
        )

    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Log-density of field + annealing error at `x`; exact."""
        power = self.power + self._component_sd(sigma) ** 2
        spectrum = jnp.fft.fftn(self._centred(x), norm="ortho")
        components = 2 if self.complex_valued else 1
        quadratic = jnp.sum((spectrum.real**2 + spectrum.imag**2) / power)
        return -0.5 * (quadratic + components * jnp.sum(jnp.log(2 * jnp.pi * power)))

    def score(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """-C^-1 (x - mean), C the covariance of field + annealing error; exact."""
        power = self.power + self._component_sd(sigma) ** 2
        return -self._like_object(jnp.fft.ifftn(jnp.fft.fftn(self._centred(x)) / power))

    def _centred(self, x: jax.Array) -> jax.Array:
        self._to_vector(x)
        return x - self.mean

    def _like_object(self, field: jax.Array) -> jax.Array:
        return field if self.complex_valued else field.real


def _radial_frequency(shape: tuple[int, ...]) -> np.ndarray:
    """Distance from zero frequency of each FFT sample, in cycles per pixel."""
    axes = np.meshgrid(*(np.fft.fftfreq(n) for n in shape), indexing="ij")
    return np.sqrt(sum(f**2 for f in axes))


def _ring_spectrum(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ring centres in cycles per pixel, and the mean power of a real component in each ring."""
    window = np.outer(*(np.hanning(n + 2)[1:-1] for n in picture.shape))
    window /= np.sqrt(np.mean(window**2))
    spectrum = np.abs(np.fft.fftn(picture * window, norm="ortho")) ** 2
    if np.iscomplexobj(picture):
        spectrum = spectrum / 2
    radius = _radial_frequency(picture.shape)
    step = 1 / min(picture.shape)
    ring = np.round(radius / step).astype(int)
    # Rings 0 and 1 are one: the Hann window spreads zero frequency over both.
    ring = np.maximum(ring, 1)
    total = np.bincount(ring.ravel(), spectrum.ravel())[1:]
    count = np.bincount(ring.ravel())[1:]
    mean = total / np.maximum(count, 1)
    keep = (count > 0) & (mean > 0)
    floor = 1e-12 * max(mean.max(), np.finfo(float).tiny)
    if not keep.any():
        raise ValueError("a picture is constant: a field cannot be fitted to it")
    return step * np.arange(1, len(mean) + 1)[keep], np.maximum(mean[keep], floor)
