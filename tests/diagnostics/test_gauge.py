"""Alignment under what the data cannot tell: phase, flip, shift."""

import itertools

import numpy as np
import pytest

from posterior.diagnostics import Gauge, align, gauge_to
from posterior.models import Fourier

PHASE, FLIP, SHIFT = "global_phase", "conjugate_flip", "circular_shift"
RNG = np.random.default_rng(0)
REAL = RNG.standard_normal((5, 6))
COMPLEX = REAL + 1j * RNG.standard_normal((5, 6))
KINDS = pytest.mark.parametrize("o", [REAL, COMPLEX], ids=["real", "complex"])


def turns(o):
    return (1, np.exp(2j)) if np.iscomplexobj(o) else (1, -1)


@KINDS
def test_every_transformation_is_undone(o):
    for flipped, shift, turn in itertools.product((False, True), ((0, 0), (2, 5)), turns(o)):
        moved = Gauge(flipped, shift, turn).apply(o)
        np.testing.assert_allclose(align(moved, o), o, atol=1e-12)


@KINDS
def test_transformations_leave_the_recording_as_it_is(o):
    optics = Fourier(o.shape)
    assert set(optics.symmetries) == {PHASE, FLIP, SHIFT}
    moved = Gauge(True, (3, 1), turns(o)[1]).apply(o)
    np.testing.assert_allclose(abs(optics(moved)), abs(optics(o)), atol=1e-5)
    assert np.abs(moved - o).max() > 1


def test_nearest_means_nearest_in_mean_square():
    """Against all transformations tried one by one, for two objects that are unlike."""
    x, reference = RNG.standard_normal((2, 3, 4))
    tried = [
        np.linalg.norm(Gauge(f, (i, j), t).apply(x) - reference)
        for f in (False, True) for i in range(3) for j in range(4) for t in (1, -1)
    ]  # fmt: skip
    found = np.linalg.norm(align(x, reference) - reference)
    assert found == pytest.approx(min(tried), rel=1e-12)


@pytest.mark.parametrize(
    "allowed, gauge",
    [(PHASE, Gauge(False, (0, 1), 1)), (FLIP, Gauge(False, (0, 0), -1)),
     (SHIFT, Gauge(True, (0, 0), 1))],
)  # fmt: skip
def test_only_what_is_allowed_is_undone(allowed, gauge):
    moved = gauge.apply(REAL)
    assert np.abs(align(moved, REAL, [allowed]) - REAL).max() > 0.1


def test_draws_without_a_reference_come_together():
    turn = np.exp(2j * np.pi * RNG.random((2, 50, 1, 1)))
    noise = 0.02 * (RNG.standard_normal((2, 50, 5, 6)) + 1j * RNG.standard_normal((2, 50, 5, 6)))
    values = turn * COMPLEX + noise
    values[1, ::2] = np.conj(np.flip(values[1, ::2], axis=(-2, -1)))
    aligned = align(values, symmetries=[PHASE, FLIP])
    mean = aligned.mean(axis=(0, 1))
    overlap = np.vdot(align(mean, COMPLEX), COMPLEX)
    assert abs(overlap) > 0.999 * np.linalg.norm(mean) * np.linalg.norm(COMPLEX)
    assert aligned.std(axis=(0, 1)).mean() < 0.05


def test_what_is_symmetric_stays_as_it_is():
    even = REAL + np.flip(REAL)
    assert gauge_to(even, even, [FLIP]) == Gauge(False, (0, 0), 1.0)


def test_refusals():
    with pytest.raises(ValueError, match=r"shape \(5, 6\), reference of \(6, 5\)"):
        align(REAL, REAL.T)
    with pytest.raises(ValueError, match="unknown symmetry 'twin'"):
        gauge_to(REAL, REAL, ["twin"])
