"""What a user's file records: its values, the object's shape behind it, and how it looks."""

import math

import numpy as np

from ..models.camera import Poisson
from .applications import DENOISING, LEAST_SIDE, PHASE_RETRIEVAL, PTYCHOGRAPHY
from .optics import LEDS, upsampling_of


def normalised(data: np.ndarray, camera: Poisson) -> np.ndarray:
    """In units of the camera: floats are electrons / full well, integers codes of the ADC."""
    if data.dtype == bool:
        data = data.astype(np.uint8)
    if not np.issubdtype(data.dtype, np.integer):
        return data * camera.highest
    if camera.bits is None:
        raise ValueError(f"the recording holds {data.dtype} codes: say how many bits with --bits")
    return np.asarray(camera.from_codes(data))


def object_shape(
    name: str,
    y: np.ndarray,
    size: int | None,
    oversampling: int | None,
    leds: int | None = None,
    in_colour: bool = False,
) -> tuple[int, ...]:
    """Shape of the object behind a recording; raises ValueError for one that has none."""
    if name == PTYCHOGRAPHY:
        return _shape_from_stack(y, size, leds)
    if size is not None:
        raise ValueError(f"size {size}: a recording has its own size, leave out --size")
    if y.ndim != 2 and not (in_colour and y.shape[2:] == (3,)):
        raise ValueError(f"a recording of shape {y.shape}: give (height, width), one grey page")
    if min(y.shape[:2]) < LEAST_SIDE:
        raise ValueError(f"a recording of shape {y.shape}: give {LEAST_SIDE} pixels a side")
    if name == DENOISING:
        return y.shape
    factor = oversampling or 2
    if any(n % factor for n in y.shape):
        raise ValueError(f"a recording of shape {y.shape}: oversampling {factor} must divide it")
    _refuse_centred(y)
    return tuple(n // factor for n in y.shape)


def _refuse_centred(y: np.ndarray) -> None:
    brightest = tuple(int(i) for i in np.unravel_index(np.argmax(y), y.shape))
    if all(n / 4 < i < 3 * n / 4 for i, n in zip(brightest, y.shape)):
        raise ValueError(
            f"the brightest pixel is at {brightest}, in the middle: bring the zero frequency to "
            "index 0 with numpy.fft.ifftshift"
        )


def _shape_from_stack(y: np.ndarray, size: int | None, leds: int | None) -> tuple[int, int]:
    counts = LEDS if leds is None else (leds,)
    if y.ndim != 3 or len(y) not in counts or y.shape[1] != y.shape[2]:
        raise ValueError(
            f"a recording of shape {y.shape}: give ({' or '.join(map(str, counts))}, n, n), one "
            "square page a LED"
        )
    low = y.shape[1]
    size = 4 * low if size is None else size
    if size != upsampling_of(size) * low:
        raise ValueError(
            f"size {size} from pages of {low}x{low}: the object is 4 times as wide, or twice if "
            "that is under 64; give --size"
        )
    return size, size


def picture_of(name: str, y: np.ndarray) -> tuple[np.ndarray, str]:
    """A recording (h, w[, 3]) to look at, and its heading: logarithm, or mosaic of amplitudes."""
    if name == PHASE_RETRIEVAL:
        faintest = np.min(y[y > 0], initial=1.0)
        return np.log10(np.maximum(np.fft.fftshift(y), faintest)), "recording (log)"
    if name == PTYCHOGRAPHY:
        side = math.isqrt(len(y))
        rows = np.sqrt(y[: side**2]).reshape(side, side, *y.shape[1:])
        # Every LED on its own scale: the outer ones are dark fields.
        rows = rows / np.maximum(rows.max(axis=(2, 3), keepdims=True), 1e-12)
        framed = np.pad(rows, ((0, 0), (0, 0), (0, 1), (0, 1)), constant_values=1.0)
        shown = np.block([list(row) for row in framed])[:-1, :-1]
        return shown, f"recordings, {side}x{side} of {len(y)} LEDs"
    return y, "recording"
