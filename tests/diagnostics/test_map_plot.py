"""Maps show the numbers they are of, on a scale that holds them; the title counts what is off."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from posterior.diagnostics import plot_crps, plot_ess, plot_residuals, plot_rhat

RNG = np.random.default_rng(0)


def shown(axes):
    """The picture, the ends of its scale, and what the scale says."""
    image, bar = axes.images[0], axes.figure.axes[-1]
    return image.get_array(), image.get_clim(), bar.get_ylabel()


def test_residuals_are_shown_on_a_scale_about_zero():
    residuals = RNG.standard_normal((8, 10))
    residuals[0, :2], residuals[1, 0] = [5, -6], np.nan
    axes = Figure().add_subplot()
    assert plot_residuals(residuals, axes) is axes
    picture, ends, label = shown(axes)
    np.testing.assert_array_equal(picture.filled(np.nan), residuals)
    assert ends == (-4, 4) and label == "residual / sd of the noise"
    assert axes.get_title() == "2.5 % beyond 4 sd"


def test_rhat_above_its_limit_is_counted():
    found = np.array([[1.0, 1.005, np.nan], [1.2, 1.02, 0.999]])
    picture, ends, label = shown(axes := plot_rhat(found))
    assert picture.mask.sum() == 1 and ends == (0.999, 1.2) and label == "R-hat"
    assert axes.get_title() == "2 of 6 pixels above 1.01"
    # Of chains that agree everywhere the scale ends at the limit.
    assert shown(plot_rhat(np.ones((2, 2))))[1] == (1, 1.01)


def test_chains_that_never_agree_have_the_last_colour():
    axes = plot_rhat(np.array([[np.inf, 1.1]]))
    picture, ends, _ = shown(axes)
    assert ends == (1, 1.1) and np.all(picture == 1.1) and not np.any(picture.mask)
    assert axes.get_title() == "2 of 2 pixels above 1.01"


def test_few_effective_draws_are_counted():
    picture, ends, label = shown(axes := plot_ess(np.array([[100.0, 900.0], [399.0, np.nan]])))
    assert ends == (0, 900) and label == "bulk ESS / draws" and picture.mask.sum() == 1
    assert axes.get_title() == "2 of 4 pixels below 400"
    assert shown(plot_ess(np.full((2, 2), 50.0)))[1] == (0, 400)


def test_scores_are_a_map_or_a_bar_for_each_system():
    scores = RNG.random((6, 5))
    picture, ends, label = shown(plot_crps(scores, unit="electrons"))
    np.testing.assert_array_equal(picture, scores)
    assert ends == (0, scores.max()) and label == "CRPS / electrons"
    systems = {"annealed": [0.1, 0.3], "DPS": [0.2, 0.4, 0.9]}
    axes = plot_crps(systems)
    heights = [bar[0].get_height() for bar in axes.containers]
    np.testing.assert_allclose(heights, [0.2, 0.5])
    assert [list(line.get_ydata()) for line in axes.lines] == list(systems.values())
    assert [label.get_text() for label in axes.get_xticklabels()] == list(systems)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: plot_residuals(np.ones((3, 3), complex)), "residuals of shape .*complex128"),
        (lambda: plot_residuals(np.ones((3, 3)), limit=0), "limit 0"),
        (lambda: plot_rhat(np.ones(3)), r"R-hat of shape \(3,\)"),
        (lambda: plot_ess(np.ones((3, 0))), "effective sizes of shape"),
        (lambda: plot_crps(np.ones(4)), "scores of shape"),
        (lambda: plot_crps({"DPS": []}), "no scores to draw"),
    ],
)
def test_what_is_no_map_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
