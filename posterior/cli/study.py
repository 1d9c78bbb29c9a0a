"""`posterior study`: the systems that a paper compares, on the same recordings."""

import contextlib
import hashlib
from pathlib import Path
from typing import Annotated

import typer

from ..files import replace_whole
from ..models.camera import Poisson
from ..models.priors.perturbation import PERTURBATIONS
from ..models.priors.storage import card_of
from ..studies import SYSTEMS, Answer, Denoising, as_table, held_out, measure, picture
from ..studies.denoising import electrons
from .options import Quiet

_STUDIES = ("denoising",)
_SIGMAS = ("0.025", "0.05", "0.1", "0.2")


def command(
    study: Annotated[str, typer.Argument(help=f"One of {', '.join(_STUDIES)}.")],
    data: Annotated[Path, typer.Option(help="Folder of the pictures that the prior's card lists.")],
    out: Annotated[Path, typer.Option(help="Folder for the answers, the table and the picture.")],
    prior: Annotated[
        str, typer.Option(help="Shipped weights, or paths up to -gaussian-score.safetensors.")
    ] = "nuclei",
    sigma: Annotated[
        list[str], typer.Option(help="Noise over full light; may be repeated.")
    ] = list(_SIGMAS),  # noqa: B006
    system: Annotated[
        list[str] | None, typer.Option(help=f"One of {'; '.join(SYSTEMS)}; unsaid: all.")
    ] = None,
    pictures: Annotated[int, typer.Option(help="2 or more.")] = 16,
    part: Annotated[str, typer.Option(help="test, or validation to choose settings on.")] = "test",
    size: Annotated[int, typer.Option(help="Side of the square patches.")] = 64,
    draws: Annotated[int, typer.Option(help="Of each system that samples, 2 or more.")] = 16,
    bits: Annotated[int, typer.Option(help="Of the ADC; 0: whole counts.")] = 8,
    seed: Annotated[int, typer.Option(help="Same seed, same recordings and draws.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Compare systems on pictures with a known truth; a study that was stopped goes on."""
    if study not in _STUDIES:
        raise ValueError(f"unknown study {study!r}: use {', '.join(_STUDIES)}")
    names = system or list(SYSTEMS)
    for name in names:
        if name not in SYSTEMS:
            raise ValueError(f"unknown system {name!r}: use one of {'; '.join(SYSTEMS)}")
    if min(pictures, draws) < 2:
        raise ValueError(f"--pictures {pictures}, --draws {draws}: give 2 or more of both")
    if part not in ("test", "validation"):
        raise ValueError(f"--part {part}: give test or validation")
    for value in sigma:
        Poisson(electrons(value), bits or None)
    card = card_of(prior)
    truths = held_out(card, data, part, pictures, size)
    work = Denoising(truths, prior, bits or None, draws, seed)
    identity = {
        "study": study, "weights": _weights(prior), "part": part, "size": size, "draws": draws,
        "bits": bits, "seed": seed, "first": hashlib.sha256(truths[0].tobytes()).hexdigest(),
    }  # fmt: skip
    found: dict[str, dict[str, Answer]] = {value: {} for value in sigma}
    for name, value, done, answer in measure(
        out / "answers", identity, names, list(sigma), pictures, work
    ):
        if not quiet and answer is None:
            print(f"sigma_0 = {value}, {name}: {done} of {pictures}", flush=True)
        if answer is not None:
            found[value][name] = answer
            _write(out, found, truths)
    print((out / "study.md").read_text(encoding="utf-8"), end="")


def _weights(prior: str) -> dict[str, str]:
    """Hash of the weights for each annealing error that the prior has."""
    found = {}
    for perturbation in PERTURBATIONS:
        with contextlib.suppress(FileNotFoundError, ValueError):
            found[perturbation] = card_of(prior, "score", perturbation)["sha256"]
    return found


def _write(out: Path, found: dict[str, dict[str, Answer]], truths) -> None:  # noqa: ANN001
    there = {value: answers for value, answers in found.items() if answers}
    text = "\n".join(as_table(value, answers, truths) for value, answers in there.items())
    replace_whole(out / "study.md", lambda p: Path(p).write_text(text, encoding="utf-8"))
    figure = picture(there, truths)
    replace_whole(out / "study.png", lambda p: figure.savefig(p, dpi=150, format="png"))
