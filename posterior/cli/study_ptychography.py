"""`posterior study ptychography`: the paper's simulated Fourier ptychography."""

import hashlib
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..files import replace_whole
from ..models.camera import Poisson
from ..models.priors.storage import card_of
from ..studies.harness import Answer, measure
from ..studies.ptychography import Condition, Ptychography, led_optics
from ..studies.ptychography_plots import maps, psnr_panels, scatter
from ..studies.ptychography_report import Judged, judged_objects, protocol, ptychography_table
from ..studies.ptychography_systems import PTYCHOGRAPHY_SYSTEMS
from ..studies.specimens import specimens
from .options import Quiet, asked_of, study_data
from .study_stack import run_stack

# One of the two is held while the other varies.
_LEDS, _SIGMA = 89, "0.1"


def command(
    out: Annotated[Path, typer.Option(help="Folder for the answers, the tables and figures.")],
    data: Annotated[
        Path | None, typer.Option(help="Folder of bloodsmear_*_epie_reference.npz.")
    ] = None,
    stack: Annotated[
        Path | None,
        typer.Option(help="A measured stack instead: half of its LEDs predicts the other."),
    ] = None,
    prior: Annotated[
        str, typer.Option(help="Shipped weights, or paths up to -gaussian-score.safetensors.")
    ] = "complex-cells",
    sigma: Annotated[
        list[str], typer.Option(help=f"Noise over full light, at {_LEDS} LEDs; may be repeated.")
    ] = ["0.025", "0.05", "0.1", "0.2"],  # noqa: B006
    leds: Annotated[
        list[int], typer.Option(help=f"How many, at sigma_0 = {_SIGMA}; may be repeated.")
    ] = [9, 25, 49, 89],  # noqa: B006
    system: Annotated[
        list[str] | None,
        typer.Option(help=f"One of {'; '.join(PTYCHOGRAPHY_SYSTEMS)}; unsaid: all."),
    ] = None,
    objects: Annotated[int, typer.Option(help="2 or more.")] = 10,
    part: Annotated[str, typer.Option(help="test, or validation to choose settings on.")] = "test",
    size: Annotated[int, typer.Option(help="Side of the objects: 32, 64, 96 or 128.")] = 64,
    draws: Annotated[int, typer.Option(help="Of each system that samples, 2 or more.")] = 8,
    bits: Annotated[int, typer.Option(help="Of the ADC; 0: whole counts.")] = 8,
    view: Annotated[int, typer.Option(help="Middle camera pixels of a stack; 0: all.")] = 0,
    widest: Annotated[float, typer.Option(help="NA up to which LEDs of a stack are used.")] = 0.19,
    background: Annotated[
        bool, typer.Option(help="Whether the images of a stack may hold even background.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Same seed, same recordings and draws.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Held-out complex objects behind LEDs, recorded with true Poisson counts and an ADC.

    Or a measured stack (--stack), whose object nobody knows.
    """
    if (data is None) == (stack is None):
        raise ValueError("give either --data (references, to simulate with) or --stack (measured)")
    names = _checked(system, objects, draws, part)
    if stack is not None:
        run_stack(stack, out, prior, names, view, widest, draws, seed, background, quiet)
        return
    by_sigma = [Condition(_LEDS, value).name for value in sigma]
    by_leds = [Condition(value, _SIGMA).name for value in leds]
    conditions = list(dict.fromkeys([*by_sigma, *by_leds]))
    _check_conditions(conditions, size, bits)
    truths = specimens(study_data(data), card_of(prior), part, objects, size)
    study = Ptychography(truths, prior, bits or None, draws, seed)
    identity = {
        "study": "ptychography", "weights": card_of(prior)["sha256"], "part": part, "size": size,
        "draws": draws, "bits": bits, "seed": seed,
        "first": hashlib.sha256(truths[0].tobytes()).hexdigest(),
    }  # fmt: skip
    found: dict[str, dict[str, Judged]] = {}
    answered: dict[str, dict[str, Answer]] = {}
    steps = chain.from_iterable(
        measure(out / "answers", identity, names, [condition], objects, study)
        for condition in conditions
    )
    for name, condition, done, answer in steps:
        if answer is None:
            if not quiet:
                print(f"{condition}, {name}: {done} of {objects}", flush=True)
            continue
        answered.setdefault(condition, {})[name] = answer
        judged = found.setdefault(condition, {})
        if not answer.refusal:
            judged[name] = judged_objects(study, condition, answer)
        _write(out, study, found, answered, (by_sigma, by_leds))
    print((out / "study.md").read_text(encoding="utf-8"), end="")


def _checked(system: list[str] | None, objects: int, draws: int, part: str) -> list[str]:
    names = asked_of("system", system, PTYCHOGRAPHY_SYSTEMS)
    if min(objects, draws) < 2:
        raise ValueError(f"--objects {objects}, --draws {draws}: give 2 or more of both")
    if part not in ("test", "validation"):
        raise ValueError(f"--part {part}: give test or validation")
    return names


def _check_conditions(conditions: list[str], size: int, bits: int) -> None:
    for name in conditions:
        asked = Condition.of(name)
        Poisson(asked.camera_electrons, bits or None)
        led_optics(size, asked.leds)


def _write(
    out: Path, study: Ptychography, found: dict[str, dict[str, Judged]],
    answered: dict[str, dict[str, Answer]], panels: tuple[list[str], list[str]],
) -> None:  # fmt: skip
    """Tables, PSNR of every condition; scatter and maps of the one where both panels meet."""
    tables = [ptychography_table(name, judged, answered[name]) for name, judged in found.items()]
    text = "\n".join([protocol(), *tables])
    replace_whole(out / "study.md", lambda p: Path(p).write_text(text, encoding="utf-8"))
    middle = Condition(_LEDS, _SIGMA).name
    shown = answered[middle if middle in answered else next(iter(answered))]
    shown = {name: answer for name, answer in shown.items() if not answer.refusal}
    figures = {"psnr": psnr_panels(found, *panels)}
    if shown:
        figures["scatter"] = scatter(study.truths, shown)
        figures["maps"] = maps(np.asarray(study.truths[0]), shown)
    for name, figure in figures.items():
        replace_whole(
            out / f"{name}.png", lambda p, figure=figure: figure.savefig(p, dpi=150, format="png")
        )
