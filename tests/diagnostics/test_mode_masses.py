"""Masses of known modes, by counting."""

import numpy as np
import pytest

from posterior.diagnostics import mode_masses

MODES = np.array([[[0.0, 0.0]], [[4.0, 0.0]], [[0.0, 4.0]]])


@pytest.mark.parametrize("turn", [1.0, 1j])
def test_each_draw_counts_for_the_mode_it_is_nearest_to(turn):
    labels = np.random.default_rng(0).choice(3, 200, p=[0.5, 0.3, 0.2])
    off = np.random.default_rng(1).uniform(-1.4, 1.4, (200, 1, 2))
    found = mode_masses(turn * (MODES[labels] + off), turn * MODES)
    np.testing.assert_array_equal(found, [np.mean(labels == k) for k in range(3)])


def test_a_mode_that_no_draw_is_near_has_no_mass():
    assert mode_masses(MODES[[1, 1, 2, 1]], MODES).tolist() == [0.0, 0.75, 0.25]
    # As near to the first two: the first counts.
    assert mode_masses(np.array([[[2.0, 0.0]]]), MODES).tolist() == [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "draws, modes, message",
    [
        (MODES[:, 0], MODES, r"draws of shape \(3, 2\), modes of \(3, 1, 2\): give \(n, "),
        (MODES[:0], MODES, "one or more of each"),
        (MODES, MODES[:0], "one or more of each"),
        (MODES + 0j, MODES, "draws of complex128 beside modes of float64"),
        (np.where(MODES == 4, np.nan, MODES), MODES, "2 of 3 draws are not finite"),
        (MODES, MODES[[0, 1, 1]], "3 modes of which 2 are different"),
    ],
)
def test_what_cannot_be_counted_is_refused(draws, modes, message):
    with pytest.raises(ValueError, match=message):
        mode_masses(draws, modes)
