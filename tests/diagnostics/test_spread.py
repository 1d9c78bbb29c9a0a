"""Spread against the error that it should predict: right for true draws, and broken ones caught."""

import numpy as np
import pytest
import scipy.stats

from posterior.diagnostics import (
    circular_mean,
    circular_sd,
    interval,
    interval_width,
    quantile,
    spread_over_error,
)
from posterior.diagnostics.spread import held_by, widest

PROBLEMS, PIXELS = 400, 100


def forecasts(draws, width, dtype):
    """Draws and truths about common centres, the draws' sd being `width` of the truths'."""
    rng = np.random.default_rng(0)

    def normal(*shape):
        re, im = rng.standard_normal((2, *shape))
        return re + 1j * im if dtype is complex else re

    centre = normal(PROBLEMS, PIXELS)
    return (
        centre[:, None] + width * normal(PROBLEMS, draws, PIXELS),
        centre + normal(PROBLEMS, PIXELS),
    )


@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("draws", [2, 16])
def test_it_is_one_for_true_draws_and_tells_ten_per_cent(draws, dtype):
    """40000 errors give the ratio an error of 1/sqrt(2 x 40000), and the draws' spread as much."""
    bound = 4 * np.sqrt(2 / (2 * PROBLEMS * PIXELS))
    assert abs(spread_over_error(*forecasts(draws, 1.0, dtype)) - 1) < bound
    assert spread_over_error(*forecasts(draws, 0.9, dtype)) < 1 - bound
    assert spread_over_error(*forecasts(draws, 1.1, dtype)) > 1 + bound


@pytest.mark.parametrize("count, held", [(39, 0.9), (19, 0.9), (8, 7 / 9)])
def test_the_interval_of_few_draws_holds_what_it_says(count, held):
    """Truths that are one draw more: 20,000 of them; plain quantiles of 39 draws hold 86 %."""
    rng = np.random.default_rng(count)
    draws, truths = rng.standard_normal((1, count, 20_000)), rng.standard_normal(20_000)
    assert held_by(count) == pytest.approx(held)
    low, high = interval(draws, held)
    error = np.sqrt(held * (1 - held) / len(truths))
    assert abs(np.mean((low <= truths) & (truths <= high)) - held) < 4 * error
    assert np.all(low >= draws.min((0, 1))) and np.all(high <= draws.max((0, 1)))
    np.testing.assert_allclose(high - low, widest(draws), rtol=1e-12)
    np.testing.assert_allclose(high - low, interval_width(draws, held), rtol=1e-12)


@pytest.mark.parametrize("p", [0.05, 1 / 3, 0.9])
def test_one_draw_more_lies_below_a_quantile_as_often_as_it_says(p):
    """Exact where the rank p (n + 1) is whole, as of 59 draws it is for each of these."""
    rng = np.random.default_rng(5)
    draws, more = rng.exponential(size=(3, 59, 20_000))[0], rng.exponential(size=20_000)
    found = quantile(draws[None], p)
    assert abs(np.mean(more < found) - p) < 4 * np.sqrt(p * (1 - p) / len(more))
    np.testing.assert_array_equal(quantile(draws[None], [0.5, p])[1], found)


def test_circular_statistics_are_scipys_across_the_cut():
    """Phases about pi: half of them are near -pi."""
    rng = np.random.default_rng(4)
    phase = np.angle(
        np.exp(1j * (np.pi + 0.05 + rng.uniform(0.1, 2, 7) * rng.normal(size=(2, 50, 7))))
    )
    flat = phase.reshape(-1, 7)
    expected = scipy.stats.circmean(flat, np.pi, -np.pi, axis=0)
    assert np.ptp(flat[:, 0]) > 6
    np.testing.assert_allclose(np.exp(1j * circular_mean(phase)), np.exp(1j * expected), rtol=1e-9)
    np.testing.assert_allclose(circular_sd(phase), scipy.stats.circstd(flat, axis=0), rtol=1e-9)


def test_a_pixel_that_stands_still_has_no_spread():
    draws = np.random.default_rng(6).uniform(-1, 1, (1, 30, 2)) * [0, 1]
    assert str(circular_sd(draws)[0]) == "0.0"
    assert interval_width(draws)[0] == 0
    assert widest(draws[:, :1])[1] == 0


GOOD = np.random.default_rng(3).standard_normal((2, 20, 5))
ONE_LOST = np.where(GOOD[0, 0, 0] == GOOD, np.nan, GOOD)


@pytest.mark.parametrize("statistic", [interval, interval_width, circular_mean, circular_sd])
@pytest.mark.parametrize(
    "draws, message",
    [
        (ONE_LOST, "1 of 200 values of the draws are not finite: the run has diverged"),
        (np.where(np.isnan(ONE_LOST), np.inf, GOOD), "1 of 200 values"),
        (GOOD[:, :0], r"draws of shape \(2, 0, 5\)"),
        (GOOD[..., :0], "one or more"),
        (GOOD[0, :, 0], "give .chains, draws"),
        (GOOD + 0j, "complex draws"),
    ],
)
def test_draws_without_a_statistic_are_refused(statistic, draws, message):
    with pytest.raises(ValueError, match=message):
        statistic(draws)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: interval(GOOD[:1, :18]), "18 draws for an interval at 90 %: give 19 or more"),
        (lambda: interval_width(GOOD, 0.99), "40 draws for an interval at 99 %: give 199"),
        (lambda: interval_width(0 * GOOD), "the 40 draws do not vary"),
        (lambda: interval(GOOD, 1.0), "level 1.0"),
        (lambda: quantile(GOOD, 0.01), "40 draws for the quantile 0.01: give 99"),
        (lambda: quantile(GOOD, [0.5, 0.99]), "give 99 or more"),
        (lambda: quantile(GOOD, 1.0), "quantile 1.0: it must lie between"),
        (lambda: quantile(ONE_LOST, 0.5), "1 of 200 values"),
        (lambda: circular_sd(GOOD[:1, :1]), "1 draws in all: give 2"),
        (lambda: circular_sd(0 * GOOD + 1), "do not vary"),
        (lambda: spread_over_error(GOOD, GOOD[0, 0]), r"for truths of \(5,\)"),
        (lambda: spread_over_error(GOOD, GOOD[:, :, :1]), "for truths of"),
        (lambda: spread_over_error(GOOD[:, :1], GOOD[:, 0]), "1 draws of each truth: give 2"),
        (lambda: spread_over_error(GOOD[:, :0], GOOD[:, 0]), "0 draws of each truth"),
        (lambda: spread_over_error(GOOD + 0j, GOOD[:, 0]), "complex128 beside truths of float64"),
        (lambda: spread_over_error(ONE_LOST, GOOD[:, 0]), "1 of 200 values of the draws"),
        (lambda: spread_over_error(GOOD, ONE_LOST[:, 0]), "1 of 10 values of the truths"),
        (lambda: spread_over_error(0 * GOOD, GOOD[:, 0]), "the 20 draws do not vary"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
