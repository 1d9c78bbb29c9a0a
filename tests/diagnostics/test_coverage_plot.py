"""The picture of coverage shows every level of every name, with the error that images give it."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from posterior.diagnostics import Coverage, plot_coverage

LEVELS = (0.9, 0.5)
FOUND = [Coverage(level - 0.1, 0.03, level, 0.01) for level in LEVELS]


def test_each_level_has_a_point_and_its_errors():
    axes = Figure().add_subplot()
    assert plot_coverage({"narrow": FOUND}, axes, errors=2) is axes
    line, _, (bars,) = axes.containers[0]
    np.testing.assert_allclose(line.get_xydata(), [[0.5, 0.4], [0.9, 0.8]])
    ends = [segment[:, 1] for segment in bars.get_segments()]
    np.testing.assert_allclose(ends, [[0.34, 0.46], [0.74, 0.86]])


def test_names_are_told_apart():
    axes = plot_coverage({"first": FOUND, "second": FOUND[:1]})
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["first", "second"]
    # The diagonal, and the two.
    assert len(axes.lines) >= 3 and axes.get_xlabel() == "level stated"


def test_nothing_is_not_drawn():
    for nothing in ({}, {"first": []}):
        with pytest.raises(ValueError, match="no coverage to draw"):
            plot_coverage(nothing)
