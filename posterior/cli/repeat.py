"""`posterior repeat`: the draws of a finished run again."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Options, Out, Overwrite, Quiet
from .outputs import read_settings
from .run import run


def command(
    settings: Annotated[Path, typer.Argument(help="The settings.json of a finished run.")],
    out: Out,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Run again what settings.json says, on the same input: the same draws."""
    earlier = read_settings(settings)
    run(Options(**earlier["options"]), out, overwrite, quiet, earlier)
