"""Pictures in and out: PNG, JPEG, TIFF and NumPy files as arrays, checked where they are read."""

import os
from collections.abc import Callable
from logging import CRITICAL, getLogger
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image
from skimage.color import rgb2gray
from skimage.transform import resize

from .files import replace_whole

_FORMATS = ("PNG", "JPEG")
_TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_FULL_SCALE = {np.dtype(bool): 1, np.dtype("uint8"): 255, np.dtype("uint16"): 65535}
_ROUNDING = 1e-6


def read_picture(path: str | os.PathLike, page: int | None = None) -> np.ndarray:
    """The array in a PNG, JPEG, TIFF, NPY or NPZ file (`path.npz:key` if it holds several).

    The dtype is that of the file: bool, integers, floats, or complex from NPY and NPZ. Shape
    (h, w), or (h, w, channels) for colour; several pages are (pages, h, w), of which `page`
    (from 0) picks one. What a file is, is told from its first bytes, not from its name.

    Raises FileNotFoundError; ValueError, in one sentence, for a file that is no picture, is
    truncated, is empty, or holds NaN or infinity, and for a page that is not there.
    """
    path, key = split_key(os.fspath(path))
    if not os.path.exists(path):
        raise FileNotFoundError(f"no file {path}: give the path of a picture")
    if os.path.isdir(path):
        raise ValueError(f"{path} is a folder: give one picture file")
    if page is not None and page < 0:
        raise ValueError(f"page {page}: pages are counted from 0")
    picture = _checked(_reader(path, key)(path), path)
    return picture if page is None else _one_page(picture, page, path)


def split_key(path: str) -> tuple[str, str | None]:
    """The file, and the key behind `.npz:`, of a picture's path."""
    head, mark, key = path.rpartition(".npz:")
    return (f"{head}.npz", key) if mark and not os.path.exists(path) else (path, None)


def to_unit_range(picture: np.ndarray) -> np.ndarray:
    """A picture as float64 in 0..1: uint8 / 255, uint16 / 65535, floats as they are.

    Raises ValueError for floats outside 0..1, complex numbers and other integers.
    """
    picture = np.asarray(picture)
    if picture.dtype in _FULL_SCALE:
        return picture / _FULL_SCALE[picture.dtype]
    if not np.issubdtype(picture.dtype, np.floating):
        raise ValueError(
            f"a picture of dtype {picture.dtype} has no known full scale: "
            "save it as 8-bit or 16-bit integers, or as floats between 0 and 1"
        )
    for value in (picture.min(), picture.max()):
        # The negation also refuses NaN.
        if not -_ROUNDING <= value <= 1 + _ROUNDING:
            raise ValueError(
                f"the picture holds the value {value:.6g}, outside 0..1: "
                "divide it by its full scale first"
            )
    return np.clip(picture.astype(float), 0, 1)


def to_grey(picture: np.ndarray) -> np.ndarray:
    """A picture (h, w) from (h, w), or from (h, w, channels): grey, grey + alpha, RGB or RGBA.

    `picture` is float in 0..1; RGB becomes luminance, alpha is left out. Raises ValueError for
    other shapes.
    """
    channels = picture.shape[-1] if picture.ndim == 3 else None
    if picture.ndim == 2:
        return picture
    if channels in (1, 2):
        return picture[..., 0]
    if channels in (3, 4):
        return rgb2gray(picture[..., :3])
    if picture.ndim == 3:
        raise ValueError(f"the file holds {len(picture)} pages: choose one with --page")
    raise ValueError(f"an array of shape {picture.shape} is no picture: give (height, width)")


def central_square(picture: np.ndarray, side: int) -> np.ndarray:
    """The middle (side, side) of a picture (h, w[, channels]) that has as much."""
    top, left = ((n - side) // 2 for n in picture.shape[:2])
    return picture[top : top + side, left : left + side]


def fit_to(picture: np.ndarray, size: int) -> np.ndarray:
    """The central square of a picture (h, w[, channels]), real or complex, brought to `size`.

    Anti-aliased; it never enlarges: raises ValueError if `size` is above the shorter side.
    """
    side = min(picture.shape[:2])
    if size > side:
        raise ValueError(f"size {size} is above the picture's shorter side: give {side} or less")
    square = central_square(picture, side)
    if size == side:
        return square
    if np.iscomplexobj(square):
        return fit_to(square.real, size) + 1j * fit_to(square.imag, size)
    return resize(square, (size, size), anti_aliasing=True)


def write_tiff(path: str | os.PathLike, array: np.ndarray, colour: bool = False) -> None:
    """Write a real array as a float32 TIFF, there whole or not at all.

    (h, w) or (pages, h, w); (h, w, 3) if `colour`.
    """
    array = np.asarray(array)
    if np.iscomplexobj(array):
        raise ValueError("a TIFF holds no complex numbers: write amplitude and phase apart")
    kind = "rgb" if colour else "minisblack"
    replace_whole(path, lambda part: tifffile.imwrite(part, array.astype("f4"), photometric=kind))


def _reader(path: str, key: str | None) -> Callable[[str], np.ndarray]:
    with open(path, "rb") as file:
        start = file.read(6)
    if not start:
        raise ValueError(f"{path} is empty: give a picture file")
    if start.startswith(b"PK"):
        return lambda path: _read_npz(path, key)
    if key is not None:
        raise ValueError(f"{path} is no NPZ file: leave out ':{key}'")
    if start == b"\x93NUMPY":
        return _read_npy
    return _read_tiff if start[:4] in _TIFF_STARTS else _read_pil


def _read_pil(path: str) -> np.ndarray:
    try:
        with Image.open(path, formats=_FORMATS) as image:
            # Palettes and the colour spaces of print and video are not what a camera records.
            if image.mode in ("P", "PA", "CMYK", "YCbCr", "LAB", "HSV"):
                image = image.convert("RGB")
            return np.array(image)
    except Image.UnidentifiedImageError:
        raise ValueError(f"{path} is no picture: give a PNG, JPEG, TIFF, NPY or NPZ file") from None
    # What a decoder raises on damaged bytes is not documented.
    except Exception as error:
        raise _damaged(path, error) from error


def _read_tiff(path: str) -> np.ndarray:
    log = getLogger("tifffile")
    level = log.level
    log.setLevel(CRITICAL)
    try:
        with tifffile.TiffFile(path) as tiff:
            _refuse_truncated(tiff)
            series = [(s.asarray(), s.axes) for s in tiff.series]
    except Exception as error:
        raise _damaged(path, error) from error
    finally:
        log.setLevel(level)
    if len({array.shape for array, _ in series}) != 1:
        shapes = [array.shape for array, _ in series]
        raise ValueError(f"{path} holds pictures of shapes {shapes}: save the one you mean alone")
    pages = [_channels_last(array, axes) for array, axes in series]
    return pages[0] if len(pages) == 1 else np.stack(pages)


def _refuse_truncated(tiff: tifffile.TiffFile) -> None:
    # tifffile fills up with zeros what is missing at the end of a file.
    for page in tiff.pages:
        page = page.aspage()
        if any(o + n > tiff.filehandle.size for o, n in zip(page.dataoffsets, page.databytecounts)):
            raise ValueError("it ends too early")


def _channels_last(array: np.ndarray, axes: str) -> np.ndarray:
    if "S" in axes:
        return np.moveaxis(array, axes.index("S"), -1)
    # Time, depth and channel axes alike are pages.
    return array if array.ndim <= 2 else array.reshape(-1, *array.shape[-2:])


def _read_npy(path: str) -> np.ndarray:
    try:
        with open(path, "rb") as file:
            return np.load(file, allow_pickle=False)
    except Exception as error:
        raise _damaged(path, error) from error


def _read_npz(path: str, key: str | None) -> np.ndarray:
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as arrays:
            names = list(arrays)
            name = names[0] if key is None and len(names) == 1 else key
            if name in names:
                return arrays[name]
    except Exception as error:
        raise _damaged(path, error) from error
    if not names:
        raise ValueError(f"{path} holds no arrays: save one picture in it")
    known = ", ".join(names)
    if key is None:
        raise ValueError(f"{path} holds the arrays {known}: name one, as in {path}:{names[0]}")
    raise ValueError(f"{path} has no array {key!r}: it holds {known}")


def _damaged(path: str, error: Exception) -> ValueError:
    cause = str(error).split("\n")[0].rstrip(".")
    return ValueError(f"{path} cannot be read, it is damaged or truncated ({cause}): copy it anew")


def _checked(picture: np.ndarray, path: str) -> np.ndarray:
    if picture.dtype.kind not in "buifc":
        raise ValueError(f"{path} holds {picture.dtype}, not numbers: save a numeric array")
    if picture.ndim < 2 or 0 in picture.shape:
        raise ValueError(
            f"{path} holds an array of shape {picture.shape}: a picture is (height, width)"
        )
    bad = np.count_nonzero(~np.isfinite(picture))
    if bad:
        raise ValueError(f"{path} holds NaN or infinity in {bad} places: replace what is missing")
    return picture


def _one_page(picture: np.ndarray, page: int, path: str) -> np.ndarray:
    in_colour = picture.ndim == 3 and picture.shape[-1] <= 4
    pages = picture[None] if picture.ndim == 2 or in_colour else picture
    if page >= len(pages):
        count = f"{len(pages)} pages" if len(pages) > 1 else "one page"
        raise ValueError(
            f"page {page} of {Path(path).name}: it has {count}, the last is {len(pages) - 1}"
        )
    return pages[page]
