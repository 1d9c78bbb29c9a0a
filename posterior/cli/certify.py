"""`posterior certify`: samplers against the problems whose posterior is known."""

import json
import platform
import shlex
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import jax
import typer

from ..diagnostics.campaign import Settings
from ..diagnostics.certificate import Certificate, certify, settings_of
from ..diagnostics.certificate_page import as_page, rank_picture
from ..diagnostics.certificate_plot import plot_certificates
from ..diagnostics.certificate_table import as_matrix, as_table
from ..files import replace_whole
from ..models.gallery import GALLERY, Known, file_name, of_counts
from ..models.priors import PixelPrior
from ..presets import SAMPLERS
from ..problem import Problem
from ..samplers import Sampler
from ..samplers.base import RunSampler
from .options import Quiet

# Of a right sampler to fail on any of the problems.
_ALPHA = 0.05
_DEFAULT = ("mala", "nuts", "smc", "annealed", "split-gibbs")
_VERSIONS = ("posterior-imaging", "jax", "numpy", "equinox", "blackjax")


def command(
    out: Annotated[Path, typer.Option(help="Folder for the page, table, numbers and pictures.")],
    sampler: Annotated[
        list[str], typer.Option(help=f"One of {', '.join(SAMPLERS)}; may be repeated.")
    ] = list(_DEFAULT),  # noqa: B006
    problem: Annotated[
        list[str] | None, typer.Option(help=f"One of {'; '.join(GALLERY)}; unsaid: all.")
    ] = None,
    simulations: Annotated[int, typer.Option(help="Of each problem, 20 or more.")] = 200,
    draws: Annotated[
        int | None, typer.Option(help="Of a chain, 8 or more; draws that are runs are 20.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Same seed, same simulations.")] = 0,
    minutes: Annotated[
        float | None, typer.Option(help="Of a sampler on a problem; it is then left unjudged.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Certify samplers on problems with a known posterior; a run that was stopped goes on."""
    for name, known in (*((s, SAMPLERS) for s in sampler), *((p, GALLERY) for p in problem or ())):
        if name not in known:
            raise ValueError(f"unknown name {name!r}: use one of {'; '.join(known)}")
    if simulations < 20:
        raise ValueError(f"--simulations {simulations}: give 20 or more, no test sees less")
    if draws is not None and draws < 8:
        raise ValueError(f"--draws {draws}: give 8 or more, to know how far they depend")
    if minutes is not None and not minutes > 0:
        raise ValueError(f"--minutes {minutes}: give more than 0, or leave it out")
    problems = {name: GALLERY[name]() for name in problem or GALLERY}
    made = _made(sampler, list(problem or ()), simulations, draws, seed, minutes)
    key, found, pictures = jax.random.key(seed), {}, {}
    for name in sampler:
        found[name], pictures[name] = {}, {}
        for about, known in problems.items():
            if not quiet:
                print(f"{name}: {about}", flush=True)
            known = _fitting(name, known)
            built, one = _built(name, known), {about: known}
            found[name] |= certify(
                built, one, key, simulations,
                settings=_settings(built, draws), alpha=_ALPHA / len(problems),
                limit=None if minutes is None else 60 * minutes,
                folder=out / "simulations" / name, progress=not quiet,
            )  # fmt: skip
            picture = rank_picture(found[name][about], f"{name}: {about}")
            if picture is not None:
                pictures[name][about] = picture
                file = out / f"{name}-{file_name(about)}.png"
                replace_whole(file, lambda p, data=picture: Path(p).write_bytes(data))
            # After each, so that what is done can be read while the rest goes on.
            _write(out, found, made, pictures)
    print(as_matrix(found), as_table(found), sep="\n", end="")


def _fitting(name: str, known: Known) -> Known:
    """The problem, its prior with the error of counts where the sampler needs that."""
    counted = SAMPLERS[name].needs == "counts" and isinstance(known.prior, PixelPrior)
    return of_counts(known) if counted else known


def _built(name: str, known: Known) -> Sampler:
    """The named sampler, with the settings that it has for a recording of this problem."""
    problem = Problem(known.likelihood, known.prior)
    _, y = problem.simulate(jax.random.key(0))
    return SAMPLERS[name].build(problem.condition(y))


def _settings(sampler: Sampler, draws: int | None) -> Settings:
    settings = settings_of(sampler)
    if draws is None or isinstance(sampler, RunSampler):
        return settings
    return settings._replace(draws=draws)


def _made(
    samplers: list[str],
    problems: list[str],
    simulations: int,
    draws: int | None,
    seed: int,
    minutes: float | None,
) -> dict[str, str]:
    """How the certificates were made: what repeats them."""
    options = [("--sampler", name) for name in samplers]
    options += [("--problem", name) for name in problems]
    options += [("--simulations", str(simulations)), ("--seed", str(seed))]
    if draws is not None:
        options.append(("--draws", str(draws)))
    if minutes is not None:
        options.append(("--minutes", f"{minutes:g}"))
    return {
        "command": shlex.join(["posterior", "certify", *(word for o in options for word in o)]),
        "simulations of each problem": str(simulations),
        "seed": str(seed),
        "a right sampler fails on any problem": f"with probability {_ALPHA:g} at most",
        "versions": ", ".join(f"{name} {version(name)}" for name in _VERSIONS),
        "computer": f"Python {platform.python_version()}, JAX on {jax.default_backend()}",
    }


def _write(
    out: Path,
    found: dict[str, dict[str, Certificate]],
    made: dict[str, str],
    pictures: dict[str, dict[str, bytes]],
) -> None:
    plain = {
        name: {about: one.as_dict() for about, one in by_problem.items()}
        for name, by_problem in found.items()
    }
    texts = {
        "certificate.json": json.dumps(plain, indent=1),
        "certificate.md": "\n".join((as_matrix(found), as_table(found))),
        "certificate.html": as_page(found, made, pictures),
    }
    for name, text in texts.items():
        replace_whole(out / name, lambda p, text=text: Path(p).write_text(text, encoding="utf-8"))
    figure = plot_certificates(found).figure
    replace_whole(out / "certificate.png", lambda p: figure.savefig(p, dpi=150, format="png"))
