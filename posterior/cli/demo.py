"""`posterior demo`: runs the examples into folders of --out and writes report.md.

Finished runs are kept, so that a demonstration that was interrupted goes on.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skimage import data as shipped
from skimage.color import rgb2hed

from ..files import replace_whole
from ..images import read_picture, to_grey, to_unit_range, write_tiff
from ..presets import DENOISING, PTYCHOGRAPHY, is_trained
from .options import Options, Out, Overwrite, Quiet
from .outputs import SETTINGS, prepare, read_settings
from .run import run
from .words import findings


class Example(NamedTuple):
    """A run of the demonstration, the picture that it records, and what its figure shows."""

    title: str
    name: str
    picture: Callable[[], np.ndarray]
    options: dict[str, Any]
    caption: str


def nuclei() -> np.ndarray:
    """Cell nuclei in tissue (128, 128) in 0..1: how much haematoxylin binds where.

    From scikit-image's picture of stained colon, by Ruifrok and Johnston's separation of the
    stains; the 99.5th percentile is 1, as for the pictures of the prior.
    """
    stain = rgb2hed(shipped.immunohistochemistry())[..., 0]
    stain = stain - np.percentile(stain, 2)
    return np.clip(stain / np.percentile(stain, 99.5), 0, 1)[236:364, 200:328]


def photograph() -> np.ndarray:
    """A picture from a tenth to six tenths of the full well: nothing is black or saturates."""
    return 0.1 + 0.5 * to_grey(to_unit_range(shipped.camera()))


EXAMPLES = {
    DENOISING: Example(
        "Denoising: cell nuclei in dim light",
        "nuclei",
        nuclei,
        {"full_well": 100, "bits": 8, "size": 128, "draws": 8, "prior": "nuclei"},
        "One recording of at most 100 electrons a pixel, the mean of what it allows and two of the "
        "pictures it allows; the error of the mean and the standard deviation have one colour "
        "scale, so where the scale says that the mean is sure it should also be right.",
    ),
    PTYCHOGRAPHY: Example(
        "Fourier ptychography: amplitude and phase of a thin specimen",
        "camera",
        photograph,
        {"full_well": 1000, "bits": 10, "size": 48, "draws": 400, "thin": 40, "warmup": 2000},
        "From 49 dim recordings, one a LED, a complex object of 48 x 48 pixels: "
        "amplitude above, phase in the middle, and below how sure both are.",
    ),
}


def command(
    out: Out = Path("out/demo"), overwrite: Overwrite = False, quiet: Quiet = False
) -> None:
    """Denoise cell nuclei and reconstruct a complex specimen, with figures and a report."""
    if (out / "report.md").exists() and not overwrite:
        raise ValueError(f"{out} already holds report.md: give another --out, or --overwrite")
    prepare(out, overwrite=True)
    sections = []
    for name, example in EXAMPLES.items():
        image = out / f"{example.name}.tif"
        _write_once(image, example.picture())
        options = Options(name, image=str(image), **example.options).resolved()
        settings = _finished(out / name, options)
        if settings is None:
            settings = run(options, out / name, overwrite=True, quiet=quiet)
        sections.append(_section(name, example, settings))
    text = _REPORT.format(sections="\n".join(sections))
    replace_whole(out / "report.md", lambda part: Path(part).write_text(text))
    print(f"the report is {out / 'report.md'}")


def _write_once(path: Path, picture: np.ndarray) -> None:
    if not path.exists():
        write_tiff(path, picture)
    elif not np.array_equal(read_picture(path), picture.astype("f4")):
        raise ValueError(f"{path} is another picture: give another --out")


def _finished(folder: Path, options: Options) -> dict[str, Any] | None:
    """The settings of a run of the demonstration that an interrupted one has finished."""
    if not (folder / SETTINGS).exists():
        return None
    settings = read_settings(folder / SETTINGS)
    return settings if Options(**settings["options"]) == options else None


def _section(name: str, example: Example, settings: dict[str, Any]) -> str:
    options = settings["options"]
    numbers = "\n".join(f"- {line}" for line in findings(settings["results"]))
    doubts = "\n".join(f"- {line}" for line in settings["warnings"])
    return _SECTION.format(
        title=example.title,
        figure=f"{name}/figure.png",
        caption=example.caption,
        file=settings["input"]["file"],
        numbers=numbers,
        doubts=doubts or "- nothing speaks against believing the intervals",
        **options | {"prior": _prior(options["prior"], settings["prior"])},
    )


def _prior(name: str | None, made_from: dict[str, str]) -> str:
    if is_trained(name):
        return f"the weights `{name}`, a network trained on pictures of another microscope"
    return f"a Gaussian field fitted to {len(made_from)} other pictures"


_REPORT = """# What a recording says, and how surely

Each example records a known picture with a simulated camera, forgets the picture, and draws from
everything that the recording allows. A draw is one possible object; where draws agree the recording
decides, where they differ it does not. The line "truth inside" is the test: an interval that claims
90 % has to hold the truth in about 90 % of the pixels.

{sections}
## What is certain, and what is not

The camera is known exactly: photon noise, full well and the steps of the ADC are in the
likelihood. The prior is not. That of the nuclei is a network which has seen glowing nuclei of
cultured cells, and no stained tissue. That of the specimen is a Gaussian field with the spectrum of
other pictures, so it expects the same roughness everywhere: flat areas get intervals that are a
little too wide, sharp edges intervals that are too narrow. The numbers above are averages over
both. One picture is one test: calibration over many is a study of its own.
"""

_SECTION = """## {title}

![{title}]({figure})

{caption}

- object: `{file}`, {size} x {size} pixels
- camera: full well {full_well} electrons, {bits} bits
- prior: {prior}
- sampler: {sampler}, {chains} chains x {draws} draws, seed {seed}

Found:

{numbers}

Doubts:

{doubts}
"""
