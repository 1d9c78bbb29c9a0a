"""Coverage counts images: pixels of one image are not so many witnesses."""

import numpy as np
import pytest
import scipy.stats

from posterior.diagnostics.coverage import coverage

IMAGES, PIXELS, DRAWS, REPEATS = 30, 64, 19, 400


def pictures(rng, shape, sd=1.0):
    """Draws and truths whose pixels share most of what is unknown of their picture."""
    common, own = rng.standard_normal((*shape, 1)), rng.standard_normal((*shape, PIXELS))
    return sd * (0.9 * common + 0.44 * own)


def p_values(sd, seed):
    rng = np.random.default_rng(seed)
    for _ in range(REPEATS):
        truths, draws = pictures(rng, (IMAGES,)), pictures(rng, (IMAGES, DRAWS), sd)
        yield coverage(draws, truths, 0.8, rng)


def test_false_alarms_are_as_many_as_stated_though_pixels_agree():
    found = list(p_values(1.0, 0))
    least, most = scipy.stats.binom(REPEATS, 0.05).interval(0.99)
    assert least <= sum(each.p < 0.05 for each in found) <= most
    # Counted as independent, the same pixels give false alarms in most repetitions.
    naive = np.sqrt(0.8 * 0.2 / (IMAGES * PIXELS))
    assert np.mean([abs(each.share - 0.8) > 1.96 * naive for each in found]) > 0.5


def test_draws_that_are_half_as_wide_are_caught():
    assert np.mean([each.p < 0.05 for each in p_values(0.5, 1)]) > 0.95


def test_one_number_an_image_and_an_interval_of_few_draws():
    """Between quantiles of 4 draws 0.8 would hold 0.53 of truths; ranks hold what they say."""
    rng = np.random.default_rng(2)
    truths, draws = rng.standard_normal(4000), rng.standard_normal((4000, 4))
    found = coverage(draws, truths, 0.8, rng)
    assert abs(found.share - 0.8) < 4 * found.error
    assert found.error == pytest.approx(np.sqrt(0.8 * 0.2 / 4000), rel=0.1)
    low, high = np.quantile(draws, [0.1, 0.9], axis=1)
    assert np.mean((low < truths) & (truths < high)) < 0.6


def test_bad_coverage_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="level 1.2"):
        coverage(np.zeros((3, 5)), np.zeros(3), 1.2, rng)
    with pytest.raises(ValueError, match="one image"):
        coverage(np.zeros((1, 5)), np.zeros(1), 0.9, rng)
