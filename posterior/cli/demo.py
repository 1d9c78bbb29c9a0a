"""`posterior demo`: runs the examples into folders of --out and writes report.md.

Finished runs are kept, so that a demonstration that was interrupted goes on.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skimage import data as shipped

from ..files import replace_whole
from ..images import read_picture, to_grey, to_unit_range, write_tiff
from ..presets import DENOISING, PTYCHOGRAPHY
from .options import Options, Out, Overwrite, Quiet
from .outputs import SETTINGS, prepare, read_settings
from .run import run
from .words import findings


class Example(NamedTuple):
    """A run of the demonstration, and what its figure shows, in one sentence."""

    title: str
    picture: str
    options: dict[str, Any]
    caption: str


EXAMPLES = {
    DENOISING: Example(
        "Denoising: a photograph in dim light",
        "camera",
        {"full_well": 100, "bits": 8, "size": 128, "draws": 500, "thin": 16, "warmup": 1500},
        "One recording of at most 100 electrons a pixel, the mean of what it allows and two of the "
        "pictures it allows; the error of the mean and the standard deviation have one colour "
        "scale, so where the scale says that the mean is sure it should also be right.",
    ),
    PTYCHOGRAPHY: Example(
        "Fourier ptychography: amplitude and phase of a thin specimen",
        "camera",
        {"full_well": 1000, "bits": 10, "size": 48, "draws": 400, "thin": 40, "warmup": 2000},
        "From 49 dim recordings, one a LED, a complex object of 48 x 48 pixels: "
        "amplitude above, phase in the middle, and below how sure both are.",
    ),
}


def command(
    out: Out = Path("out/demo"), overwrite: Overwrite = False, quiet: Quiet = False
) -> None:
    """Denoise a photograph and reconstruct a complex specimen, with figures and a report."""
    if (out / "report.md").exists() and not overwrite:
        raise ValueError(f"{out} already holds report.md: give another --out, or --overwrite")
    prepare(out, overwrite=True)
    sections = []
    for name, example in EXAMPLES.items():
        image = out / f"{example.picture}.tif"
        # From a tenth to six tenths of the full well: nothing is black, nothing saturates.
        picture = to_grey(to_unit_range(getattr(shipped, example.picture)()))
        _write_once(image, 0.1 + 0.5 * picture)
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
        others=len(settings["prior"]),
        numbers=numbers,
        doubts=doubts or "- nothing speaks against believing the intervals",
        **options,
    )


_REPORT = """# What a recording says, and how surely

Each example records a known picture with a simulated camera, forgets the picture, and draws from
everything that the recording allows. A draw is one possible object; where draws agree the recording
decides, where they differ it does not. The line "truth inside" is the test: an interval that claims
90 % has to hold the truth in about 90 % of the pixels.

{sections}
## What is certain, and what is not

The camera is known exactly: photon noise, full well and the steps of the ADC are in the
likelihood. The prior is not: it is a Gaussian field with the spectrum of other pictures, so it
expects the same roughness everywhere. Flat areas get intervals that are a little too wide, sharp
edges intervals that are too narrow; the numbers above are averages over both. One picture is one
test: calibration over many is a study of its own.
"""

_SECTION = """## {title}

![{title}]({figure})

{caption}

- object: `{file}`, {size} x {size} pixels
- camera: full well {full_well} electrons, {bits} bits
- prior: a Gaussian field fitted to {others} other pictures
- sampler: {sampler}, {chains} chains x {draws} draws, seed {seed}

Found:

{numbers}

Doubts:

{doubts}
"""
