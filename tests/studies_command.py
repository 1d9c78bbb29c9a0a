"""`posterior study` as a user types it: its exit code, and what it says when it refuses."""

import pytest

from posterior.cli import main


def exit_code(name, out, *options):
    """The exit code."""
    with pytest.raises(SystemExit) as stopped:
        main(["study", name, "--out", str(out), "--quiet", *map(str, options)])
    return stopped.value.code


def assert_refused(code, out, capsys, words):
    """With a usage error, in one sentence that holds `words`, and nothing written."""
    said = capsys.readouterr().err
    assert code == 2
    assert words in said and len(said.splitlines()) == 1
    assert not out.exists()
