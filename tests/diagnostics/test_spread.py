"""Spread against the error that it should predict: right for true draws, and broken ones caught."""

import numpy as np
import pytest

from posterior.diagnostics import interval, spread_over_error

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
    low, high = interval(draws, 0.9)
    error = np.sqrt(held * (1 - held) / len(truths))
    assert abs(np.mean((low <= truths) & (truths <= high)) - held) < 4 * error
    assert np.all(low >= draws.min((0, 1))) and np.all(high <= draws.max((0, 1)))
