"""Gain and offset of a known camera, and what must not move them."""

import numpy as np
import pytest

from posterior.estimators import photon_transfer

GAIN, OFFSET, CAMERAS = 6.4, 15.0, 400


def captures(seed, brightness=(1.0, 1.0, 1.0, 1.0), side=72):
    """Unrounded pictures of a smooth scene of 1 to 12 photons."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:side, :side] * (2 * np.pi / side)
    scene = 6.5 + 5.5 * np.sin(3 * rows) * np.cos(2 * columns)
    counts = rng.poisson(np.multiply.outer(brightness, scene))
    return OFFSET + GAIN * counts


@pytest.mark.parametrize("brightness", [(1, 1, 1, 1), (1.2, 1.0, 1.05, 0.8)])
def test_a_known_camera_is_found_within_the_stated_errors(brightness):
    """Also where the light of the captures differs; their errors are right on average."""
    found = [photon_transfer(captures(seed, brightness)) for seed in range(CAMERAS)]
    for value, error, true in (("gain", "gain_error", GAIN), ("offset", "offset_error", OFFSET)):
        off = np.array([getattr(f, value) for f in found]) - true
        error = np.array([getattr(f, error) for f in found])
        assert abs(off.mean()) < 4 * off.std(ddof=1) / np.sqrt(CAMERAS)
        # A jackknife of 16 tiles makes z near a t of 15 degrees: z^2 has mean 15/13, sd 1.84.
        # Errors a quarter too small or too large fail.
        assert np.mean((off / error) ** 2) == pytest.approx(
            15 / 13, abs=4 * 1.84 / np.sqrt(CAMERAS)
        )


def test_whole_grey_levels_are_taken_as_rounded():
    """1/12 of variance less at every brightness: darkness is where that much less is left."""
    whole = np.round(captures(0)).astype(np.uint8)
    rounded, taken_as_is = photon_transfer(whole), photon_transfer(whole.astype(float))
    shift = rounded.offset - taken_as_is.offset
    assert shift == pytest.approx(1 / 12 / rounded.gain, rel=0.05)


def test_saturated_bins_are_left_out():
    """Without a bias by what is left; not told of it, the gain is wrong."""
    clipped = [np.minimum(captures(seed), 110) for seed in range(100)]
    told = np.array([photon_transfer(c, saturation=110).gain for c in clipped])
    untold = np.array([photon_transfer(c).gain for c in clipped])
    assert abs(told.mean() - GAIN) < 4 * told.std(ddof=1) / np.sqrt(100)
    assert abs(untold.mean() - GAIN) > 10 * untold.std(ddof=1) / np.sqrt(100)


def test_what_is_no_repeated_capture_is_refused():
    with pytest.raises(ValueError, match="n >= 3"):
        photon_transfer(captures(0)[:2])
    with pytest.raises(ValueError, match="64 x 64"):
        photon_transfer(captures(0)[:, :63, :63])
    broken = captures(0).astype(float)
    broken[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        photon_transfer(broken)
    rng = np.random.default_rng(0)
    scene = np.linspace(10, 200, 72)
    dimmer = scene + rng.normal(size=(4, 72, 72)) * np.sqrt(300 - scene)
    with pytest.raises(ValueError, match="does not grow"):
        photon_transfer(dimmer)
    with pytest.raises(ValueError, match="saturated"):
        photon_transfer(captures(0), saturation=20)
    with pytest.raises(ValueError, match="do not differ"):
        photon_transfer(np.minimum(captures(0), 5), saturation=5)
