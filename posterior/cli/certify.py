"""`posterior certify`: samplers against the problems whose posterior is known."""

import json
from pathlib import Path
from typing import Annotated

import jax
import typer

from ..diagnostics import plot_ranks
from ..diagnostics.certificate import Certificate, as_table, certify, file_name
from ..files import replace_whole
from ..models.gallery import GALLERY, Known
from ..presets import SAMPLERS
from ..problem import Problem
from ..samplers import Sampler
from .options import Quiet

# Of a right sampler to fail on any of the problems.
_ALPHA = 0.05
_DEFAULT = ("mala", "nuts", "smc", "annealed", "split-gibbs")


def command(
    out: Annotated[Path, typer.Option(help="Folder for the table, its numbers and pictures.")],
    sampler: Annotated[
        list[str], typer.Option(help=f"One of {', '.join(SAMPLERS)}; may be repeated.")
    ] = list(_DEFAULT),  # noqa: B006
    problem: Annotated[
        list[str] | None, typer.Option(help=f"One of {'; '.join(GALLERY)}; unsaid: all.")
    ] = None,
    simulations: Annotated[int, typer.Option(help="Of each problem, 20 or more.")] = 200,
    seed: Annotated[int, typer.Option(help="Same seed, same simulations.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Certify samplers on problems with a known posterior; a run that was stopped goes on."""
    for name, known in (*((s, SAMPLERS) for s in sampler), *((p, GALLERY) for p in problem or ())):
        if name not in known:
            raise ValueError(f"unknown name {name!r}: use one of {'; '.join(known)}")
    if simulations < 20:
        raise ValueError(f"--simulations {simulations}: give 20 or more, no test sees less")
    problems = {name: GALLERY[name]() for name in problem or GALLERY}
    key, found = jax.random.key(seed), {}
    for name in sampler:
        found[name] = {}
        for about, known in problems.items():
            if not quiet:
                print(f"{name}: {about}", flush=True)
            one = {about: known}
            found[name] |= certify(
                _built(name, known), one, key, simulations,
                alpha=_ALPHA / len(problems),
                folder=out / "simulations" / name, progress=not quiet,
            )  # fmt: skip
            # After each, so that what is done can be read while the rest goes on.
            _write(out, found)
    print(as_table(found), end="")


def _built(name: str, known: Known) -> Sampler:
    """The named sampler, with the settings that it has for a recording of this problem."""
    problem = Problem(known.likelihood, known.prior)
    _, y = problem.simulate(jax.random.key(0))
    return SAMPLERS[name].build(problem.condition(y))


def _write(out: Path, found: dict[str, dict[str, Certificate]]) -> None:
    plain = {
        name: {about: one.as_dict() for about, one in by_problem.items()}
        for name, by_problem in found.items()
    }
    replace_whole(
        out / "certificate.json", lambda p: Path(p).write_text(json.dumps(plain, indent=1))
    )
    replace_whole(out / "certificate.md", lambda p: Path(p).write_text(as_table(found)))
    name, by_problem = list(found.items())[-1]
    about, one = list(by_problem.items())[-1]
    if one.calibration is not None:
        axes = plot_ranks(one.calibration)
        axes.set_title(f"{name}: {about}\n{one.verdict}", fontsize=8, wrap=True)
        file = out / f"{name}-{file_name(about)}.png"
        replace_whole(file, lambda p: axes.figure.savefig(p, dpi=120, format="png"))
