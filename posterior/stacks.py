"""Measured stacks of Fourier ptychography: an image and a direction of light for each LED."""

import math
import os
import warnings
from typing import NamedTuple

import jax
import numpy as np
import scipy.fft

from .models.optics import check_aperture, checked_sines, refuse_same_direction

_KINDS = ("intensity", "amplitude")
_NUMBERS = {
    "na": ("na", "NA"),
    "wavelength": ("wavelength", "wavelength_m"),
    "pixel_size": ("pixel_size", "pixel_m"),
}
# Of the band's edge: two discs that far apart overlap in 0.6 % of their area.
_BAND = 0.97
_FREE = 64  # frequencies of each image, to estimate a variance from
_BRIGHT = 0.95  # of the aperture: the LED itself is seen
_MOST_CODES = 2**16  # of an ADC
_LEAST_LEVELS = 8  # fewer values lie evenly by chance
_UNEVEN = 0.1  # of a step
_MOST = 2**23 - 2  # electrons, by what Poisson cameras count
_MARGIN = 5  # samples, for the soft edge of a pupil and LEDs that turn out to be elsewhere
_LEAST_RADIUS = 2  # samples
# Of wavelength / na: as far as light of a window of a specimen reaches. Twice that gains nothing.
_RIM = 2


class Stack(NamedTuple):
    """What a microscope recorded, LED by LED; lengths in metres.

    - `intensity`: (M, n0, n1) float64, nonnegative, in any unit.
    - `led_na`: (M, 2), sines (row, column) of the directions in which the object sees the LEDs, as
      `FourierPtychography.from_microscope` takes them.
    - `na`, `wavelength`; `pixel_size`: of the camera, over the magnification.
    """

    intensity: np.ndarray
    led_na: np.ndarray
    na: float
    wavelength: float
    pixel_size: float

    @property
    def view(self) -> np.ndarray:
        """Field of view (2,), metres: a Fourier sample is one over it."""
        return np.array(self.intensity.shape[1:]) * self.pixel_size

    @property
    def radii(self) -> np.ndarray:
        """Semi-axes (2,) of the pupil, in Fourier samples."""
        return self.na / self.wavelength * self.view

    @property
    def bright(self) -> np.ndarray:
        """Which LEDs (M,) shine into the objective: bright field."""
        return np.linalg.norm(self.led_na, axis=1) < _BRIGHT * self.na

    def of(self, leds: np.ndarray) -> "Stack":
        """The stack of some of the LEDs, by index or mask."""
        return self._replace(intensity=self.intensity[leds], led_na=self.led_na[leds])


def read_stack(path: str | os.PathLike) -> Stack:
    """A stack from an NPZ file that holds these arrays.

    - `intensity` or `amplitude`: (M, n0, n1); amplitudes are squared.
    - `led_na`: (M, 2), as in `Stack`; or `kxky_NA`: (M, 2 or more), the direction (x, y) in which
      the light of each LED travels, which is the opposite.
    - `na` or `NA`; `wavelength` or `wavelength_m`; `pixel_size` or `pixel_m`.

    Raises FileNotFoundError; ValueError, in one sentence, for a file that is no such stack, for
    values that are negative or not finite, for counts of images and LEDs that differ, for an LED
    that is there twice, and for the wrong one of the two names: what a camera records is evenly
    spaced, and so it is known. Warns (UserWarning) where the images are evenly spaced under neither
    name, as after a correction or a mean over exposures.
    """
    path = os.fspath(path)
    if not os.path.exists(path):
        raise FileNotFoundError(f"no file {path}: give the path of a stack")
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except Exception as error:
        raise ValueError(f"{path} cannot be read as an NPZ file: copy it anew") from error
    kinds = [kind for kind in _KINDS if kind in arrays]
    if len(kinds) != 1:
        raise ValueError(
            f"{path} holds {', '.join(arrays) or 'nothing'}: a stack has one array named intensity "
            "or amplitude"
        )
    images = _images(arrays[kinds[0]], path)
    intensity = _intensity(images, kinds[0], path)
    numbers = {name: _number(arrays, names, path) for name, names in _NUMBERS.items()}
    return checked_stack(Stack(intensity, _directions(arrays, path), **numbers))


def checked_stack(stack: Stack) -> Stack:
    """The stack, refused if its parts do not fit together."""
    images, leds = stack.intensity, stack.led_na
    if len(images) != len(leds):
        raise ValueError(f"{len(images)} images for {len(leds)} LEDs: give one image for each LED")
    for name in _NUMBERS:
        value = getattr(stack, name)
        if not 0 < value < np.inf:
            raise ValueError(f"{name} {value}: give a positive number, lengths in metres")
    check_aperture(stack.na, stack.wavelength, stack.pixel_size)
    checked_sines(leds)
    if stack.radii.min() < _LEAST_RADIUS:
        raise ValueError(
            f"the pupil has a radius of {stack.radii.min():.3g} Fourier samples, below "
            f"{_LEAST_RADIUS}: give wavelength and pixel_size (over the magnification) in metres, "
            "or larger images"
        )
    refuse_same_direction(leds)
    dark = np.flatnonzero(images.sum(axis=(1, 2)) <= 0)
    if len(dark):
        raise ValueError(f"image {dark[0]} is dark everywhere: leave its LED out")
    return stack


def photon_scale(stack: Stack) -> np.ndarray:
    """Electrons a unit of intensity, (M,), from the noise of the images themselves.

    No field that passes a pupil of radius na / wavelength has an intensity beyond twice that
    frequency: what an image holds there is noise, white, of a variance that is the mean over its
    mean number of electrons (Poisson). Bright-field images are taken to share an exposure and get
    the median of theirs; each of the others may have its own.

    Approximations: read noise and the ADC's steps count as photon noise; an image is a window of a
    larger one, tapered by Hann's to keep what leaks over its edges out. Raises ValueError where the
    camera's pixels are so coarse that nothing lies beyond the band.
    """
    shape = stack.intensity.shape[1:]
    rows, columns = (np.fft.fftfreq(n) * n / r for n, r in zip(shape, stack.radii))
    free = np.hypot(rows[:, None], columns) > 2 * _BAND
    if free.sum() < _FREE:
        raise ValueError(
            f"only {free.sum()} frequencies of these images lie beyond the band of the pupil, too "
            f"few to measure noise by ({_FREE}): give electrons=, those a unit of intensity"
        )
    taper = np.outer(*(np.hanning(n + 2)[1:-1] for n in shape))
    mean = (stack.intensity * taper**2).sum(axis=(1, 2)) / (taper**2).sum()
    spectrum = np.fft.fft2((stack.intensity - mean[:, None, None]) * taper)
    variance = (np.abs(spectrum[:, free]) ** 2).mean(axis=1) / (taper**2).sum()
    # Of an even image nothing is left.
    scale = mean / np.maximum(variance, np.finfo(float).tiny)
    if stack.bright.any():
        scale[stack.bright] = np.median(scale[stack.bright])
    return scale


def in_electrons(stack: Stack, electrons: float | np.ndarray | None = None) -> Stack:
    """The stack as whole electrons.

    `electrons`: a unit of intensity, one number or (M,); None: by `photon_scale`. Raises ValueError
    for electrons that are not positive, where more come out than a camera counts, as they do of
    images without noise, and for parts that do not fit together.
    """
    checked_stack(stack)
    scale = photon_scale(stack) if electrons is None else np.asarray(electrons, float)
    if scale.shape not in ((), (len(stack.intensity),)) or not np.all(scale > 0):
        raise ValueError(
            f"electrons of shape {scale.shape}, the least {np.min(scale):.3g}: give one positive "
            f"number, or one for each of the {len(stack.intensity)} images"
        )
    counts = np.rint(stack.intensity * np.broadcast_to(scale, len(stack.intensity))[:, None, None])
    if not counts.max() <= _MOST:
        raise ValueError(
            f"the brightest pixel comes to {counts.max():.3g} electrons, and no more than {_MOST} "
            "are told apart: the images hold hardly any noise to count by, give electrons="
        )
    return checked_stack(stack._replace(intensity=counts))


def dispersed(stack: Stack, dispersion: np.ndarray, key: jax.Array) -> Stack:
    """A stack of electrons as if of fewer, whose photon noise has `dispersion` times the variance.

    `dispersion` (M,), one an LED; where it is at most 1, or none (nan), the image stays as it is.
    The quasi-likelihood of overdispersed counts (McCullagh and Nelder, Generalized Linear Models,
    1989, section 9.2): their Poisson likelihood to the power of 1 / dispersion. Counts are divided,
    and rounded up or down at random, which keeps their mean and adds at most 1/4 to their variance.
    Raises ValueError where nothing of an image is left.
    """
    divisor = np.fmax(dispersion, 1.0)[:, None, None]
    up = np.asarray(jax.random.uniform(key, stack.intensity.shape), float)
    fewer = np.where(divisor > 1, np.floor(stack.intensity / divisor + up), stack.intensity)
    return checked_stack(stack._replace(intensity=fewer))


class Grid(NamedTuple):
    """Of a stack and the rim around it (`FourierPtychography`), which is what optics are built on.

    - `shape`, `rim`: (2,) camera pixels, with the rim on each side, and those of the rim.
    - `radii`: (2,) semi-axes of the pupil, in Fourier samples of this shape.
    - `places`: (M, 2) where the middle of the pupil lies for each LED, in these samples.
    """

    shape: tuple[int, int]
    rim: tuple[int, int]
    radii: np.ndarray
    places: np.ndarray


def grid(stack: Stack) -> Grid:
    """The grid of a stack: a rim of at least 2 wavelengths over na, and a fast transform."""
    rim = math.ceil(_RIM * stack.wavelength / stack.na / stack.pixel_size)
    recorded = stack.intensity.shape[1:]
    shape = tuple(_fast(n, n + 2 * rim) for n in recorded)
    samples = np.array(shape) * stack.pixel_size / stack.wavelength
    rims = tuple((wide - n) // 2 for wide, n in zip(shape, recorded))
    return Grid(shape, rims, stack.na * samples, stack.led_na * samples)


def _fast(n: int, least: int) -> int:
    """The next length of a fast transform that is as odd or even as n."""
    while (length := scipy.fft.next_fast_len(least)) % 2 != n % 2:
        least = length + 1
    return length


def least_upsampling(stack: Stack) -> int:
    """The fewest object pixels for one of the camera, along an axis, whose band holds every LED."""
    shape, _, radii, places = grid(stack)
    reach = np.abs(places).max(axis=0) + radii
    return math.ceil((2 * (reach + _MARGIN) / shape).max())


def _images(images: np.ndarray, path: str) -> np.ndarray:
    if images.ndim != 3 or 0 in images.shape:
        raise ValueError(f"{path} holds images of shape {images.shape}: give (LEDs, height, width)")
    if images.dtype.kind not in "uif":
        raise ValueError(f"{path} holds {images.dtype} images: give real numbers")
    images = images.astype(np.float64)
    if not np.isfinite(images).all():
        raise ValueError(f"{path} holds NaN or infinity: replace what is missing")
    if images.min() < 0:
        raise ValueError(f"{path} holds the value {images.min():.3g}: light is not negative")
    return images


def _intensity(images: np.ndarray, kind: str, path: str) -> np.ndarray:
    """Intensities of images that are said to be of a kind; a camera's codes tell if it is wrong."""
    squares = images**2
    brightest = images.sum(axis=(1, 2)).argmax()
    even = {"intensity": _evenly_spaced(images[brightest])}
    # Squares of even values are even too: where intensities are, amplitudes cannot be.
    even["amplitude"] = not even["intensity"] and _evenly_spaced(squares[brightest])
    other = "intensity" if kind == "amplitude" else "amplitude"
    if even[other]:
        what = {
            "intensity": "values that are evenly spaced, as a camera's intensities are",
            "amplitude": "values whose squares are evenly spaced, as a camera's intensities are",
        }[other]
        done = "" if kind == "intensity" else ", or save square roots"
        raise ValueError(f"{path}: the array {kind} holds {what}: name it {other}{done}")
    if not even[kind]:
        done = "squared" if kind == "amplitude" else "taken as it is"
        warnings.warn(
            f"{path}: the array {kind} is {done}, and its values do not tell whether that is "
            f"right: if they are of the other kind, name the array {other}",
            stacklevel=3,
        )
    return squares if kind == "amplitude" else images


def _evenly_spaced(values: np.ndarray) -> bool:
    """Whether there is a step of which all differences are multiples, as those of codes are.

    The step is found from ever larger differences, because rounding blurs the smallest.
    """
    levels = np.unique(values)
    if len(levels) < _LEAST_LEVELS:
        # A dark or even image tells nothing, unless its values are codes themselves.
        return bool((values == np.rint(values)).all())
    # Rounding splits one code into several values, of no gap to speak of.
    least = 0.1 * np.ptp(levels) / _MOST_CODES
    gaps = np.diff(levels)
    gaps[gaps < least] = np.inf
    if np.isinf(gaps).all():
        return False
    narrowest = gaps.argmin()
    apart, reach = np.abs(levels - levels[narrowest]), gaps[narrowest]
    # An ADC finer than electrons leaves codes out: two gaps then differ by one step.
    steps = np.diff(np.unique(gaps[gaps < np.inf]))
    step = steps[steps > least].min(initial=reach)
    while reach < 2 * apart.max():
        reach *= 2
        near = apart[apart <= reach]
        whole = np.rint(near / step)
        step = (near @ whole) / (whole @ whole)
    off = np.abs(apart / step - np.rint(apart / step))
    return bool(np.ptp(levels) / step <= _MOST_CODES and off.max() < _UNEVEN)


def _directions(arrays: dict[str, np.ndarray], path: str) -> np.ndarray:
    if ("led_na" in arrays) == ("kxky_NA" in arrays):
        raise ValueError(f"{path}: give the directions of the LEDs as led_na, or as kxky_NA")
    name = "led_na" if "led_na" in arrays else "kxky_NA"
    found = arrays[name]
    columns = found.shape[1] if found.ndim == 2 else 0
    fits = columns == 2 if name == "led_na" else columns >= 2
    if not fits or found.dtype.kind not in "uif" or not np.isfinite(found).all():
        raise ValueError(
            f"{path}: {name} has shape {found.shape} and dtype {found.dtype}, give (LEDs, 2) real "
            "numbers, all finite"
        )
    return (found if name == "led_na" else -found[:, 1::-1]).astype(np.float64)


def _number(arrays: dict[str, np.ndarray], names: tuple[str, ...], path: str) -> float:
    found = [arrays[name] for name in names if name in arrays]
    if len(found) != 1 or found[0].size != 1 or found[0].dtype.kind not in "uif":
        raise ValueError(f"{path} has no {names[0]}: save it as one number")
    return float(found[0].item())
