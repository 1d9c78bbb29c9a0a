"""The command line: `posterior sample`, `repeat`, `train`, `prior`, `certify`, `study`,
`gallery`, `demo`.

A command is a file of this folder with a function `command`, and one line below. The command line
is the front door: it alone may look into every room.
"""

import sys
import warnings
from collections.abc import Sequence

import typer

from ..sampling import NonFiniteError
from . import certify, demo, gallery, prior, repeat, sample, study, train

_REFUSED = (ValueError, NonFiniteError, OSError)

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Draw the posterior of an imaging problem: what a recording says, and how surely.",
)
app.command("sample")(sample.command)
app.command("repeat")(repeat.command)
app.command("train")(train.command)
app.command("prior")(prior.command)
app.command("certify")(certify.command)
app.add_typer(study.app, name="study")
app.command("gallery")(gallery.command)
app.command("demo")(demo.command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point: every error that a user can cause is one sentence and exit status 2."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            status = app(arguments, prog_name="posterior", standalone_mode=False)
    except _REFUSED as error:
        status = _refuse(_sentence(error))
    except Exception as error:
        # What typer raises for a mistyped command has no public base class.
        if not hasattr(error, "format_message"):
            raise
        status = _refuse(f"{error.format_message().rstrip('.')}; see posterior --help")
    sys.exit(status)


def _warn(message: Warning | str, *_where: object) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _refuse(sentence: str) -> int:
    print(f"posterior: {sentence}", file=sys.stderr)
    return 2


def _sentence(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())
