"""The folder of a run: draws.nc, the maps as TIFF, figure.png and, written last, settings.json."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from .. import presets
from ..diagnostics.plots import overview
from ..draws import Draws
from ..files import replace_whole
from ..images import write_tiff
from ..presets import DENOISING, Question
from .options import Options
from .summary import Summary
from .words import headline

SETTINGS, CHECKPOINT = "settings.json", "checkpoint"
OUTPUTS = ("draws.nc", "mean.tif", "sd.tif") + (
    "mean_amplitude.tif", "mean_phase.tif", "sd_amplitude.tif", "sd_phase.tif",
    "figure.png", SETTINGS,
)  # fmt: skip


def prepare(out: Path, overwrite: bool) -> bool:
    """Make sure that `out` is a folder to write to, without results; whether it was made here."""
    found = [name for name in OUTPUTS if (out / name).exists()]
    unfinished = (out / CHECKPOINT).exists() and SETTINGS not in found
    if found and not overwrite and not unfinished:
        raise ValueError(
            f"{out} already holds {found[0]}: give another --out, or --overwrite to replace it"
        )
    created = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ValueError(f"cannot write to {out} ({error.strerror}): give another --out") from error
    return created


def write(
    out: Path, draws: Draws, question: Question, summary: Summary, settings: dict[str, Any]
) -> None:
    """All results, each there whole or not at all, settings.json last."""
    problem = settings["options"]["problem"]
    draws.save(out / "draws.nc")
    for name, picture in summary.maps.items():
        write_tiff(out / name, picture, colour=picture.ndim == 3)
    shown, heading = presets.picture_of(problem, question.y)
    replace_whole(
        out / "figure.png",
        lambda part: overview(
            part,
            question.truth,
            shown,
            _few_draws(summary.values),
            summary.mean,
            summary.sd,
            summary.width,
            data_title=heading,
            data_is_object=problem == DENOISING,
            title=headline(settings),
            level=summary.level,
        ),
    )
    written = {"draws.nc", "figure.png", SETTINGS, *summary.maps}
    for name in set(OUTPUTS) - written:
        (out / name).unlink(missing_ok=True)
    text = json.dumps(_json(settings), indent=2)
    replace_whole(out / SETTINGS, lambda part: Path(part).write_text(text + "\n"))
    shutil.rmtree(out / CHECKPOINT)


def _few_draws(values: np.ndarray) -> list[np.ndarray]:
    """Four draws, as far apart as there are chains and draws."""
    chains, draws = values.shape[:2]
    return [values[i % chains, -1 - (i * draws // 4)] for i in range(4)]


def _json(value: Any) -> Any:
    """JSON has no infinity: such a number is written as null."""
    if isinstance(value, dict):
        return {k: _json(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_json(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def read_settings(path: Path) -> dict[str, Any]:
    """The settings.json of a finished run; ValueError for a file that is none."""
    if not path.is_file():
        raise FileNotFoundError(f"no file {path}: give the {SETTINGS} of a finished run")
    fields = {f.name for f in dataclasses.fields(Options)}
    try:
        found = json.loads(path.read_text())
        if set(found["options"]) != fields or not {"input", "prior"} <= set(found):
            raise ValueError
        found["input"]["sha256"]
    except (ValueError, KeyError, TypeError):
        raise ValueError(
            f"{path} is not the {SETTINGS} of a run: give one of this version"
        ) from None
    return found
