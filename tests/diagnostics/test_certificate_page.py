"""The page of certificates: whole, closed in itself, and legible without colour."""

from html.parser import HTMLParser

import numpy as np
import pytest

from posterior.diagnostics.certificate import VERDICTS, Certificate
from posterior.diagnostics.certificate_page import as_page
from posterior.diagnostics.certificate_plot import COLOURS, SYMBOLS, plot_certificates
from posterior.diagnostics.sbc import Calibration

VOID = {"meta", "img", "br"}
RANKS = np.random.default_rng(0).random((40, 2))
CALIBRATION = Calibration(("norm", "a < b & c"), RANKS, np.array([30.0, 40.0]), 12.0)
CERTIFICATES = {
    "<mala>": {
        "line": Certificate("passes: all", CALIBRATION, 1.234, 0.1, 0.05, 12.0, 60.0, 4004, 0.056),
        "ring": Certificate("fails: norm", CALIBRATION, 7.5, seconds=3.0),
    },
    "smc": {
        "line": Certificate("cannot be judged: too few", CALIBRATION, 2.0),
        "pixel": Certificate("does not apply: a <reason>"),
    },
}


class Reader(HTMLParser):
    """Collects text, attributes and tags, and checks that they close in order."""

    def __init__(self):
        super().__init__()
        self.open, self.links, self.ids, self.sources = [], [], [], []
        self.tags, self.text = [], []

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append(tag)
        self.ids += [found["id"]] if "id" in found else []
        self.links += [found["href"]] if "href" in found else []
        self.sources += [found["src"]] if "src" in found else []
        if tag == "img":
            assert found["alt"]
        if tag == "th":
            assert found["scope"] in ("row", "col")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def page():
    reader = Reader()
    html = as_page(CERTIFICATES, {"command": "posterior certify --problem 'a & b'"})
    reader.feed(html)
    assert not reader.open
    reader.whole = html
    return reader


def test_it_loads_nothing_and_its_links_lead_to_its_sections(page):
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert "http" not in page.whole and "url(" not in page.whole and "@import" not in page.whole
    assert len(page.sources) == 3
    assert all(source.startswith("data:image/png;base64,iVBOR") for source in page.sources)
    assert len(set(page.ids)) == len(page.ids) == 4
    assert sorted(page.links) == sorted(f"#{name}" for name in page.ids)


def test_it_says_every_verdict_and_figure(page):
    text = " ".join(page.text)
    for said in (
        *VERDICTS,
        *SYMBOLS.values(),
        "not run",
        "a < b & c",
        "does not apply: a <reason>",
    ):
        assert said in text
    for figure in (
        "1.23 ± 0.06",
        "0.100",
        "0.050",
        "4,004",
        "0.015",
        "posterior certify --problem 'a & b'",
    ):
        assert figure in text
    share, error = CALIBRATION.coverage(0.8)["norm"]
    assert f"{100 * share:.0f} ± {100 * error:.0f}" in text
    assert f"{min(CALIBRATION.p.values()):.2g}" in text


def test_a_quantity_of_too_few_draws_has_no_p():
    slow = CALIBRATION._replace(effective=np.array([3.0, 40.0]))
    html = as_page({"mala": {"line": Certificate("cannot be judged", slow)}}, pictures={})
    assert html.count("too few draws") == 1
    assert f"{slow.judged_p['a < b & c']:.2g}" in html


def test_nothing_to_show_is_refused():
    for show in (plot_certificates, as_page):
        for nothing in ({}, {"mala": {}}):
            with pytest.raises(ValueError, match="no certificates to show: give {sampler:"):
                show(nothing)


def test_given_pictures_are_shown_as_they_are():
    html = as_page(CERTIFICATES, pictures={"smc": {"line": b"picture"}})
    assert html.count("<img") == 1 and "data:image/png;base64,cGljdHVyZQ==" in html


def test_the_picture_has_a_cell_for_each_verdict_in_its_colour():
    axes = plot_certificates(CERTIFICATES)
    assert [t.get_text() for t in axes.get_xticklabels()] == list(CERTIFICATES)
    assert [t.get_text() for t in axes.get_yticklabels()] == ["line", "ring", "pixel"]
    cells = {tuple(map(int, t.get_position())): t.get_text() for t in axes.texts}
    assert cells == {
        (0, 0): f"{SYMBOLS['passes']} 1.23",
        (0, 1): f"{SYMBOLS['fails']} 7.50",
        (1, 0): f"{SYMBOLS['cannot be judged']} 2.00",
        (1, 2): SYMBOLS["does not apply"],
    }
    assert len(axes.patches) == 4 and len(set(COLOURS.values())) == 4
    axes.figure.canvas.draw()
