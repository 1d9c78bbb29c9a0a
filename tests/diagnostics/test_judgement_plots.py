"""Pictures of what a diagnostic found: every number is where its axes say."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from posterior.diagnostics import (
    Distance,
    Frechet,
    Reliability,
    Repair,
    plot_distances,
    plot_frechet,
    plot_mode_masses,
    plot_pit,
    plot_reliability,
    plot_repair,
)
from posterior.diagnostics.pit_plot import _histogram

RNG = np.random.default_rng(0)


def heights(bars):
    return [bar.get_height() for bar in bars]


def outside(axes):
    """How many bars have the colour of those outside the band."""
    return sum(bar.get_facecolor()[0] > 0.8 for bar in axes.containers[0])


def test_uniform_ranks_are_flat_within_the_band_and_others_leave_it():
    ranks = (np.arange(1000) + 0.5) / 1000
    axes = Figure().add_subplot()
    assert plot_pit(ranks.reshape(10, 100), axes, bins=10) is axes
    np.testing.assert_allclose(heights(axes.containers[0]), 1)
    assert outside(axes) == 0
    # Of draws that are too narrow truths lie in the tails.
    narrow = plot_pit(0.5 + 0.5 * np.sin(np.pi * (ranks - 0.5)), bins=10)
    assert narrow.containers[0][0].get_height() > 1.5 and outside(narrow) >= 4


def test_the_band_holds_uniform_ranks_as_often_as_stated():
    """5 % of 200 are 10; more than 20 by chance once in a thousand."""
    alarms = sum(_histogram(RNG.random(400), 8, 0.95).outside.any() for _ in range(200))
    assert alarms <= 20


def test_reliability_has_a_point_for_each_bin():
    found = Reliability(np.array([0.1, 0.2]), np.array([0.15, 0.2]))
    axes = plot_reliability(found, unit="electrons")
    diagonal, points = axes.lines
    np.testing.assert_allclose(points.get_xydata(), [[0.1, 0.15], [0.2, 0.2]])
    np.testing.assert_allclose(*diagonal.get_data())
    assert axes.get_xlabel() == "stated sd / electrons" and axes.get_ylabel() == "error / electrons"


@pytest.mark.parametrize(
    "plot, kind, label",
    [
        (plot_distances, Distance, "distance"),
        (plot_frechet, Frechet, "squared Frechet distance"),
    ],
)
def test_a_distance_lies_beside_the_interval_of_its_floor(plot, kind, label):
    axes = plot({"exact": kind(0.11, 0.1, 0.02, 0.4), "DPS": kind(0.9, 0.2, 0.05, 0.005)})
    bars = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.containers[0]]
    np.testing.assert_allclose(bars, [(0.06, 0.14), (0.1, 0.3)])
    floors, values = axes.lines
    np.testing.assert_allclose(values.get_xdata(), [0.11, 0.9])
    np.testing.assert_allclose(floors.get_xdata(), [0.1, 0.2])
    assert [text.get_text() for text in axes.texts] == ["p = 0.4", "p = 0.005"]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["exact", "DPS"]
    assert axes.get_xlabel() == label


def test_masses_have_the_error_of_so_many_draws():
    axes = plot_mode_masses(np.array([0.8, 0.2]), 100, exact=np.array([0.7, 0.3]))
    _, bars = axes.containers
    np.testing.assert_allclose(heights(bars), [0.8, 0.2])
    ends = [segment[:, 1] for segment in bars.errorbar.lines[2][0].get_segments()]
    np.testing.assert_allclose(ends, [[0.72, 0.88], [0.12, 0.28]])
    np.testing.assert_allclose(
        [segment[0, 1] for segment in axes.collections[-1].get_segments()], [0.7, 0.3]
    )


def test_a_repair_is_shown_before_and_after():
    found = Repair(1.4, 0.9, 0.1, 0.95, 40, before=0.3, after=0.08)
    axes = plot_repair({"DPS": found})
    np.testing.assert_allclose([heights(bars)[0] for bars in axes.containers], [0.7, 0.92])
    assert axes.collections[0].get_segments()[0][0, 1] == pytest.approx(0.9)
    assert axes.texts[0].get_text() == "x 1.4"
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["before", "after", "guaranteed"]


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: plot_pit(np.array([0.5, 1.5])), "1 of 2 ranks lie outside"),
        (lambda: plot_pit(np.array([0.5, np.nan])), "1 of 2 ranks lie outside"),
        (lambda: plot_pit(np.array([])), "0 of 0 ranks"),
        (lambda: plot_pit(np.array([0.5]), bins=1), "1 bins"),
        (lambda: plot_pit(np.array([0.5]), level=1), "level 1"),
        (lambda: plot_distances({}), "no distance to draw"),
        (lambda: plot_mode_masses(np.array([0.8, 0.3]), 9), "that sum to 1"),
        (lambda: plot_mode_masses(np.array([1.0]), 0), "count 0"),
        (lambda: plot_mode_masses(np.array([1.0]), 9, exact=[0.5, 0.5]), "exact masses of shape"),
        (lambda: plot_repair({}), "no repair to draw"),
    ],
)
def test_what_cannot_be_drawn_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
