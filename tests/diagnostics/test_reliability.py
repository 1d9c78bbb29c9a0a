"""Error by stated spread: equal for exact draws, told apart by region where they are not."""

import numpy as np
import pytest

from posterior.diagnostics import reliability, spread_over_error

N = 5


def case(narrow=1.0, draws=200):
    """Pixels whose sd grows; draws `narrow` times as wide as they should be in the wider half."""
    rng = np.random.default_rng(0)
    sd = np.geomspace(0.01, 1, 4000)
    truths = sd * rng.standard_normal((N, 4000))
    draws = sd * np.where(sd > 0.1, narrow, 1.0) * rng.standard_normal((N, draws, 4000))
    return draws, truths, sd


def test_exact_draws_state_their_errors_bin_by_bin():
    draws, truths, sd = case()
    found = reliability(draws, truths, bins=8)
    of_bins = np.sqrt(np.mean(sd.reshape(8, -1) ** 2, axis=1))
    # Pixels near a bin's edge change places by the noise of their variance.
    np.testing.assert_allclose(found.stated, of_bins, rtol=0.03)
    # The mean square of normal errors of one bin, N x 500 of them, spread over a factor 1.8.
    assert np.abs(found.ratio - 1).max() < 4 * np.sqrt(0.5 / (N * 500)) * 1.2


def test_a_region_that_is_too_sure_is_told():
    draws, truths, _ = case(narrow=0.5)
    found = reliability(draws, truths, bins=8)
    # The wider half falls together with pixels of the narrower one: its own bins are the last.
    assert np.abs(found.ratio[-2:] - 0.5).max() < 0.06
    assert np.abs(found.ratio[:2] - 1).max() < 0.06


@pytest.mark.parametrize("count", [4, 7])
def test_few_exact_draws_are_not_blamed_for_the_noise_of_their_variance(count):
    draws, truths, sd = case(draws=count)
    # A bin's mean square is of N x 500 errors, its variance of that many times the second half's
    # degrees of freedom; bins mix sds, at worst as all pixels do.
    mixed = np.mean(sd**4) / np.mean(sd**2) ** 2
    degrees = count - count // 2 - 1
    slack = 4 * 0.5 * np.sqrt((2 + 2 / degrees) / (N * 500) * mixed)
    assert np.abs(reliability(draws, truths, bins=8).ratio - 1).max() < slack


def test_one_bin_is_spread_over_error():
    """Of the second half of the draws, about the mean of all."""
    draws, truths, _ = case(narrow=0.7)
    found = reliability(draws, truths, bins=1)
    second = draws[:, 100:].var(axis=1, ddof=1).mean() * (1 + 1 / 200)
    np.testing.assert_allclose(found.stated, np.sqrt(second), rtol=1e-12)
    assert abs(found.ratio[0] / spread_over_error(draws, truths) - 1) < 0.01
    turned = reliability(1j * draws, 1j * truths, bins=3)
    np.testing.assert_allclose(turned.ratio, reliability(draws, truths, bins=3).ratio, rtol=1e-12)


DRAWS, TRUTHS = np.random.default_rng(1).random((2, 5, 4)), np.zeros((2, 4))


@pytest.mark.parametrize(
    "draws, truths, bins, message",
    [
        (DRAWS[:, :3], TRUTHS, 4, "3 draws of each truth: give 4"),
        (DRAWS, TRUTHS, 9, "9 bins: give a whole number, 1 to the 8 pixels"),
        (DRAWS, TRUTHS, 1.5, "1.5 bins"),
        (DRAWS, TRUTHS[0], 4, "for truths of"),
        (DRAWS + 1j, TRUTHS, 4, "complex128 beside truths of float64"),
        (np.where(DRAWS[0, 0, 0] == DRAWS, np.nan, DRAWS), TRUTHS, 4, "1 of 40 values"),
        (np.ones((2, 5, 4)), TRUTHS, 4, "the 5 draws do not vary"),
    ],
)
def test_bad_input_is_refused(draws, truths, bins, message):
    with pytest.raises(ValueError, match=message):
        reliability(draws, truths, bins)
