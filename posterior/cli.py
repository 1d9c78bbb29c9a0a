"""The command line: `posterior sample`, `posterior repeat`, `posterior demo`.

A run is a folder: draws.nc, the maps as TIFF, figure.png and, written last, settings.json, from
which `repeat` makes the same draws again. While it lasts its checkpoint lies in the same folder.
"""

import dataclasses
import hashlib
import json
import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import numpy as np
import typer
from skimage import data as shipped

from . import presets
from .diagnostics.convergence import ess, rhat
from .diagnostics.plots import align_phase, complex_maps, overview
from .diagnostics.spread import interval
from .draws import Draws, versions
from .images import (
    read_picture,
    replace_whole,
    split_key,
    to_grey,
    to_unit_range,
    write_tiff,
)
from .models.camera import Poisson
from .models.optics import CONJUGATE_FLIP, Optics
from .presets import APPLICATIONS, DENOISING, PTYCHOGRAPHY, SAMPLERS, Question
from .samplers import Ensemble, Sampler
from .samplers.base import PopulationSampler
from .sampling import NonFiniteError, sample

SETTINGS, CHECKPOINT = "settings.json", "checkpoint"
OUTPUTS = ("draws.nc", "mean.tif", "sd.tif") + (
    "mean_amplitude.tif", "mean_phase.tif", "sd_amplitude.tif", "sd_phase.tif",
    "figure.png", SETTINGS,
)  # fmt: skip

_LEVEL = 0.9
_PERCENT = f"{_LEVEL * 100:.0f} %"
_COVERED = {
    "coverage": "pixels",
    "coverage_amplitude": "pixels, in amplitude",
    "coverage_phase": "pixels, in phase",
}
_MIXED = 1.05
_FEW = 100
_TOO_NARROW = 0.85
_RANGES = {
    "full_well": (1, 2**23 - 1),
    "bits": (0, 16),
    "draws": (1, None),
    "chains": (1, None),
    "warmup": (0, None),
    "thin": (1, None),
    "seed": (0, 2**31 - 1),
    "size": (4, None),
    "page": (0, None),
    "oversampling": (1, None),
}
_APPROXIMATE = ("annealed", "annealed-split", "ula")
_REFUSED = (ValueError, NonFiniteError, OSError)

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Draw the posterior of an imaging problem: what a recording says, and how surely.",
)


@dataclasses.dataclass(frozen=True)
class Options:
    """All that decides the draws of a run. None: not said; 0 bits: no ADC."""

    problem: str
    image: str | None = None
    data: str | None = None
    full_well: int | None = None
    bits: int | None = None
    sampler: str | None = None
    draws: int | None = None
    chains: int = 4
    warmup: int | None = None
    thin: int | None = None
    seed: int = 0
    size: int | None = None
    prior: str | None = None
    irradiance: float | None = None
    page: int | None = None
    oversampling: int | None = None

    def resolved(self) -> "Options":
        """With the defaults of problem and sampler filled in; refuses what cannot go together."""
        application = _known("problem", self.problem, APPLICATIONS)
        name = self.sampler or application.sampler
        sampling = _known("sampler", name, SAMPLERS)
        if (self.image is None) == (self.data is None):
            raise ValueError("give either --image (a picture to record) or --data (a recording)")
        if self.data is not None and self.full_well is None:
            raise ValueError("--data needs --full-well: how many electrons saturate a pixel")
        for option, (least, most) in _RANGES.items():
            _check_range(option, getattr(self, option), least, most)
        simulated = self.image is not None
        return dataclasses.replace(
            self,
            image=_absolute(self.image),
            data=_absolute(self.data),
            prior=_absolute(self.prior),
            full_well=application.full_well if self.full_well is None else self.full_well,
            bits=(application.bits if simulated else 0) if self.bits is None else self.bits,
            sampler=name,
            draws=sampling.draws if self.draws is None else self.draws,
            thin=sampling.thin if self.thin is None else self.thin,
        )


# ---- commands ------------------------------------------------------------------------------------

Out = Annotated[Path, typer.Option(help="Folder of the results.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the results in --out.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show no progress.")]


@app.command("sample")
def sample_command(
    problem: Annotated[str, typer.Argument(help=f"One of {', '.join(APPLICATIONS)}.")],
    out: Out,
    image: Annotated[str | None, typer.Option(help="A clean picture, to be recorded.")] = None,
    data: Annotated[str | None, typer.Option(help="A recording: codes, or fractions of 1.")] = None,
    full_well: Annotated[int | None, typer.Option(help="Electrons at saturation.")] = None,
    bits: Annotated[int | None, typer.Option(help="Of the ADC; 0: none.")] = None,
    sampler: Annotated[str | None, typer.Option(help=f"One of {', '.join(SAMPLERS)}.")] = None,
    draws: Annotated[int | None, typer.Option(help="Draws a chain.")] = None,
    chains: Annotated[int, typer.Option(help="Independent chains.")] = 4,
    warmup: Annotated[int | None, typer.Option(help="Steps that tune the sampler.")] = None,
    thin: Annotated[int | None, typer.Option(help="Steps from draw to draw.")] = None,
    seed: Annotated[int, typer.Option(help="Same seed, same draws.")] = 0,
    size: Annotated[int | None, typer.Option(help="Pixels a side of the object.")] = None,
    prior: Annotated[str | None, typer.Option(help="A picture, or a folder of them.")] = None,
    irradiance: Annotated[float | None, typer.Option(help="Signal at a field of 1.")] = None,
    page: Annotated[int | None, typer.Option(help="Of a file of many, from 0.")] = None,
    oversampling: Annotated[int | None, typer.Option(help="Of the far field.")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Draw the posterior of a picture that is recorded (--image), or of a recording (--data)."""
    said = locals()
    options = {field.name: said[field.name] for field in dataclasses.fields(Options)}
    run(Options(**options), out, overwrite, quiet)


@app.command("repeat")
def repeat_command(
    settings: Annotated[Path, typer.Argument(help="The settings.json of a finished run.")],
    out: Out,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Run again what settings.json says, on the same input: the same draws."""
    earlier = _read_settings(settings)
    run(Options(**earlier["options"]), out, overwrite, quiet, earlier)


@app.command("demo")
def demo_command(
    out: Out = Path("out/demo"), overwrite: Overwrite = False, quiet: Quiet = False
) -> None:
    """Denoise a photograph and reconstruct a complex specimen, with figures and a report."""
    demo(out, overwrite, quiet)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point: every error that a user can cause is one sentence and exit status 2."""
    try:
        status = app(arguments, prog_name="posterior", standalone_mode=False)
    except _REFUSED as error:
        status = _refuse(_sentence(error))
    except Exception as error:
        # What typer raises for a mistyped command has no public base class.
        if not hasattr(error, "format_message"):
            raise
        status = _refuse(f"{error.format_message().rstrip('.')}; see posterior --help")
    sys.exit(status)


# ---- a run ---------------------------------------------------------------------------------------


def run(
    options: Options,
    out: Path,
    overwrite: bool = False,
    quiet: bool = False,
    earlier: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Sample, write the results to `out`, say what was found; returns the settings written.

    A run that was killed goes on from its checkpoint. With `earlier`, settings of a finished run,
    it refuses an input or a prior that has changed since. Raises as `sample` does, ValueError for
    options that do not fit, and OSError if `out` cannot be written.
    """
    options, began = options.resolved(), time.perf_counter()
    source = options.image or options.data
    digest = _file_hash(source)
    key_record, key_start, key_draws = jax.random.split(jax.random.key(options.seed), 3)
    question = _question(options, key_record)
    _refuse_changed(earlier, digest, question)
    posterior = question.problem.condition(question.y)
    sampler = SAMPLERS[options.sampler].build(posterior)
    if isinstance(sampler, Ensemble):
        sampler.size(posterior)
    created = _prepare(out, overwrite)
    try:
        draws = sample(
            posterior,
            sampler,
            key_draws,
            chains=options.chains,
            draws=options.draws,
            warmup=options.warmup,
            thin=options.thin,
            start=presets.start_of(options.sampler, posterior, key_start, options.chains),
            progress=not quiet,
            checkpoint=out / CHECKPOINT,
        )
    except KeyboardInterrupt:
        print(
            f"interrupted: what is done is in {out / CHECKPOINT}, the same command goes on from it",
            file=sys.stderr,
        )
        raise typer.Exit(130) from None
    except ValueError:
        if created and not any(out.iterdir()):
            out.rmdir()
        raise
    summary = _summary(draws, question, options, sampler)
    settings = {
        "options": dataclasses.asdict(options),
        "input": {"file": Path(source).name, "sha256": digest},
        "prior": question.prior,
        "irradiance": question.irradiance,
        "sampler": draws.settings["sampler"],
        "warmup": draws.settings["warmup"],
        "results": summary.results,
        "warnings": summary.warnings,
        "seconds": round(time.perf_counter() - began, 1),
        "versions": versions(),
    }
    _write(out, draws, question, summary, settings)
    _tell(out, settings)
    return settings


def _question(options: Options, key: jax.Array) -> Question:
    camera = Poisson(options.full_well, options.bits or None)
    picture = read_picture(options.image or options.data, options.page)
    given = {
        name: getattr(options, name) for name in ("size", "prior", "irradiance", "oversampling")
    }
    if options.data is not None:
        return presets.record(options.problem, picture, camera, **given)
    return presets.simulate(options.problem, picture, camera, key, **given)


def _prepare(out: Path, overwrite: bool) -> bool:
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


def _refuse_changed(earlier: dict[str, Any] | None, digest: str, question: Question) -> None:
    if earlier is None:
        return
    file = earlier["options"]["image"] or earlier["options"]["data"]
    if earlier["input"]["sha256"] != digest:
        raise ValueError(f"{file} has changed since the run: put the same file there")
    if earlier["prior"] != question.prior:
        changed = sorted(set(earlier["prior"].items()) ^ set(question.prior.items()))
        raise ValueError(f"prior picture {changed[0][0]} has changed since the run: put it back")


def _read_settings(path: Path) -> dict[str, Any]:
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


# ---- what the draws say --------------------------------------------------------------------------


class Summary(NamedTuple):
    """Draws (chains, draws, *shape) with what the data cannot tell aligned, and what they say.

    `maps` are the pictures to write, by file name; `sd` and `width` are as `overview` takes them.
    """

    values: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    width: np.ndarray
    maps: dict[str, np.ndarray]
    results: dict[str, float]
    warnings: list[str]


def _summary(draws: Draws, question: Question, options: Options, sampler: Sampler) -> Summary:
    truth = question.truth
    values = _aligned(draws.values, question.problem.likelihood.optics, truth)
    mean = values.mean(axis=(0, 1))
    results = {}
    if truth is not None and options.problem == DENOISING:
        results["psnr_data"] = _psnr(question.y, truth)
    if np.iscomplexobj(mean):
        maps = complex_maps(values, _LEVEL)
        sd = np.stack([maps.sd_amplitude, maps.sd_phase])
        width = np.stack([maps.width_amplitude, maps.width_phase])
        pictures = {f"{n}.tif": getattr(maps, n) for n in maps._fields if "width" not in n}
        turn = np.exp(-1j * np.angle(mean))
        compared = {"coverage_amplitude": np.abs, "coverage_phase": lambda x: np.angle(x * turn)}
    else:
        low, high = interval(values, _LEVEL)
        sd, width = values.std(axis=(0, 1)), high - low
        pictures = {"mean.tif": mean, "sd.tif": sd}
        compared = {"coverage": lambda x: x}
    if truth is not None:
        results["psnr_mean"] = _psnr(mean, truth)
        for name, part in compared.items():
            results[name] = _coverage(part(values), part(truth))
    results |= _convergence(values, sampler)
    warnings = _warnings(results, options)
    return Summary(values, mean, sd, width, pictures, results, warnings)


def _aligned(values: np.ndarray, optics: Optics, truth: np.ndarray | None) -> np.ndarray:
    """Draws that the data cannot tell apart, brought together: global phase, or twin image.

    Then, where the truth is known, all of them are turned to it as one.
    """
    if np.iscomplexobj(values):
        values = align_phase(values)
        if truth is None:
            return values
        return values * np.exp(1j * np.angle(np.vdot(values.mean(axis=(0, 1)), truth)))
    if CONJUGATE_FLIP not in optics.symmetries:
        return values
    values = _untwinned(values, values[0, 0])
    values = _untwinned(values, values.mean(axis=(0, 1)))
    is_twin = truth is not None and _nearer_twin(values.mean(axis=(0, 1)), truth)
    return _twin(values) if is_twin else values


def _untwinned(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Real draws, each turned by 180 degrees if that brings it nearer to `reference`."""
    return np.array(
        [[_twin(x) if _nearer_twin(x, reference) else x for x in chain] for chain in values]
    )


def _twin(x: np.ndarray) -> np.ndarray:
    return np.flip(x, axis=(-2, -1))


def _nearer_twin(x: np.ndarray, reference: np.ndarray) -> bool:
    return bool(np.vdot(_twin(x), reference) > np.vdot(x, reference))


def _psnr(estimate: np.ndarray, truth: np.ndarray) -> float:
    """In dB, the peak being 1, or the largest amplitude of a complex truth."""
    peak = np.abs(truth).max() if np.iscomplexobj(truth) else 1.0
    return float(10 * np.log10(peak**2 / np.mean(np.abs(estimate - truth) ** 2)))


def _coverage(values: np.ndarray, truth: np.ndarray) -> float:
    low, high = interval(values, _LEVEL)
    return float(np.mean((low <= truth) & (truth <= high)))


def _convergence(values: np.ndarray, sampler: Sampler) -> dict[str, float]:
    """Largest R-hat and smallest effective sample size of all pixels (Re and Im apart)."""
    if len(values) < 2 or values.shape[1] < 4:
        return {}
    parts = (values.real, values.imag) if np.iscomplexobj(values) else (values,)
    # Chains that never move have no R-hat: as bad as can be.
    with np.errstate(all="ignore"):
        worst = [rhat(p) for p in parts]
        worst = np.where(np.isnan(worst), np.inf, worst)
        found = {"rhat": float(np.max(worst)), "unmixed": float(np.mean(worst > _MIXED))}
        # Particles have no order: counting their correlation would say nothing.
        if not isinstance(sampler, PopulationSampler):
            found["ess"] = float(np.min(np.nan_to_num([ess(p) for p in parts])))
    return found


def _warnings(results: dict[str, float], options: Options) -> list[str]:
    """What stands against believing the intervals."""
    said = []
    if "rhat" not in results:
        said.append(
            "convergence is not checked: that takes 2 chains and 4 draws of each, give --chains 4"
        )
    elif results["rhat"] > _MIXED:
        said.append(
            f"the chains have not mixed: R-hat is above {_MIXED} in "
            f"{100 * results['unmixed']:.1f} % of the pixels, up to {results['rhat']:.3g}; do not "
            "trust the intervals there, give more --thin, --draws or --warmup"
        )
    if results.get("ess", _FEW) < _FEW:
        said.append(
            f"only {results['ess']:.0f} effective draws in the worst pixel: the ends of its "
            f"interval are rough below {_FEW}, give more --draws"
        )
    if options.sampler in _APPROXIMATE:
        said.append(f"{options.sampler} is approximate: check its intervals against mala or nuts")
    for name, value in results.items():
        if name in _COVERED and value < _TOO_NARROW:
            said.append(
                f"the intervals are too narrow: they hold the truth in {100 * value:.0f} % of the "
                f"{_COVERED[name]}, not {_PERCENT}; the prior does not describe this picture, or "
                "the chains have not mixed"
            )
    return said


# ---- what is written and said --------------------------------------------------------------------


def _write(
    out: Path, draws: Draws, question: Question, summary: Summary, settings: dict[str, Any]
) -> None:
    """All results, each there whole or not at all, settings.json last."""
    problem = settings["options"]["problem"]
    draws.save(out / "draws.nc")
    for name, picture in summary.maps.items():
        write_tiff(out / name, picture)
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
            title=_headline(settings),
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
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _headline(settings: dict[str, Any]) -> str:
    options, results = settings["options"], settings["results"]
    parts = [f"{options['problem']}, full well {options['full_well']} electrons"]
    if "psnr_data" in results:
        parts.append(f"recording {results['psnr_data']:.1f} dB")
    if "psnr_mean" in results:
        parts.append(f"mean {results['psnr_mean']:.1f} dB")
    return ", ".join(parts)


def _tell(out: Path, settings: dict[str, Any]) -> None:
    options, results = settings["options"], settings["results"]
    print(
        f"{options['problem']} of {settings['input']['file']}: {options['sampler']}, "
        f"{options['chains']} chains x {options['draws']} draws, {settings['seconds']:.0f} s"
    )
    for line in _lines(results):
        print(line)
    for warning in settings["warnings"]:
        print(f"warning: {warning}")
    print(f"written to {out}")


def _lines(results: dict[str, float]) -> list[str]:
    """The numbers of a run in words."""
    lines = []
    if "psnr_data" in results:
        lines.append(f"PSNR of the recording: {results['psnr_data']:.2f} dB")
    if "psnr_mean" in results:
        lines.append(f"PSNR of the posterior mean: {results['psnr_mean']:.2f} dB")
    lines += [
        f"truth inside the {_PERCENT} interval: {100 * value:.1f} % of the {_COVERED[name]}"
        for name, value in results.items()
        if name in _COVERED
    ]
    if "rhat" in results:
        lines.append(f"R-hat, largest of all pixels: {results['rhat']:.4g}")
    if "ess" in results:
        lines.append(f"effective draws, smallest of all pixels: {results['ess']:.0f}")
    return lines


def _known(kind: str, name: str, table: dict[str, Any]) -> Any:
    if name not in table:
        raise ValueError(f"unknown {kind} {name!r}: use one of {', '.join(table)}")
    return table[name]


def _check_range(option: str, value: int | None, least: int, most: int | None) -> None:
    if value is None:
        return
    # settings.json can hold anything.
    if not isinstance(value, int) or value < least or (most is not None and value > most):
        wanted = f"{least} or more" if most is None else f"{least} to {most}"
        raise ValueError(f"--{option.replace('_', '-')} {value}: give a whole number, {wanted}")


def _absolute(path: str | None) -> str | None:
    return None if path is None else os.path.abspath(path)


def _file_hash(path: str) -> str:
    file = split_key(path)[0]
    if not os.path.isfile(file):
        raise FileNotFoundError(f"no file {file}: give the path of a picture")
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _refuse(sentence: str) -> int:
    print(f"posterior: {sentence}", file=sys.stderr)
    return 2


def _sentence(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


# ---- the demonstration ---------------------------------------------------------------------------


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
        {"full_well": 100, "bits": 8, "size": 128, "draws": 500, "thin": 25, "warmup": 2000},
        "One recording of at most 100 electrons a pixel, the mean of what it allows and two of the "
        "pictures it allows; the error of the mean and the standard deviation have one colour "
        "scale, so where the scale says that the mean is sure it should also be right.",
    ),
    PTYCHOGRAPHY: Example(
        "Fourier ptychography: amplitude and phase of a thin specimen",
        "camera",
        {"full_well": 1000, "bits": 10, "size": 48, "draws": 300, "thin": 30, "warmup": 2000},
        "From 49 dim recordings, one a LED, a complex object of 48 x 48 pixels: "
        "amplitude above, phase in the middle, and below how sure both are.",
    ),
}


def demo(out: Path, overwrite: bool = False, quiet: bool = False) -> None:
    """Run the examples into folders of `out`, and write report.md; finished ones are kept."""
    if (out / "report.md").exists() and not overwrite:
        raise ValueError(f"{out} already holds report.md: give another --out, or --overwrite")
    _prepare(out, overwrite=True)
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
    settings = _read_settings(folder / SETTINGS)
    return settings if Options(**settings["options"]) == options else None


def _section(name: str, example: Example, settings: dict[str, Any]) -> str:
    options = settings["options"]
    numbers = "\n".join(f"- {line}" for line in _lines(settings["results"]))
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


if __name__ == "__main__":
    main()
