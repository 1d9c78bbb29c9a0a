"""`posterior study approximations`: what forms and paths of the annealed score cost."""

from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..files import replace_whole
from ..models.priors.storage import card_of
from ..studies.approximations import (
    APPLICATIONS,
    CHAINS,
    EXACT,
    PICTURES,
    VARIANTS,
    Approximations,
    OnPictures,
)
from ..studies.approximations_plot import cost_picture
from ..studies.approximations_report import Cost, cost_table, costs
from ..studies.harness import Answer, measure
from ..studies.pictures import held_out
from .options import Quiet, asked_of, study_data

# Score networks err by more the longer they are followed: their presets have 45 levels of 4 steps.
_PICTURE_LEVELS, _PICTURE_STEPS = 45, 4
_FULL_WELL = 100


def command(
    out: Annotated[Path, typer.Option(help="Folder for the answers, the table and the picture.")],
    problem: Annotated[
        list[str] | None, typer.Option(help=f"One of {'; '.join(APPLICATIONS)}; unsaid: all.")
    ] = None,
    variant: Annotated[
        list[str] | None, typer.Option(help=f"One of {'; '.join(VARIANTS)}; unsaid: all.")
    ] = None,
    recordings: Annotated[int, typer.Option(help="Of each problem, 2 or more.")] = 8,
    draws: Annotated[int, typer.Option(help=f"Of each recording, a multiple of {CHAINS}.")] = 128,
    reference: Annotated[
        int, typer.Option(help="Exact draws, three times --draws or more.")
    ] = 2000,
    levels: Annotated[int, typer.Option(help="Of annealing, 2 or more.")] = 200,
    steps: Annotated[int, typer.Option(help="At each level.")] = 5,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of the pictures that the prior's card lists; unsaid: none."),
    ] = None,
    prior: Annotated[str, typer.Option(help="Weights for the pictures.")] = "nuclei",
    pictures: Annotated[int, typer.Option(help="2 or more.")] = 6,
    size: Annotated[int, typer.Option(help="Side of the square patches.")] = 32,
    picture_draws: Annotated[int, typer.Option(help=f"A multiple of {CHAINS}.")] = 16,
    seed: Annotated[int, typer.Option(help="Same seed, same recordings and draws.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Printed and consistent scores, paths, and Metropolis corrections beside exact posteriors."""
    names = asked_of("variant", variant, VARIANTS)
    problems = asked_of("problem", problem, APPLICATIONS)
    _check(recordings, draws, reference, levels, steps, pictures, picture_draws)
    work = Approximations(draws, reference, levels, steps, seed)
    identity = {
        "study": "approximations", "draws": draws, "reference": reference, "levels": levels,
        "steps": steps, "seed": seed,
    }  # fmt: skip
    truths = {
        name: np.stack([work.recording(name, i)[0] for i in range(recordings)])
        for name in problems
    }  # fmt: skip
    folder = out / "answers"
    answers = [measure(folder, identity, [EXACT, *names], problems, recordings, work)]
    if data is not None:
        patches = held_out(card_of(prior), study_data(data), "test", pictures, size)
        truths |= dict.fromkeys(PICTURES, patches)
        of_pictures = OnPictures(
            patches, prior, _FULL_WELL, picture_draws, _PICTURE_LEVELS, _PICTURE_STEPS, seed
        )
        about = identity | {"weights": _weights(prior), "size": size, "draws": picture_draws}
        answers.append(measure(folder, about, names, list(PICTURES), pictures, of_pictures))
    found: dict[str, dict[str, Answer]] = {}
    costed: dict[str, dict[str, Cost]] = {}
    for about, name, done, answer in ((c, s, d, a) for s, c, d, a in chain(*answers)):
        if not quiet and answer is None:
            print(f"{about}, {name}: {done} done", flush=True)
        if answer is not None:
            found.setdefault(about, {})[name] = answer
            costed[about] = costs(found[about], truths[about])
            _write(out, costed, found)
    print((out / "study.md").read_text(encoding="utf-8"), end="")


def _check(
    recordings: int, draws: int, reference: int, levels: int, steps: int, pictures: int,
    picture_draws: int,
) -> None:  # fmt: skip
    if min(recordings, pictures) < 2:
        raise ValueError(f"--recordings {recordings}, --pictures {pictures}: give 2 or more")
    for name, value in (("draws", draws), ("picture-draws", picture_draws)):
        if value < CHAINS or value % CHAINS:
            raise ValueError(
                f"--{name} {value}: give a multiple of {CHAINS}, as many are the chains"
            )
    if reference < 3 * draws:
        raise ValueError(f"--reference {reference}: give three times --draws {draws} or more")
    if levels < 2 or steps < 1:
        raise ValueError(f"--levels {levels}, --steps {steps}: give 2 levels or more of 1 or more")


def _weights(prior: str) -> dict[str, str]:
    """Hashes of the weights, which raises ValueError where there are none."""
    return {
        name: card_of(prior, kind.kind, perturbation)["sha256"]
        for name, (kind, perturbation) in PICTURES.items()
    }


def _write(
    out: Path, costed: dict[str, dict[str, Cost]], found: dict[str, dict[str, Answer]]
) -> None:
    text, figure = cost_table(costed, found), cost_picture(costed)
    replace_whole(out / "study.md", lambda p: Path(p).write_text(text, encoding="utf-8"))
    replace_whole(out / "study.png", lambda p: figure.savefig(p, dpi=150, format="png"))
