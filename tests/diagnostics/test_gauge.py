"""Alignment under what the data cannot tell: phase, flip, shift."""

import itertools

import numpy as np
import pytest

from posterior.diagnostics import Gauge, align, gauge_to, symmetries_of
from posterior.models import Fourier, Gaussian, IntensityLikelihood, LinearLikelihood

PHASE, FLIP, SHIFT = "global_phase", "conjugate_flip", "circular_shift"
RNG = np.random.default_rng(0)
REAL = RNG.standard_normal((5, 6))
ALL = [PHASE, FLIP, SHIFT]
COMPLEX = REAL + 1j * RNG.standard_normal((5, 6))
KINDS = pytest.mark.parametrize("o", [REAL, COMPLEX], ids=["real", "complex"])


def turns(o):
    return (1, np.exp(2j)) if np.iscomplexobj(o) else (1, -1)


@KINDS
def test_every_transformation_is_undone(o):
    for flipped, shift, turn in itertools.product((False, True), ((0, 0), (2, 5)), turns(o)):
        moved = Gauge(flipped, shift, turn).apply(o)
        np.testing.assert_allclose(align(moved, o, ALL), o, atol=1e-12)


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
    found = np.linalg.norm(align(x, reference, ALL) - reference)
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
    overlap = np.vdot(align(mean, COMPLEX, ALL), COMPLEX)
    assert abs(overlap) > 0.999 * np.linalg.norm(mean) * np.linalg.norm(COMPLEX)
    assert aligned.std(axis=(0, 1)).mean() < 0.05


def test_what_is_symmetric_stays_as_it_is():
    even = REAL + np.flip(REAL)
    assert gauge_to(even, even, [FLIP]) == Gauge(False, (0, 0), 1.0)


@pytest.mark.parametrize("oversampling, of_complex", [(1, ALL), (2, [PHASE, FLIP])])
def test_the_likelihood_says_what_it_leaves_open(oversampling, of_complex):
    """Nothing where the field is recorded; the sign of a real object is the prior's to tell."""
    optics, camera = Fourier(REAL.shape, oversampling), Gaussian(0.1)
    intensity, field = IntensityLikelihood(optics, camera), LinearLikelihood(optics, camera)
    assert list(symmetries_of(intensity, True)) == of_complex
    assert list(symmetries_of(intensity, False)) == of_complex[1:]
    assert symmetries_of(field, True) == ()
    moved = Gauge(True, (0, 0), np.exp(2j)).apply(COMPLEX)
    np.testing.assert_allclose(align(moved, COMPLEX, intensity), COMPLEX, atol=1e-12)
    assert gauge_to(moved, COMPLEX, field) == Gauge(False, (0, 0), 1.0)
    np.testing.assert_array_equal(align(-REAL, REAL, field), -REAL)


LOST = np.where(REAL[0, 0] == REAL, np.nan, REAL)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: align(REAL, REAL.T, ALL), r"shape \(5, 6\), reference of \(6, 5\)"),
        (lambda: align(REAL[0], REAL, ALL), r"shape \(6,\), reference of \(5, 6\)"),
        (lambda: gauge_to(REAL, REAL, ["twin"]), "unknown symmetry 'twin'"),
        (lambda: align(REAL, REAL), "no symmetries: give the likelihood"),
        (lambda: align(REAL[None, None, :, :0], None, ALL), "one or more"),
        (lambda: align(np.zeros((0, 5, 4)), None, ALL), r"draws of shape \(0, 5, 4\)"),
        (lambda: align(REAL[0], None, ALL), r"draws of shape \(6,\)"),
        (lambda: align(LOST[None, None], None, ALL), "1 of 30 values of the objects"),
        (lambda: align(REAL, LOST, ALL), "1 of 30 values of the reference"),
        (lambda: gauge_to(LOST, REAL, ALL), "1 of 30 values of the objects"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
