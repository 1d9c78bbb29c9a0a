"""`posterior certify` from end to end."""

import html
import json

import pytest

from posterior import cli


def certify(out, *arguments):
    with pytest.raises(SystemExit) as caught:
        cli.main(["certify", "--out", str(out), "--simulations", "20", *arguments])
    return caught.value.code or 0


def test_it_writes_a_page_a_table_numbers_and_pictures_and_goes_on(tmp_path, capsys):
    chosen = ("--problem", "linear Gaussian, 4 rows of 32", "--sampler", "ula")
    assert certify(tmp_path, *chosen, "--quiet") == 0
    said = capsys.readouterr().out
    assert said == (tmp_path / "certificate.md").read_text()
    assert "| ula | linear Gaussian, 4 rows of 32 | " in said
    assert said.startswith("| problem | ula |\n")
    numbers = json.loads((tmp_path / "certificate.json").read_text())
    found = numbers["ula"]["linear Gaussian, 4 rows of 32"]
    assert found["simulations"] == 20 and found["verdict"] in said
    assert not found["verdict"].startswith("fails")
    assert (tmp_path / "ula-linear-Gaussian--4-rows-of-32.png").stat().st_size > 10_000
    # ULA: a score a step, in four chains of 500 steps of warm-up and 100 draws, thinned by 5.
    assert found["evaluations"] == 4 * (500 + 100 * 5)
    assert found["effective_per_evaluation"] == found["effective"] / found["evaluations"]
    assert (tmp_path / "certificate.png").stat().st_size > 10_000
    page = (tmp_path / "certificate.html").read_text(encoding="utf-8")
    assert page.count("<img") == 1 and found["verdict"] in html.unescape(page)
    assert "posterior certify --sampler ula --problem &#x27;linear Gaussian" in page
    # Finished simulations are read again, under the same seed alone.
    assert certify(tmp_path, *chosen, "--quiet") == 0
    assert capsys.readouterr().out == said
    assert certify(tmp_path, *chosen, "--seed", "1") == 2
    assert "of another" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        (["--sampler", "hmc"], "unknown name 'hmc': use one of mala;"),
        (["--problem", "linear"], "unknown name 'linear': use one of linear Gaussian;"),
        (["--simulations", "19"], "--simulations 19: give 20 or more"),
        (["--draws", "7"], "--draws 7: give 8 or more"),
        (["--minutes", "0"], "--minutes 0.0: give more than 0"),
    ],
)
def test_what_it_refuses(tmp_path, capsys, arguments, sentence):
    assert certify(tmp_path, *arguments) == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
