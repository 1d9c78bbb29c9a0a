"""`posterior gallery`: the references of the problems whose posterior is known, made anew."""

import sys
from pathlib import Path
from typing import Annotated

import jax
import typer

from ..files import replace_whole
from ..models import reference
from ..models.gallery import GALLERY, file_name
from ..problem import Problem
from .options import Quiet

# So improbable a difference from what is stored is an error, whichever of the problems has it.
_ALPHA = 0.001


def command(
    problem: Annotated[
        list[str] | None, typer.Option(help=f"One of {'; '.join(GALLERY)}; unsaid: all.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the draws; the stored ones are of seed 0.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the new ones, of the same recordings."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Draw the gallery's posteriors anew, and compare their moments with those that are stored."""
    names = problem or list(GALLERY)
    for name in names:
        if name not in GALLERY:
            raise ValueError(f"unknown problem {name!r}: use one of {'; '.join(GALLERY)}")
    # Before any work: a damaged one ends it.
    stored = {name: _stored(name) for name in names}
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    if not quiet:
        columns = "problem", "draws", "worth", "numbers", "largest difference, errors", "p", "basis"
        print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|", flush=True)
    differ = []
    for name, kept in stored.items():
        made = _made(name, kept, seed)
        z, p = (float("nan"), float("nan")) if kept is None else reference.apart(made, kept)
        if p < _ALPHA / len(names):
            differ.append(f"{name} (p = {p:.2g})")
            # At once too: a later problem may stop the command.
            print(f"moments differ from the stored ones: {differ[-1]}", file=sys.stderr, flush=True)
        if out is not None:
            file = out / f"{file_name(name)}.npz"
            replace_whole(file, lambda part, made=made: reference.save(made, part))
        if not quiet:
            numbers = made.mean.size + made.sd.size + made.masses.size
            drawn, worth = made.sets * made.draws, f"{made.worth():.0f}"
            cells = name, str(drawn), worth, str(numbers), f"{z:.1f}", f"{p:.2g}"
            print(f"| {' | '.join((*cells, made.basis))} |", flush=True)
    if differ:
        raise ValueError(f"moments differ from the stored ones: {', '.join(differ)}")


def _stored(name: str) -> reference.Reference | None:
    try:
        return reference.load(name)
    except FileNotFoundError:
        return None


def _made(name: str, stored: reference.Reference | None, seed: int) -> reference.Reference:
    """The reference of this seed, of the recording that is stored, or of a first one."""
    with jax.enable_x64(True):
        known = GALLERY[name]()
        if stored is None:
            y = Problem(known.likelihood, known.prior).simulate(jax.random.key(0))[1]
        else:
            y = stored.recording
        # Away from the key that made the recording.
        key = jax.random.fold_in(jax.random.key(seed), 2**31)
        return reference.make(known, y, key)
