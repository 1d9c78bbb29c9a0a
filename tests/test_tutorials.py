"""Every tutorial runs from an empty folder, keeps its own promises and draws its figures."""

import re
import runpy
from pathlib import Path

import matplotlib
import matplotlib.image
import matplotlib.pyplot as plt
import pytest

TUTORIALS = sorted((Path(__file__).parents[1] / "tutorials").glob("*.py"))
# The others take up to minutes: the study runs them.
RUNS = [
    pytest.param(path, marks=[] if path.stem.startswith("06") else [pytest.mark.slow])
    for path in TUTORIALS
]


@pytest.fixture
def headless(tmp_path, monkeypatch):
    """An empty working folder, and figures that need no screen; all undone afterwards."""
    monkeypatch.chdir(tmp_path)
    backend = matplotlib.get_backend()
    plt.switch_backend("Agg")
    with matplotlib.rc_context():
        yield tmp_path
    plt.close("all")
    plt.switch_backend(backend)


def cells(tutorial):
    """Kind ("markdown" or "code") and text of each cell of a percent-format notebook."""
    head, *parts = re.split(r"^# %%", tutorial.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert not head, "a tutorial begins with a cell"
    split = [part.partition("\n") for part in parts]
    return [("markdown" if "[markdown]" in first else "code", text) for first, _, text in split]


def test_there_are_tutorials():
    assert TUTORIALS


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_tutorial_is_a_notebook_that_checks_its_claims(tutorial):
    found = cells(tutorial)
    for kind, text in found:
        if kind == "markdown":
            assert all(line.startswith("#") for line in text.splitlines() if line), text
    assert found[0][0] == "markdown"
    kind, last = found[-1]
    assert kind == "code" and re.search(r"^assert ", last, flags=re.MULTILINE)


@pytest.mark.parametrize("tutorial", RUNS, ids=lambda path: path.stem)
def test_tutorial_runs_and_draws_its_figures(tutorial, headless, capsys):
    runpy.run_path(str(tutorial), run_name="__main__")
    assert capsys.readouterr().out

    named = re.findall(r"savefig\(\"([^\"]+)\"", tutorial.read_text(encoding="utf-8"))
    assert named and all(name.startswith(tutorial.stem[:2]) for name in named)
    assert sorted(path.name for path in headless.iterdir()) == sorted(named)
    for name in named:
        image = matplotlib.image.imread(headless / name)[..., :3]
        assert image.std() > 0.02, f"{name} is blank"
