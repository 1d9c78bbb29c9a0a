"""Quantiles of a stream: within the stated distance of NumPy's, in memory that stays as it is."""

import numpy as np
import pytest

from posterior.diagnostics import StreamingQuantiles, interval, quantile

COUNT, PIXELS, BINS = 4000, 50, 128
P = [0.01, 0.05, 0.5, 0.95, 0.99]


def stream(kind):
    """Draws (COUNT, PIXELS) of one kind."""
    rng = np.random.default_rng(0)
    normal = rng.standard_normal((COUNT, PIXELS))
    return {
        "normal": normal,
        "skew": np.exp(2 * normal),
        "two modes": 0.1 * normal + (rng.random(normal.shape) < 0.3),
        # The first draws say nothing of where the last will be.
        "rising": normal + np.linspace(-40, 40, COUNT)[:, None],
        "falling": normal - np.linspace(-40, 40, COUNT)[:, None],
        "late": np.where(np.arange(COUNT)[:, None] < 2 * BINS, 7.0, 7 + normal),
        "counts": rng.poisson(3.0, normal.shape),
    }[kind]


@pytest.mark.parametrize("batch", [1, 300])
@pytest.mark.parametrize(
    "kind", ["normal", "skew", "two modes", "rising", "falling", "late", "counts"]
)
def test_results_are_as_near_as_is_said(kind, batch):
    draws = stream(kind)[: COUNT if batch > 1 else 600]
    found = StreamingQuantiles(BINS)
    for first in range(0, len(draws), batch):
        found.update(draws[first : first + batch])
    slack = found.resolution * (1 + 1e-6)
    assert np.all(np.abs(found.quantile(P) - quantile(draws[None], P)) <= slack)
    for mine, exact in zip(found.interval(0.8), interval(draws[None], 0.8)):
        assert np.all(np.abs(mine - exact) <= slack)
    # It says something: bins begin half as wide again as the range, and a draw that lies just
    # outside doubles them, at each end once.
    assert np.all(found.resolution <= 6 * np.ptp(draws, axis=0) / BINS)


def test_of_normal_draws_the_error_is_a_hundredth_of_an_sd():
    """The figure that the docstring states, of 256 bins and 10,000 draws."""
    draws = np.random.default_rng(1).standard_normal((10_000, 100))
    found = StreamingQuantiles().update(draws)
    apart = found.quantile([0.05, 0.5, 0.95]) - quantile(draws[None], [0.05, 0.5, 0.95])
    assert np.abs(apart).max() < 0.02
    assert found.resolution.min() > 0.025 and found.resolution.max() < 0.14


def test_few_draws_are_exact_and_pictures_keep_their_shape():
    draws = np.random.default_rng(2).standard_normal((100, 4, 5))
    found = StreamingQuantiles().update(draws[:40]).update(draws[40:])
    np.testing.assert_array_equal(found.quantile(P), quantile(draws[None], P))
    np.testing.assert_array_equal(found.quantile(0.5), quantile(draws[None], 0.5))
    np.testing.assert_array_equal(found.interval(), interval(draws[None]))
    assert found.count == 100 and found.width().shape == (4, 5) and not found.resolution.any()
    found.update(np.random.default_rng(3).standard_normal((1000, 4, 5)))
    assert found.quantile(P).shape == (5, 4, 5) and found.width().shape == (4, 5)


def test_memory_does_not_grow():
    found = StreamingQuantiles(BINS).update(stream("normal"))
    for _ in range(3):
        found.update(stream("rising"))
    held = sum(np.asarray(part).nbytes for part in vars(found).values() if part is not None)
    assert held < 1.1 * 8 * BINS * PIXELS


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda s: s.update(np.full((2, 3), np.nan)), "6 of 6 values of the draws are not finite"),
        (lambda s: s.update(np.full((2, 3), np.inf)), "6 of 6 values"),
        (lambda s: s.update(np.zeros((2, 3)) + 1j), "complex draws"),
        (lambda s: s.update(np.zeros((2, 4))), r"draws of shape \(2, 4\): give \(n, \*\(3,\)\)"),
        (lambda s: s.update(np.zeros((0, 3))), "one or more"),
        (lambda s: s.quantile(0.001), "800 draws for the quantile 0.001: give 999"),
        (lambda s: s.quantile(0.0), "quantile 0.0"),
        (lambda s: s.interval(1.0), "level 1.0"),
        (lambda s: StreamingQuantiles().quantile(0.5), "no draws yet"),
        (lambda s: StreamingQuantiles(25), "25 bins: give an even number"),
    ],
)
def test_bad_input_is_refused_and_changes_nothing(call, message):
    found = StreamingQuantiles().update(np.random.default_rng(4).random((800, 3)))
    before = found.width()
    with pytest.raises(ValueError, match=message):
        call(found)
    np.testing.assert_array_equal(found.width(), before)
