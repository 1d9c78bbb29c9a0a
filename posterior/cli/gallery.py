"""`posterior gallery`: the references of the problems whose posterior is known, made anew."""

from pathlib import Path
from typing import Annotated

import jax
import numpy as np
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
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    if not quiet:
        columns = "problem", "draws", "worth", "numbers", "largest difference, errors", "p", "basis"
        print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|", flush=True)
    differ = []
    for name in names:
        made, found = _made(name, seed)
        z, p = (float("nan"), float("nan")) if found is None else reference.apart(made, found)
        if p < _ALPHA / len(names):
            differ.append(f"{name} (p = {p:.2g})")
        if out is not None:
            file = out / f"{file_name(name)}.npz"
            replace_whole(file, lambda part, made=made: _save(made, part))
        if not quiet:
            numbers = made.mean.size + made.sd.size + made.masses.size
            drawn, worth = made.sets * made.draws, f"{made.worth():.0f}"
            cells = name, str(drawn), worth, str(numbers), f"{z:.1f}", f"{p:.2g}"
            print(f"| {' | '.join((*cells, made.basis))} |", flush=True)
    if differ:
        raise ValueError(f"moments differ from the stored ones: {', '.join(differ)}")


def _made(name: str, seed: int) -> tuple[reference.Reference, reference.Reference | None]:
    """The reference of this seed, and the stored one, of whose recording it is."""
    with jax.enable_x64(True):
        known = GALLERY[name]()
        try:
            found = reference.load(name)
            y = found.recording
        except FileNotFoundError:
            found = None
            y = np.asarray(Problem(known.likelihood, known.prior).simulate(jax.random.key(0))[1])
        # Away from the key that made the recording.
        key = jax.random.fold_in(jax.random.key(seed), 2**31)
        return reference.make(known, y, key), found


def _save(made: reference.Reference, part: str) -> None:
    # NumPy adds an ending to names, not to open files.
    with open(part, "wb") as file:
        reference.save(made, file)
