"""`posterior train`: a prior from a folder of pictures."""

import dataclasses
import os
import shlex
from pathlib import Path
from typing import Annotated, Any

import equinox as eqx
import jax
import numpy as np
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ..diagnostics.shared_errors import knows_means, shared_errors
from ..models.priors.denoiser import Denoiser, Statistics
from ..models.priors.learned import LearnedPrior
from ..models.priors.perturbation import PERTURBATIONS, check_perturbation
from ..models.priors.pictures import SYMMETRIES
from ..models.priors.storage import build_network, load_denoiser, read_card, save_weights
from ..models.priors.training import PRECISIONS, Recipe
from ..prior_calibration import calibration
from ..train import (
    HOLD_OUT,
    OBJECTS,
    Preparation,
    normalisation,
    picture_files,
    prepare,
    split_names,
    statistics_of,
    train,
)
from ..training_report import SIGMAS, denoising, doubts, on_patches, write_report
from .options import study_data


def command(
    out: Annotated[Path, typer.Option(help="NAME.safetensors, beside it its card and report.")],
    data: Annotated[
        Path | None, typer.Option(help="Folder of pictures; may be one inside POSTERIOR_DATA.")
    ] = None,
    perturbation: Annotated[
        str, typer.Option(help=f"One of {', '.join(PERTURBATIONS)}.")
    ] = "gaussian",
    kind: Annotated[str, typer.Option(help="score, or energy.")] = "score",
    objects: Annotated[str, typer.Option(help=f"One of {', '.join(OBJECTS)}.")] = "grey",
    percentile: Annotated[
        float | None, typer.Option(help="Divide each picture by this percentile, clip at 1.")
    ] = None,
    floor: Annotated[float, typer.Option(help="Least value of a picture, for signal.")] = 0.01,
    crop: Annotated[int | None, typer.Option(help="Keep the central square of this side.")] = None,
    resize: Annotated[int | None, typer.Option(help="Bring the central square to it.")] = None,
    size: Annotated[int, typer.Option(help="Pixels a side of a training patch.")] = 48,
    steps: Annotated[int, typer.Option(help="Steps of Adam.")] = 5000,
    batch: Annotated[int, typer.Option(help="Patches a step.")] = 16,
    symmetry: Annotated[
        str, typer.Option(help=f"Patches are also turned: one of {', '.join(SYMMETRIES)}.")
    ] = "square",
    rate: Annotated[float, typer.Option(help="Learning rate at its highest.")] = 2e-3,
    clip: Annotated[float, typer.Option(help="Largest norm of a gradient.")] = 1.0,
    precision: Annotated[
        str, typer.Option(help=f"Of the convolutions: {' or '.join(PRECISIONS)} (accelerators).")
    ] = "float32",
    averages: Annotated[
        float,
        typer.Option(
            help="Weight of errors of averages (over 2, 4, ... pixels, the whole patch) beside "
            "those of pixels, as 0.004; far more costs sharpness."
        ),
    ] = 0.0,
    areas: Annotated[
        float,
        typer.Option(
            help="Weight of errors of averages over pixels that the network takes for equally "
            "bright, which decide areas above a threshold, as 0.008; more costs what is dark."
        ),
    ] = 0.0,
    network: Annotated[str, typer.Option(help="unet, or ncsnv2.")] = "unet",
    widths: Annotated[str, typer.Option(help="Channels of each level.")] = "32,64,96",
    blocks: Annotated[int, typer.Option(help="Residual blocks a level.")] = 1,
    validation: Annotated[int, typer.Option(help="Pictures held out to watch.")] = 32,
    test: Annotated[int, typer.Option(help="Pictures held out and not looked at.")] = 0,
    hold_out: Annotated[
        str, typer.Option(help=f"Which pictures: {' or '.join(HOLD_OUT)} by name.")
    ] = "random",
    group: Annotated[str, typer.Option(help="Pattern: names that match alike stay together.")] = (
        ".*"
    ),
    init: Annotated[str | None, typer.Option(help="Weights to start from (.safetensors).")] = None,
    seed: Annotated[int, typer.Option(help="Same seed, same weights.")] = 0,
    source: Annotated[str, typer.Option(help="Of the pictures, for the card.")] = "not stated",
    licence: Annotated[str, typer.Option(help="Of the pictures, for the card.")] = "not stated",
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Train a prior on a folder of pictures; the same command goes on where it was stopped."""
    command = _command(locals())
    check_perturbation(perturbation, objects == "complex")
    if perturbation == "poisson" and kind == "energy":
        raise ValueError("--kind energy: counts have no density to learn, use --kind score")
    least = floor if perturbation == "signal" else 0.0
    how = Preparation(objects, percentile, least, group, validation, test, hold_out, crop, resize)
    recipe = Recipe(
        kind, steps, batch, size, rate, clip=clip, seed=seed, symmetry=symmetry,
        precision=precision, averages=averages, areas=areas,
    )  # fmt: skip
    recipe.check(perturbation)
    folder = _data_folder(data)
    files = {p.name: p for p in picture_files(folder)}
    # All of them, and first: a file that cannot be read is the cause to tell.
    loaded = {name: prepare(file, how) for name, file in files.items()}
    split = split_names(list(files), validation, test, group, hold_out)
    pictures = [loaded[n] for n in split.train if min(loaded[n].shape[:2]) >= size]
    if not pictures:
        raise ValueError(f"no picture in {folder} has {size} pixels a side: give a smaller --size")
    statistics = statistics_of(pictures, perturbation, how, size)
    description = _description(network, OBJECTS[objects], _widths(widths), blocks)
    built = build_network(description, jax.random.key(seed))
    if init is not None:
        built = _initial(init, built)
    denoiser, losses, seconds = _with_progress(
        Denoiser(built, statistics), pictures, recipe, Path(f"{_stem(out)}.training"), quiet
    )
    held_out = [loaded[n] for n in split.validation]
    prior, validation = _validated(denoiser, kind, held_out, quiet)
    table = validation["denoising_psnr_db"]
    against = doubts(losses, table, validation.get("shared_errors", {}))
    card = {
        "name": _stem(out).name,
        "kind": kind,
        "network": description,
        "data": {
            "folder": folder.name,
            "source": source,
            "licence": licence,
            "pictures": {part: len(getattr(split, part)) for part in split._fields},
            "validation": split.validation,
            "test": split.test,
        },
        "normalisation": normalisation(how),
        "preparation": dataclasses.asdict(how),
        "training": {
            "command": command,
            "recipe": dataclasses.asdict(recipe),
            "seconds": round(seconds),
            "patches_per_second": round(recipe.steps * recipe.batch / max(seconds, 1e-9), 1),
            "device": _device(),
            "final_loss": round(float(np.mean(losses[-max(1, steps // 20) :])), 4),
        },
        "validation": validation,
        "limits": [*against, *_limits(statistics, size)],
    }
    save_weights(f"{_stem(out)}.safetensors", denoiser, card)
    write_report(Path(f"{_stem(out)}.training"), prior, losses, table, seed)
    for doubt in against:
        print(f"warning: {doubt}")


def _validated(
    denoiser: Denoiser, kind: str, pictures: list[np.ndarray], quiet: bool
) -> tuple[LearnedPrior, dict[str, Any]]:
    """The prior for patches, and what it is worth on pictures that it was not trained on."""
    prior, patches = on_patches(denoiser, kind, pictures)
    found = {"denoising_psnr_db": denoising(prior, patches), "patches": len(patches)}
    if knows_means(prior):
        found["shared_errors"] = shared_errors(prior, patches, SIGMAS)
    if prior.perturbation == "poisson":
        found["calibration"] = calibration(prior, patches, quiet=quiet)
    return prior, found


def _limits(statistics: Statistics, size: int) -> list[str]:
    """What the weights are not good for, for the card."""
    signal = [
        "Draws of the prior alone come out far too dark: the network knows the harmonic mean, not "
        "the mean, and the broadest level is not pure noise.",
    ]
    return [
        *(signal if statistics.perturbation == "signal" else []),
        f"Levels below {statistics.sigma_min:g} are held at it; above {statistics.sigma_max:g} "
        "the network sees a picture that is fainter than any it was trained on.",
        f"Trained on patches of {size} pixels: it knows no structure much larger than that.",
        "Pictures in other units, of other things or from other optics are outside the prior.",
    ]


def _stem(out: Path) -> Path:
    return out.with_suffix("") if out.suffix == ".safetensors" else out


def _data_folder(data: Path | None) -> Path:
    """Of --data; unsaid, the folder that POSTERIOR_DATA names."""
    home = os.environ.get("POSTERIOR_DATA")
    if data is None and home is None:
        raise ValueError("no pictures: give a folder with --data, or set POSTERIOR_DATA")
    return Path(home) if data is None else study_data(data)


def _widths(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"widths {text!r}: give whole numbers, as in 32,64,96") from None


def _description(network: str, channels: int, widths: list[int], blocks: int) -> dict[str, Any]:
    """The network's entry in the card; NCSNv2 has one width, which it doubles itself."""
    sizes = {"width": widths[0]} if network == "ncsnv2" else {"widths": widths}
    return {"type": network, "channels": channels, **sizes, "blocks": blocks}


def _initial(path: str, fresh: eqx.Module) -> eqx.Module:
    """The network of earlier weights, which must have the shapes of the one asked for."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"no file {path}: give the path of a .safetensors file")
    card = read_card(Path(path))
    earlier = load_denoiser(path, card["kind"], card["statistics"]["perturbation"]).network
    shapes = [
        jax.tree.map(lambda a: a.shape, eqx.filter(n, eqx.is_array)) for n in (fresh, earlier)
    ]
    if jax.tree.leaves(shapes[0]) != jax.tree.leaves(shapes[1]):
        raise ValueError(f"{path} holds another network: give the --widths it was built with")
    return earlier


def _with_progress(
    denoiser: Denoiser, pictures: list[np.ndarray], recipe: Recipe, checkpoint: Path, quiet: bool
) -> tuple[Denoiser, np.ndarray, float]:
    columns = (
        TextColumn("training"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("loss {task.fields[loss]:.4f}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, disable=quiet, refresh_per_second=2) as bar:
        task = bar.add_task("training", total=recipe.steps, loss=float("nan"))
        return train(
            denoiser,
            pictures,
            recipe,
            checkpoint,
            lambda done, loss: bar.update(task, completed=done, loss=loss),
        )


def _command(options: dict[str, Any]) -> str:
    """The command line that gives these options, without paths of one computer."""
    parts = ["posterior", "train"]
    for name, value in options.items():
        if value is None or name == "quiet":
            continue
        value = Path(value).name if name in ("data", "out", "init") else value
        parts += [f"--{name.replace('_', '-')}", shlex.quote(str(value))]
    return " ".join(parts)


def _device() -> str:
    device = jax.devices()[0]
    if device.platform == "cpu":
        return f"CPU, {os.cpu_count()} cores, jax {jax.__version__}"
    return f"{device.device_kind}, jax {jax.__version__}"
