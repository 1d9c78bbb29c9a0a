"""Residual checks: silent at their nominal rate where the noise is as said, loud where not."""

import numpy as np
import pytest
import scipy.stats

from posterior.diagnostics import residual_checks

SIDE, REPEATS = 128, 400
NAMES = ("square", "rows", "columns", "blocks")


def scene(side=SIDE):
    """1 to 12 photons."""
    rows, columns = np.mgrid[:side, :side] * (2 * np.pi / side)
    return 6.5 + 5.5 * np.sin(3 * rows) * np.cos(2 * columns)


def recorded(rng, fault=None):
    """Counts less their mean; `fault`: what the model is not told."""
    light = scene()
    if fault == "gain":
        return 1.05 * (rng.poisson(light) - light)
    if fault == "drift":
        return rng.poisson(light * np.linspace(0.96, 1.04, SIDE)[:, None]) - light
    noise = rng.poisson(light) - light
    if fault in ("rows", "columns"):
        axis = 1 if fault == "rows" else 0
        share = 0.06
        return (noise + share * np.roll(noise, 1, axis)) / np.sqrt(1 + share**2)
    return noise


def test_false_alarms_come_at_the_nominal_rate():
    """At 5 % in 400 recordings: within the binomial interval of 99 %, at both ends."""
    rng = np.random.default_rng(0)
    checks = [residual_checks(recorded(rng), scene(), block=8) for _ in range(REPEATS)]
    low, high = scipy.stats.binom(REPEATS, 0.05).interval(0.99)
    for name in NAMES:
        alarms = sum(getattr(c, name).p < 0.05 for c in checks)
        assert low <= alarms <= high, (name, alarms)


@pytest.mark.parametrize(
    "fault, name",
    [("gain", "square"), ("rows", "rows"), ("columns", "columns"), ("drift", "blocks")],
)
def test_a_fault_is_seen_by_its_own_figure(fault, name):
    """In 95 of 100 recordings of 128 x 128: 5 % of gain, 6 % of a neighbour, light 4 % off."""
    rng = np.random.default_rng(1)
    seen = sum(
        getattr(residual_checks(recorded(rng, fault), scene()), name).p < 0.01 for _ in range(100)
    )
    assert seen >= 95, seen


def test_pixels_without_variance_are_left_out():
    rng = np.random.default_rng(2)
    difference, variance = recorded(rng), scene()
    variance[:, 64:] = 0
    half = residual_checks(difference, variance)
    difference[:, 64:] = 1e6
    assert residual_checks(difference, variance) == half
    alone = residual_checks(difference[:, :64], variance[:, :64])
    for name in NAMES:
        assert getattr(alone, name) == pytest.approx(getattr(half, name))


@pytest.mark.parametrize(
    "difference, variance, words",
    [
        (np.zeros((64, 64)), np.ones((64, 32)), "one \\(h, w\\) for both"),
        (np.zeros((64, 64)), -np.ones((64, 64)), "variances from 0"),
        (np.full((64, 64), np.nan), np.ones((64, 64)), "4096 of 4096 values of the differences"),
        (np.zeros((64, 64)), np.full((64, 64), np.inf), "4096 of 4096 values of the variances"),
        (np.zeros((64, 64)) + 1j, np.ones((64, 64)), "complex differences"),
        (np.zeros((64, 64)), np.zeros((64, 64)), "not all 0"),
        (np.zeros((40, 40)), np.ones((40, 40)), "blocks of 32"),
    ],
)
def test_what_cannot_be_checked_is_refused(difference, variance, words):
    with pytest.raises(ValueError, match=words):
        residual_checks(difference, variance)


@pytest.mark.parametrize("block", [0, 1.5])
def test_blocks_are_whole_pixels(block):
    with pytest.raises(ValueError, match=f"blocks of {block}"):
        residual_checks(np.zeros((64, 64)), np.ones((64, 64)), block)
