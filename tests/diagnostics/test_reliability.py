"""Error by stated spread: equal for exact draws, told apart by region where they are not."""

import numpy as np
import pytest

from posterior.diagnostics import reliability, spread_over_error

N, DRAWS = 5, 200


def case(narrow=1.0):
    """Pixels whose sd grows; draws `narrow` times as wide as they should be in the wider half."""
    rng = np.random.default_rng(0)
    sd = np.geomspace(0.01, 1, 4000)
    truths = sd * rng.standard_normal((N, 4000))
    draws = sd * np.where(sd > 0.1, narrow, 1.0) * rng.standard_normal((N, DRAWS, 4000))
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


def test_one_bin_is_spread_over_error():
    draws, truths, _ = case(narrow=0.7)
    np.testing.assert_allclose(
        reliability(draws, truths, bins=1).ratio[0], spread_over_error(draws, truths), rtol=1e-12
    )
    turned = reliability(1j * draws, 1j * truths, bins=3)
    np.testing.assert_allclose(turned.ratio, reliability(draws, truths, bins=3).ratio, rtol=1e-12)


@pytest.mark.parametrize("draws, bins", [(1, 10), (3, 100)])
def test_too_few_of_either_are_refused(draws, bins):
    with pytest.raises(ValueError, match="2 draws or more"):
        reliability(np.ones((2, draws, 4)), np.ones((2, 4)), bins)
