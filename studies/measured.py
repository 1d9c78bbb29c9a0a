"""Denoising of real captures: noise that no model made, and the average of many as the truth."""

import os
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..diagnostics.residuals import Residuals, residual_checks
from ..estimators import PhotonTransfer, photon_transfer
from ..images import read_picture
from ..models.camera import Poisson
from .systems import SYSTEMS, Recording

WHITE = 255
# Captures clip from a few levels below white on.
_SATURATION = 250
# Places looked at for each patch, for the one with the most contrast.
_PLACES = 8
# Standard deviations below white where a mean is bright enough for its noise to be clipped.
CLEAR = 4


class Captures(NamedTuple):
    """One field captured again and again, 8 bits a pixel, in grey levels.

    `captures` (n, h, w) uint8; `average` (h, w) of `frames` captures, these among them; `transfer`:
    the camera's gain and offset, estimated from the captures.
    """

    captures: np.ndarray
    average: np.ndarray
    frames: int
    transfer: PhotonTransfer

    @property
    def camera(self) -> Poisson:
        """Whole photons, clipped at those that white stands for."""
        return Poisson(int(self.photons(np.asarray(WHITE))))

    def photons(self, grey: np.ndarray) -> np.ndarray:
        """Whole photons, 0 or more: the nearest to these grey levels."""
        whole = np.round((grey - self.transfer.offset) / self.transfer.gain)
        return np.maximum(whole, 0)

    def to_grey(self, images: np.ndarray) -> np.ndarray:
        """Images in units of the camera's full well as shares of white."""
        photons = images * self.camera.full_well
        return (self.transfer.offset + self.transfer.gain * photons) / WHITE

    def to_object(self, images: np.ndarray) -> np.ndarray:
        """Shares of white as light in units of the camera's full well, 0 or more."""
        photons = (images * WHITE - self.transfer.offset) / self.transfer.gain
        return np.maximum(photons, 0) / self.camera.full_well

    def light(self, index: int) -> float:
        """Of a capture over that of the average: lamps and scanners are not steady."""
        dark = self.transfer.offset
        return float((self.captures[index] - dark).sum() / (self.average - dark).sum())

    def expected(self, index: int, scaled: bool) -> np.ndarray:
        """The average in grey levels (h, w): as it is, or in the light of that capture."""
        dark = self.transfer.offset
        return dark + (self.light(index) if scaled else 1.0) * (self.average - dark)

    def residuals(self, index: int) -> Residuals:
        """Of a capture about the average in its light: what the noise model does not explain.

        The capture is one of those averaged, which takes 1 / frames of the variance. Pixels within
        four standard deviations of saturation, or darker than the offset, are left out.
        """
        mean = self.expected(index, scaled=True)
        variance = self.transfer.gain * np.maximum(mean - self.transfer.offset, 0)
        clear = mean + CLEAR * np.sqrt(variance) <= _SATURATION
        seen = np.where(clear, variance * (1 - 1 / self.frames), 0.0)
        return residual_checks(self.captures[index] - mean, seen)


class Measured(NamedTuple):
    """The study: each patch of each field is recorded as it was captured, and answered.

    A condition is the name of a field. Patch i is cut from capture i, i + 1 starting again with the
    first, where of eight places the average has the most contrast. Callable as the harness wants.

    `simulated`: a control, in which the camera's model draws the counts from the average; what is
    off there is the prior or the system, and not the noise. `right`: patches are of right halves
    alone, for a prior that learnt from the left ones (`left_halves_of`).
    """

    fields: dict[str, Captures]
    prior: str
    side: int
    draws: int
    seed: int
    simulated: bool = False
    right: bool = False

    def __call__(self, system: str, condition: str, index: int) -> np.ndarray:
        return np.asarray(SYSTEMS[system].answer(self.recording(condition, index)))

    def recording(self, condition: str, index: int) -> Recording:
        """Of one patch: the same for every system."""
        field = self.fields[condition]
        camera, key = field.camera, jax.random.fold_in(jax.random.key(self.seed), index)
        if self.simulated:
            key, key_data = jax.random.split(key)
            light = field.to_object(self.truth(condition, index, scaled=False))
            y = camera.sample(key_data, jnp.asarray(light, jnp.float32))
        else:
            capture = field.captures[index % len(field.captures)]
            counts = self._cut(condition, index, field.photons(capture))
            y = np.minimum(counts, camera.full_well).astype(np.float32) / camera.full_well
        return Recording(jnp.asarray(y), camera, self.prior, key, self.draws)

    def truth(self, condition: str, index: int, scaled: bool) -> np.ndarray:
        """The average there (side, side), as a share of white; `scaled` to the capture's light."""
        field = self.fields[condition]
        scaled = scaled and not self.simulated
        expected = field.expected(index % len(field.captures), scaled)
        return self._cut(condition, index, expected) / WHITE

    def predicted(self, condition: str, index: int, images: np.ndarray) -> np.ndarray:
        """Averages, as shares of white, that draws (draws, side, side) of a patch foretell.

        The average has an error of its own, and the capture is one of its `frames`: given the
        object it is the capture / frames plus the mean of the other frames. Approximation: their
        sum as normal, and their light as this capture's. A simulated recording is of the average.
        """
        if self.simulated:
            return self.fields[condition].to_grey(images)
        recording, field = self.recording(condition, index), self.fields[condition]
        others, well = field.frames - 1, recording.camera.full_well
        rng = np.random.default_rng((self.seed, index, 1))
        light = np.maximum(images, 0)
        noise = np.sqrt(light * others / well) * rng.standard_normal(images.shape)
        return field.to_grey((np.asarray(recording.y) + others * images + noise) / field.frames)

    def _cut(self, condition: str, index: int, image: np.ndarray) -> np.ndarray:
        average = self.fields[condition].average
        rng = np.random.default_rng((self.seed, index))
        first = average.shape[1] // 2 if self.right else 0
        rows, columns = (n - self.side + 1 for n in average.shape)
        if rows < 1 or columns <= first:
            of = "right half of " if self.right else ""
            raise ValueError(
                f"the {of}{average.shape} {condition} is smaller than --size {self.side}"
            )
        corners = rng.integers((0, first), (rows, columns), (_PLACES, 2))
        patches = [np.s_[i : i + self.side, j : j + self.side] for i, j in corners]
        return image[max(patches, key=lambda patch: average[patch].std())]


def read_captures(folder: str | os.PathLike, name: str, frames: int = 50) -> Captures:
    """Of `folder`/raw/`name`_*.png, and the average of `frames` in `folder`/gt/`name`_1.png.

    Raises ValueError for pictures that are not 8-bit grey, of unlike shapes, or that
    `photon_transfer` refuses, and for fewer frames than captures; FileNotFoundError where there are
    none.
    """
    paths = sorted(Path(folder, "raw").glob(f"{name}_*.png"))
    if not paths:
        raise FileNotFoundError(f"no file raw/{name}_*.png in {folder}: name a field that it has")
    if frames < len(paths):
        raise ValueError(f"frames {frames}: the average is of at least its {len(paths)} captures")
    captures = [_grey(path) for path in paths]
    average = _grey(Path(folder, "gt", f"{name}_1.png"))
    for path, capture in zip(paths, captures):
        if capture.shape != average.shape:
            raise ValueError(f"{path} is {capture.shape}, the average of its field {average.shape}")
    stack = np.stack(captures)
    return Captures(stack, average.astype(float), frames, photon_transfer(stack, _SATURATION))


def _grey(path: Path) -> np.ndarray:
    picture = read_picture(path)
    if picture.dtype != np.uint8 or picture.ndim != 2:
        raise ValueError(
            f"{path} is {picture.dtype} of shape {picture.shape}: a capture is 8-bit grey (h, w)"
        )
    return picture


def left_halves_of(field: Captures) -> list[np.ndarray]:
    """Of the average, (h // 4, w // 2) four times, in units of the camera's full well: what a prior
    of this microscope may learn from, where patches are of the right half (`Measured.right`).
    """
    light = field.to_object(field.average / WHITE).astype(np.float32)
    return np.array_split(light[:, : light.shape[1] // 2], 4)


def names_of(folder: str | os.PathLike) -> list[str]:
    """The fields that `folder`/raw has captures of. Raises FileNotFoundError where it has none."""
    names = sorted({path.stem.rpartition("_")[0] for path in Path(folder, "raw").glob("*_*.png")})
    if not names:
        raise FileNotFoundError(f"no file raw/FIELD_*.png in {folder}: give a folder of captures")
    return names
