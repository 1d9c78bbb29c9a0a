"""`posterior study`: the systems that a paper compares, on the same recordings."""

import contextlib
import hashlib
import os
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..diagnostics.features import HAAR, Features, bottleneck_features
from ..files import replace_whole, save_array
from ..models.priors import ScorePrior
from ..models.priors.perturbation import PERTURBATIONS
from ..models.priors.storage import card_of
from ..studies import (
    SYSTEMS,
    Answer,
    Captures,
    Denoising,
    Measured,
    as_table,
    held_out,
    left_halves_of,
    measure,
    measured_report,
    names_of,
    picture,
    read_captures,
)
from ..studies.denoising import camera_of
from ..studies.report import protocol
from . import study_approximations, study_phase, study_ptychography
from .options import Quiet, asked_of, study_data

_SIGMAS = ("0.025", "0.05", "0.1", "0.2")

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    help="Compare systems on the same recordings; a study that was stopped goes on.",
)
app.command("phase-retrieval")(study_phase.command)
app.command("ptychography")(study_ptychography.command)
app.command("approximations")(study_approximations.command)

Out = Annotated[Path, typer.Option(help="Folder for the answers, the table and the picture.")]
Prior = Annotated[
    str, typer.Option(help="Shipped weights, or paths up to -gaussian-score.safetensors.")
]
Systems = Annotated[
    list[str] | None,
    typer.Option("--system", help=f"One of {'; '.join(SYSTEMS)}; unsaid: all."),
]
Pictures = Annotated[int, typer.Option(help="2 or more.")]
Size = Annotated[int, typer.Option(help="Side of the square patches.")]
Draws = Annotated[int, typer.Option(help="Of each system that samples, 2 or more.")]
Seed = Annotated[int, typer.Option(help="Same seed, same recordings and draws.")]


@app.callback()
def leave_memory() -> None:
    """On an accelerator this process judges beside those that work, and would fill it."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


# What a study found so far: answers of its systems, by condition.
Found = dict[str, dict[str, Answer]]


@app.command("denoising")
def denoising(
    data: Annotated[Path, typer.Option(help="Folder of the pictures that the prior's card lists.")],
    out: Out,
    prior: Prior = "nuclei",
    sigma: Annotated[
        list[str], typer.Option(help="Noise over full light; may be repeated.")
    ] = list(_SIGMAS),  # noqa: B006
    system: Systems = None,
    pictures: Pictures = 16,
    part: Annotated[str, typer.Option(help="test, or validation to choose settings on.")] = "test",
    size: Size = 64,
    draws: Draws = 16,
    bits: Annotated[int, typer.Option(help="Of the ADC; 0: whole counts.")] = 8,
    headroom: Annotated[
        float, typer.Option(help="Of the well above white, in standard deviations of white.")
    ] = 0.0,
    seed: Seed = 0,
    features: Annotated[
        str, typer.Option(help="Of the Frechet distance: haar, or network, of the prior's own.")
    ] = "haar",
    quiet: Quiet = False,
) -> None:
    """Pictures with a known truth, recorded with true Poisson counts and an ADC."""
    names = _checked(system, pictures, draws)
    if part not in ("test", "validation"):
        raise ValueError(f"--part {part}: give test or validation")
    for value in sigma:
        camera_of(value, bits or None, headroom)
    truths = held_out(card_of(prior), study_data(data), part, pictures, size)
    seen = _features(features, prior, truths.shape[1:])
    identity = {
        "study": "denoising", "weights": _weights(prior), "part": part, "size": size,
        "draws": draws, "bits": bits, "seed": seed, "first": _hash(truths[0]),
    }  # fmt: skip
    if headroom:
        # Unsaid, folders of before there was one go on.
        identity["headroom"] = headroom
    work = Denoising(truths, prior, bits or None, draws, seed, headroom)
    about = (
        f"Here: {pictures} {part} pictures of the prior {prior}, {size}x{size}, true counts "
        f"{f'behind {bits} bits' if bits else 'as they are'}, in a well that holds "
        f"{f'{headroom:g} standard deviations of white more than' if headroom else 'no more than'} "
        f"white, {draws} draws of each system that samples, seed {seed}."
    )

    def write(found: Found) -> None:
        tables = [as_table(value, answers, truths, seen) for value, answers in found.items()]
        text = "\n".join([protocol(names, about), *tables])
        shown = {f"sigma_0 = {value}": answers for value, answers in found.items()}
        _write(out, text, shown, dict.fromkeys(shown, truths[0]))

    _run(out, dict.fromkeys(sigma, identity), names, pictures, work, write, quiet)


@app.command("measured")
def measured(
    data: Annotated[Path, typer.Option(help="Folder with raw/FIELD_*.png and gt/FIELD_1.png.")],
    out: Out,
    field: Annotated[
        list[str] | None, typer.Option(help="Name of a field; may be repeated; unsaid: all.")
    ] = None,
    prior: Prior = "cells",
    system: Systems = None,
    pictures: Annotated[int, typer.Option(help="Patches of each field, 2 or more.")] = 8,
    size: Size = 64,
    draws: Draws = 16,
    frames: Annotated[int, typer.Option(help="Captures in the average, these among them.")] = 50,
    seed: Seed = 0,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="A control: the model's counts of the average.")
    ] = False,
    right: Annotated[
        bool, typer.Option("--right", help="Patches of right halves alone, see --left-halves.")
    ] = False,
    left_halves: Annotated[
        bool,
        typer.Option("--left-halves", help="Only write those to --out, for posterior train."),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Captures of a real field, beside the average of many; the camera is estimated from them."""
    names = _checked(system, pictures, draws)
    weights = _weights(prior)
    data = study_data(data)
    fields = {name: read_captures(data, name, frames) for name in field or names_of(data)}
    if left_halves:
        _write_left_halves(out, fields)
        return
    work = Measured(fields, prior, size, draws, seed, simulated, right)
    for name in fields:
        work.truth(name, 0, scaled=True)
    identity = {
        "study": "measured", "weights": weights, "size": size, "draws": draws, "seed": seed,
        "simulated": simulated, "right": right,
    }  # fmt: skip
    identities = {name: {**identity, "captures": _hash(fields[name].captures)} for name in fields}

    def write(found: Found) -> None:
        shown = {
            name: {system: _in_grey(fields[name], answer) for system, answer in answers.items()}
            for name, answers in found.items()
        }
        truths = {name: work.truth(name, 0, scaled=True) for name in shown}
        _write(out, measured_report(work, found), shown, truths)

    _run(out, identities, names, pictures, work, write, quiet)


def _write_left_halves(out: Path, fields: dict[str, Captures]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for name, captures in fields.items():
        for i, part in enumerate(left_halves_of(captures)):
            save_array(out / f"{name}_{i}.npy", part)
    typer.echo(f"left halves of {len(fields)} average(s) written to {out}")


def _checked(system: list[str] | None, pictures: int, draws: int) -> list[str]:
    names = asked_of("system", system, SYSTEMS)
    if min(pictures, draws) < 2:
        raise ValueError(f"--pictures {pictures}, --draws {draws}: give 2 or more of both")
    return names


def _run(
    out: Path, identities: dict[str, dict[str, object]], systems: list[str], count: int,
    work: Callable[[str, str, int], np.ndarray], write: Callable[[Found], None], quiet: bool,
) -> None:  # fmt: skip
    """Every system on every recording of the conditions that `identities` names.

    Table and picture are written as answers come in.
    """
    found: Found = {}
    answers = chain.from_iterable(
        measure(out / "answers", identity, systems, [condition], count, work)
        for condition, identity in identities.items()
    )
    for name, condition, done, answer in answers:
        if not quiet and answer is None:
            print(f"{condition}, {name}: {done} of {count}", flush=True)
        if answer is not None:
            found.setdefault(condition, {})[name] = answer
            write(found)
    print((out / "study.md").read_text(encoding="utf-8"), end="")


def _features(name: str, prior: str, shape: tuple[int, ...]) -> Features:
    if name not in ("haar", "network"):
        raise ValueError(f"--features {name}: give haar or network")
    return HAAR if name == "haar" else bottleneck_features(ScorePrior.load(prior, shape))


def _weights(prior: str) -> dict[str, str]:
    """Hash of the weights for each annealing error that the prior has; refused if it has none."""
    found = {}
    for perturbation in PERTURBATIONS:
        with contextlib.suppress(FileNotFoundError, ValueError):
            found[perturbation] = card_of(prior, "score", perturbation)["sha256"]
    if not found:
        card_of(prior)
    return found


def _hash(array: np.ndarray) -> str:
    return hashlib.sha256(array.tobytes()).hexdigest()


def _in_grey(field, answer: Answer) -> Answer:  # noqa: ANN001
    return answer if answer.refusal else answer._replace(images=field.to_grey(answer.images))


def _write(out: Path, text: str, found: Found, truths: dict[str, np.ndarray]) -> None:
    replace_whole(out / "study.md", lambda p: Path(p).write_text(text, encoding="utf-8"))
    figure = picture(found, truths)
    replace_whole(out / "study.png", lambda p: figure.savefig(p, dpi=150, format="png"))
