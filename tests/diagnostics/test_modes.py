"""Modes of draws: one of one, two of two with their weights, and twins that are the same."""

import numpy as np
import pytest

from posterior.diagnostics import align, modes


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def gaussian(rng, *shape, dtype=float):
    re, im = rng.standard_normal((2, *shape))
    return re + 1j * im if dtype is complex else re


@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("draws", [4, 30])
def test_draws_of_one_mode_are_not_split(rng, draws, dtype):
    """At 64 dimensions: none of 100 sets."""
    found = [len(modes(gaussian(rng, 2, draws, 8, 8, dtype=dtype)).weights) for _ in range(100)]
    assert max(found) == 1


@pytest.mark.parametrize("dtype", [float, complex])
def test_two_modes_are_found_with_their_weights(rng, dtype):
    """Three sd a dimension apart; the share of 400 draws is binomial."""
    second = rng.random((4, 100)) < 0.25
    values = gaussian(rng, 4, 100, 8, 8, dtype=dtype) + 3 * second[..., None, None]
    if dtype is complex:
        values = values + 3j * second[..., None, None]
    found = modes(values)
    assert len(found.weights) == 2
    np.testing.assert_array_equal(found.labels, second)
    assert abs(found.weights[1] - 0.25) < 4 * np.sqrt(0.25 * 0.75 / 400)


def test_modes_that_overlap_count_as_one(rng):
    values = gaussian(rng, 2, 50, 8, 8) + (rng.random((2, 50)) < 0.5)[..., None, None]
    assert len(modes(values).weights) == 1


def test_twins_are_one_mode_once_aligned(rng):
    picture = 5 * gaussian(rng, 8, 8)
    values = picture + gaussian(rng, 2, 10, 8, 8)
    values[1] = values[1, :, ::-1, ::-1]
    assert len(modes(values).weights) == 2
    assert len(modes(align(values, symmetries=["conjugate_flip"])).weights) == 1


def test_copies_are_no_modes(rng):
    values = np.repeat(gaussian(rng, 2, 20, 8, 8), 3, axis=1)
    assert len(modes(values).weights) == 1
    assert len(modes(np.ones((2, 5, 8, 8))).weights) == 1


@pytest.mark.parametrize(
    "values, gap, message",
    [
        (np.zeros((1, 2, 8)), 2.0, "1 x 2 draws"),
        (np.zeros((0, 5, 8)), 2.0, "0 x 5 draws"),
        (np.zeros(5), 2.0, r"draws of shape \(5,\)"),
        (np.full((1, 5, 8), np.nan), 2.0, "40 of 40 values"),
        (np.zeros((1, 5, 8)), 0.0, "gap 0.0"),
    ],
)
def test_bad_input_is_refused(values, gap, message):
    with pytest.raises(ValueError, match=message):
        modes(values, gap)
