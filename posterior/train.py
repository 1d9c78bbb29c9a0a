"""`posterior train`: a prior from a folder of pictures.

The result is NAME.safetensors with its model card NAME.json, and a folder NAME.training with the
checkpoint, report.json and report.png. The same command goes on from the checkpoint, bit for bit;
on a finished training it only writes the results anew.
"""

import dataclasses
import hashlib
import os
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import numpy as np

from .checkpoint import Checkpoint, fingerprint
from .diagnostics.regions import block_means
from .images import central_square, fit_to, read_picture, to_grey, to_unit_range
from .models.priors.denoiser import Denoiser, Statistics
from .models.priors.learned import suited_shape
from .models.priors.pictures import Pictures
from .models.priors.training import (
    Recipe,
    TrainingState,
    start_training,
    steps_per_call,
    train_steps,
)

SUFFIXES = (".png", ".tif", ".tiff", ".npy", ".npz", ".jpg", ".jpeg")
OBJECTS = {"grey": 1, "colour": 3, "complex": 2}
HOLD_OUT = ("random", "last")

# Trained levels in units of the pictures' sd, as an error per channel. The broadest is where noise
# drowns every picture, so that draws may start from noise alone; the signal-dependent variable
# must mostly stay positive, which ends it earlier. Of counts, 20 leaves a few in a whole patch; at
# 200, which leaves none, the loss of a training jumped, and denoising had become worse.
_FINEST, _BROADEST = 0.01, {"gaussian": 40.0, "signal": 4.0, "poisson": 20.0}
_SAVE_SECONDS = 60.0


@dataclasses.dataclass(frozen=True)
class Preparation:
    """How files become training arrays.

    `percentile`: each picture is divided by this percentile of its values and clipped at 1 (None:
    taken as it is); `floor`: smallest value (signal perturbation alone); `group`: pattern whose
    match in a file's name says which pictures belong together and are never split apart;
    `hold_out`: pictures for test and validation are "random" ones, or the "last" by name; `crop`:
    pixels a side of the central square that is kept; `resize`: those that it is brought to.
    """

    objects: str = "grey"
    percentile: float | None = None
    floor: float = 0.0
    group: str = ".*"
    validation: int = 32
    test: int = 0
    hold_out: str = "random"
    crop: int | None = None
    resize: int | None = None

    def __post_init__(self):
        if self.hold_out not in HOLD_OUT:
            raise ValueError(f"unknown hold_out {self.hold_out!r}: use {' or '.join(HOLD_OUT)}")
        for name in ("crop", "resize"):
            pixels = getattr(self, name)
            if pixels is not None and pixels < 1:
                raise ValueError(f"{name} {pixels}: give pixels a side, 1 or more")
        if self.objects not in OBJECTS:
            raise ValueError(f"unknown objects {self.objects!r}: use {', '.join(OBJECTS)}")
        if self.percentile is not None and not 0 < self.percentile <= 100:
            raise ValueError(f"percentile {self.percentile}: give a number above 0, at most 100")
        if self.validation < 1 or self.test < 0 or not 0 <= self.floor < 1:
            raise ValueError(
                f"validation {self.validation}, test {self.test}, floor {self.floor}: "
                "give 1 or more, 0 or more, and 0 to 1"
            )


class Split(NamedTuple):
    """File names of each part."""

    train: list[str]
    validation: list[str]
    test: list[str]


# ---- pictures ------------------------------------------------------------------------------------


def picture_files(folder: str | os.PathLike) -> list[Path]:
    """The picture files of a folder, by name; raises ValueError if there are none."""
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder: give a folder of pictures with --data")
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
    if not files:
        raise ValueError(f"{folder} holds no picture: put PNG, JPEG, TIFF, NPY or NPZ files in it")
    return files


def split_names(
    names: Sequence[str], validation: int, test: int, group: str = ".*", hold_out: str = "random"
) -> Split:
    """Whole pictures (and whole groups of them) for training, validation and test.

    "random" is the order of the SHA-256 of the group's name: the same for every training, whatever
    the seed, and hardly moved by pictures that are added. With "last", test takes the last ones by
    name, and validation those before them. At least `validation` and `test` pictures go
    to those parts. Raises ValueError if none is left to train on.
    """
    groups: dict[str, list[str]] = {}
    for name in sorted(names):
        match = re.match(group, name)
        groups.setdefault(match.group(0) if match else name, []).append(name)
    parts: dict[str, list[str]] = {"test": [], "validation": [], "train": []}
    by_hash = sorted(groups, key=lambda g: hashlib.sha256(g.encode()).hexdigest())
    for name in by_hash if hold_out == "random" else sorted(groups, reverse=True):
        part = "test" if len(parts["test"]) < test else "train"
        if part == "train" and len(parts["validation"]) < validation:
            part = "validation"
        parts[part] += groups[name]
    if not parts["train"]:
        raise ValueError(
            f"{len(names)} pictures in {len(groups)} groups: too few to hold out {validation} for "
            f"validation and {test} for test, give more pictures or hold out fewer"
        )
    return Split(*(sorted(parts[p]) for p in ("train", "validation", "test")))


def prepare(path: Path, how: Preparation) -> np.ndarray:
    """A file as float32 (h, w, channels) in the units that the prior is trained in."""
    raw = read_picture(path)
    if how.objects == "complex":
        if raw.ndim != 2:
            raise ValueError(f"{path} has shape {raw.shape}: a complex object is (height, width)")
        raw = _framed(raw, how, path)
        scale = 1.0 if how.percentile is None else _percentile(np.abs(raw), how.percentile, path)
        return np.stack([raw.real / scale, np.imag(raw) / scale], axis=-1).astype(np.float32)
    picture = to_unit_range(raw) if how.percentile is None else raw.astype(float)
    if how.objects == "grey":
        picture = to_grey(picture)[..., None]
    elif picture.ndim != 3 or picture.shape[-1] not in (3, 4):
        raise ValueError(f"{path} has shape {raw.shape}: a picture in colour is (h, w, 3)")
    picture = _framed(picture[..., : OBJECTS[how.objects]], how, path)
    if how.percentile is not None:
        picture = np.clip(picture / _percentile(picture, how.percentile, path), 0, 1)
    return np.maximum(picture, how.floor).astype(np.float32)


def _framed(picture: np.ndarray, how: Preparation, path: Path) -> np.ndarray:
    """The middle of a picture (h, w) or (h, w, channels) in the pixels asked for."""
    h, w = picture.shape[:2]
    if how.crop is not None:
        if min(h, w) < how.crop:
            raise ValueError(f"{path} is {h} x {w}: no square of {how.crop} pixels is in it")
        picture = central_square(picture, how.crop)
    return picture if how.resize is None else fit_to(picture, how.resize)


def normalisation(how: Preparation) -> str:
    """What `prepare` does, in words, for the model card."""
    if how.objects == "complex":
        if how.percentile is None:
            return "complex values as they are"
        return f"complex values over the {how.percentile:g}th percentile of their amplitudes"
    scale = (
        "full scale of the file is 1"
        if how.percentile is None
        else f"each picture over its own {how.percentile:g}th percentile, clipped to 0..1"
    )
    return scale + (f"; values below {how.floor:g} raised to it" if how.floor else "")


def statistics_of(
    pictures: Sequence[np.ndarray], perturbation: str, how: Preparation, size: int
) -> Statistics:
    """Mean and sd of the training pictures, the levels that they suggest, and for counts the sd of
    the means of their squares of `size` pixels, as large as the patches of training.
    """
    complex_valued = how.objects == "complex"
    flat = np.concatenate([p.ravel() for p in pictures]).astype(float)
    mean, sd = float(flat.mean()), float(flat.std())
    if sd < 1e-6:
        raise ValueError(f"the pictures have sd {sd:.3g}: pictures that do not vary teach nothing")
    # Channel errors over the level: brightness where it counts, a half for complex objects.
    per_level = mean**0.5 if perturbation != "gaussian" else 0.5 if complex_valued else 1.0
    return Statistics(
        mean=_rounded(mean),
        sd=_rounded(sd),
        sigma_min=_rounded(_FINEST * sd / per_level),
        sigma_max=_rounded(_BROADEST[perturbation] * sd / per_level),
        perturbation=perturbation,
        complex_valued=complex_valued,
        lowest=None if complex_valued else how.floor,
        brightness_sd=_brightness_sd(pictures, size) if perturbation == "poisson" else None,
    )


def _brightness_sd(pictures: Sequence[np.ndarray], size: int) -> float | None:
    means = [block_means(picture.mean(-1), size).ravel() for picture in pictures]
    sd = float(np.concatenate(means).std())
    return _rounded(sd) if sd > 0 else None


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _percentile(values: np.ndarray, percentile: float, path: Path) -> float:
    scale = float(np.percentile(values, percentile))
    if scale <= 0:
        raise ValueError(f"{path} has the {percentile:g}th percentile {scale:g}: leave it out")
    return scale


# ---- training ------------------------------------------------------------------------------------


def train(
    denoiser: Denoiser,
    pictures: Sequence[np.ndarray],
    recipe: Recipe,
    checkpoint: Path | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> tuple[Denoiser, np.ndarray, float]:
    """The averaged denoiser, the losses (steps,), and the seconds that all its runs took.

    `progress(steps done, recent loss)` is called as steps finish. With a `checkpoint` folder the
    state is saved every minute and at the end, and an earlier one is gone on from.
    """
    small = [p.shape for p in pictures if min(p.shape[:2]) < recipe.size]
    if small:
        raise ValueError(
            f"{len(small)} pictures are smaller than the patches of {recipe.size} pixels, one of "
            f"shape {small[0]}: leave them out, or give a smaller --size"
        )
    suited_shape((recipe.size, recipe.size, *_colour(denoiser)), denoiser)
    structure = eqx.filter(denoiser, eqx.is_inexact_array, inverse=True)
    fixed = (structure, Pictures(pictures), recipe)
    state, losses = start_training(denoiser, recipe), np.full(recipe.steps, np.nan, np.float32)
    folder, seconds = None, np.zeros(())
    if checkpoint is not None:
        folder = Checkpoint(checkpoint, fingerprint(state, str(denoiser), recipe, fixed[1]))
        saved = folder.load((state, losses, seconds))
        if saved is not None:
            (state, losses, seconds), _ = saved
            losses = np.array(losses)
    state, losses, seconds = _run(fixed, state, losses, float(seconds), folder, progress)
    return eqx.combine(state.average, structure), losses, seconds


def _run(
    fixed: tuple[Denoiser, Pictures, Recipe],
    state: TrainingState,
    losses: np.ndarray,
    seconds: float,
    folder: Checkpoint | None,
    progress: Callable[[int, float], None] | None,
) -> tuple[TrainingState, np.ndarray, float]:
    steps, done = fixed[2].steps, int(state.step)
    began = saved = time.perf_counter()
    while done < steps:
        count = min(steps_per_call(), steps - done)
        state, new = train_steps(fixed, state, count)
        losses[done : done + count] = new
        done += count
        if not np.all(np.isfinite(losses[done - count : done])):
            raise ValueError(f"the loss is NaN at step {done}: give a smaller --rate")
        now = time.perf_counter()
        if folder is not None and (now - saved > _SAVE_SECONDS or done == steps):
            folder.save((state, losses, np.asarray(seconds + now - began)), 0, None)
            saved = now
        if progress is not None:
            progress(done, float(np.mean(losses[max(0, done - 200) : done])))
    return state, losses, seconds + time.perf_counter() - began


def _colour(denoiser: Denoiser) -> tuple[int, ...]:
    return (3,) if denoiser.network.channels == 3 else ()
