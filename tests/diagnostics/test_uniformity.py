"""The test of uniform ranks: exact, true to its level, and awake at the ends."""

import math

import numpy as np
import pytest
import scipy.stats

from posterior.diagnostics.uniformity import _any_outside, _limits, bands, holm, uniformity

REPEATS = 400


def nominal_false_alarms(level=0.05):
    """Between which so many of 400 correct tests reject, with 99 %."""
    return scipy.stats.binom(REPEATS, level).interval(0.99)


def steck(low, high):
    """Probability that order statistics lie within limits, as a determinant (Steck 1971)."""
    n = len(low)
    matrix = np.zeros((n, n))
    for i in range(n):
        for j in range(max(i - 1, 0), n):
            power = j - i + 1
            matrix[i, j] = max(high[i] - low[j], 0) ** power / math.factorial(power)
    return math.factorial(n) * np.linalg.det(matrix)


@pytest.mark.parametrize("n", [1, 2, 3, 8])
@pytest.mark.parametrize("local", [0.3, 0.01])
def test_the_recursion_agrees_with_stecks_determinant(n, local):
    assert _any_outside(local, n) == pytest.approx(1 - steck(*_limits(local, n)), abs=1e-12)


def test_false_alarms_are_as_many_as_stated():
    u = np.random.default_rng(0).random((REPEATS, 100))
    p = np.array([uniformity(row) for row in u])
    least, most = nominal_false_alarms()
    assert least <= np.sum(p < 0.05) <= most
    assert scipy.stats.kstest(p, "uniform").pvalue > 0.01


def test_a_few_truths_far_outside_all_draws_are_seen():
    """3 of 100 at the very end, to which Kolmogorov and Smirnov's test is blind."""
    rng = np.random.default_rng(1)
    u = rng.random((REPEATS, 100))
    u[:, :3] *= 1e-4
    caught = np.mean([uniformity(row) < 0.05 for row in u])
    blind = np.mean([scipy.stats.kstest(row, "uniform").pvalue < 0.05 for row in u])
    assert caught > 0.95 > 0.2 > blind


def test_p_below_rounding_is_an_upper_bound():
    u = np.linspace(0.9, 0.95, 200)
    local = 2 * scipy.stats.beta(1, 200).sf(0.9)
    assert uniformity(u) == pytest.approx(200 * local, rel=0.5)
    assert 0 < uniformity(u) < 1e-100


def test_bands_hold_what_the_test_accepts():
    low, high = bands(60, 0.9)
    u = np.sort(np.random.default_rng(2).random((REPEATS, 60)), axis=1)
    inside = np.all((low <= u) & (u <= high), axis=1)
    accepted = np.array([uniformity(row) > 0.1 for row in u])
    np.testing.assert_array_equal(inside, accepted)
    least, most = nominal_false_alarms(0.1)
    assert least <= np.sum(~inside) <= most


def test_the_band_of_one_number_is_its_central_interval():
    assert np.concatenate(bands(1, 0.9)) == pytest.approx([0.05, 0.95])


def test_holm_in_its_textbook_steps():
    adjusted = holm({"c": 0.03, "a": 0.01, "d": 0.5, "b": 0.011})
    assert list(adjusted) == ["c", "a", "d", "b"]
    assert adjusted == pytest.approx({"a": 0.04, "b": 0.04, "c": 0.06, "d": 0.5})
    assert holm({"a": 0.9, "b": 0.8}) == {"a": 1.0, "b": 1.0}


@pytest.mark.parametrize(
    "u, message",
    [
        ([], "one or more"),
        ([[0.5]], "give .n,."),
        ([0.5, 1.5], "0 to 1"),
        ([np.nan], "0 to 1"),
        ([0.5 + 0j], "ranks are complex128: give real"),
    ],
)
def test_bad_ranks_are_refused(u, message):
    with pytest.raises(ValueError, match=message):
        uniformity(np.array(u))


@pytest.mark.parametrize("n, level", [(0, 0.9), (10, 1.0), (2.5, 0.9)])
def test_bad_bands_are_refused(n, level):
    with pytest.raises(ValueError, match="give n of 1 or more"):
        bands(n, level)


@pytest.mark.parametrize("p", [2.0, -1.0, np.nan])
def test_what_is_no_probability_is_refused(p):
    with pytest.raises(ValueError, match=f"p {p} of b: give a probability, from 0 to 1"):
        holm({"a": 0.5, "b": p})
