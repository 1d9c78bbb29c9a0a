"""Measured stacks: read, refused, counted in electrons, and the microscope found again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skimage import data
from skimage.transform import resize

from known import largest_z, with_nominal_microscope
from posterior import models, presets, stacks
from posterior.diagnostics import misfit
from posterior.estimators import Calibration, calibrate, default_start, maximum_likelihood
from posterior.estimators.calibration import NOMINAL
from posterior.models.pupil import pupils
from posterior.stacks import Stack, in_electrons, photon_scale, read_stack

LOW, UPSAMPLING, PIXEL, WAVELENGTH, NA = 32, 3, 1.6e-6, 0.6e-6, 0.1
RADIUS = NA / WAVELENGTH * LOW * PIXEL  # 8.5 of 16 samples
WIDE = 48  # with a rim of 8 on each side
PITCH = 0.42 * NA
STACKS = 80


def led_grid(side=5):
    axis = PITCH * (np.arange(side) - side // 2)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2) + 1e-5


def specimen():
    size = UPSAMPLING * WIDE
    grey = resize(data.cell() / 255.0, (size, size), anti_aliasing=True)
    return presets.complex_object((grey - grey.min()) / np.ptp(grey))


def exposed(calibration, electrons, leds=None):
    """Expected electrons; `electrons` where the amplitude is 1, one number or one an LED."""
    leds = led_grid() if leds is None else leds
    blank = Stack(np.ones((len(leds), LOW, LOW)), leds, NA, WAVELENGTH, PIXEL)
    field = np.asarray(calibration.optics(blank, UPSAMPLING)(jnp.asarray(specimen())))
    light = np.abs(field) ** 2 * np.broadcast_to(electrons, len(leds))[:, None, None]
    return blank._replace(intensity=light)


def counted(stack, seed=0):
    counts = np.random.default_rng(seed).poisson(stack.intensity)
    return stack._replace(intensity=counts.astype(float))


def recorded(calibration, electrons, leds=None):
    """A stack of counts."""
    return counted(exposed(calibration, electrons, leds))


WRONG = Calibration(np.array([0.4, -0.3, 0.02, 0.015]), np.r_[0.6, 0.2, -0.15, 0.1, np.zeros(15)])


# ---- files ---------------------------------------------------------------------------------------


def saved(path, **changes):
    arrays = {
        "intensity": np.random.default_rng(0).integers(1, 256, (2, 8, 8)) / 255,
        "led_na": np.array([[0.0, 0.0], [0.03, -0.05]]),
        "na": 0.1,
        "wavelength": 0.6e-6,
        "pixel_size": 2e-6,
    } | changes
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def test_both_conventions_give_the_same_stack(tmp_path):
    plain = read_stack(saved(tmp_path / "plain.npz"))
    theirs = {
        "amplitude": np.sqrt(plain.intensity),
        "kxky_NA": np.array([[0.0, 0.0, 0.0], [0.05, -0.03, 0.058]]),
        "NA": 0.1,
        "wavelength_m": 0.6e-6,
        "pixel_m": 2e-6,
    }
    nothing = dict.fromkeys(["intensity", "led_na", "na", "wavelength", "pixel_size"])
    other = read_stack(saved(tmp_path / "theirs.npz", **(nothing | theirs)))
    for ours, given in zip(plain, other):
        np.testing.assert_allclose(given, ours, rtol=1e-12)


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"intensity": None}, "one array named intensity or amplitude"),
        ({"amplitude": np.ones((2, 8, 8))}, "one array named intensity or amplitude"),
        ({"intensity": np.ones((3, 8, 8))}, "3 images for 2 LEDs"),
        ({"intensity": np.ones((8, 8))}, r"shape \(8, 8\)"),
        ({"intensity": -np.ones((2, 8, 8))}, "value -1: light is not negative"),
        ({"intensity": np.full((2, 8, 8), np.nan)}, "NaN or infinity"),
        ({"intensity": np.ones((2, 8, 8), complex)}, "complex128 images"),
        ({"intensity": np.zeros((2, 8, 8))}, "image 0 is dark everywhere"),
        (
            {"intensity": None, "amplitude": np.ones((2, 8, 8), np.uint8)},
            "values that are evenly spaced, .* name it intensity",
        ),
        (
            {"intensity": None, "amplitude": np.arange(1, 129).reshape(2, 8, 8) / 128},
            "the array amplitude holds .* evenly spaced, .* name it intensity",
        ),
        (
            {"intensity": np.sqrt(np.arange(1, 129, dtype=np.float32).reshape(2, 8, 8) / 128)},
            "the array intensity holds .* squares are evenly spaced, .* name it amplitude",
        ),
        ({"led_na": np.zeros((2, 2))}, "LEDs 0 and 1 are in the same direction"),
        ({"led_na": np.zeros(2)}, r"led_na has shape \(2,\)"),
        ({"led_na": np.array([["a", "b"]] * 2)}, "led_na has .* dtype <U1"),
        ({"led_na": None, "kxky_NA": np.zeros(2)}, r"kxky_NA has shape \(2,\)"),
        ({"led_na": np.array([[0.0, 30.0], [20.0, 0.0]])}, "30.0.* is not below 1.6; give sines"),
        ({"wavelength": 0.6}, "the pupil has a radius of"),
        ({"wavelength": 0.6e-9}, "pixel_size 2e-06 m is too coarse"),
        ({"na": 1.7}, "na must lie between 0 and 1.6"),
        ({"na": "0.1"}, "has no na"),
        ({"led_na": None}, "give the directions of the LEDs"),
        ({"na": None}, "has no na"),
        ({"wavelength": -1.0}, "wavelength -1.0: give a positive number"),
    ],
)
def test_a_file_that_is_no_stack_is_refused(tmp_path, changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        read_stack(saved(tmp_path / "stack.npz", **changes))


@pytest.mark.parametrize("well, bits", [(100, 8), (1000, None), (60_000, 12)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_wrong_name_is_known_by_the_steps_of_a_camera(tmp_path, well, bits, dtype):
    """Counts in any unit, codes finer or coarser than electrons; either way round."""
    rng = np.random.default_rng(1)
    counts = rng.poisson(well * rng.uniform(0.2, 0.9, (2, 32, 32)))
    top = well if bits is None else 2**bits - 1
    intensity = 0.37 * np.rint(np.minimum(counts / well, 1) * top) / top
    right = {"intensity": intensity, "amplitude": np.sqrt(intensity)}
    for name, other in (("intensity", "amplitude"), ("amplitude", "intensity")):
        kept, wrong = right[name].astype(dtype), right[other].astype(dtype)
        found = read_stack(saved(tmp_path / "s.npz", **{other: None, name: kept})).intensity
        np.testing.assert_allclose(found, intensity, rtol=1e-6)
        with pytest.raises(ValueError, match=f"name it {other}"):
            read_stack(saved(tmp_path / "s.npz", **{other: None, name: wrong}))


@pytest.mark.parametrize("name", ["intensity", "amplitude"])
def test_images_that_do_not_tell_their_name_are_warned_of(tmp_path, name):
    changes = {"intensity": None, name: np.random.default_rng(0).random((2, 8, 8))}
    done = {"intensity": "taken as it is", "amplitude": "squared"}[name]
    with pytest.warns(UserWarning, match=f"the array {name} is {done}, and .* do not tell"):
        read_stack(saved(tmp_path / "stack.npz", **changes))


def test_a_missing_and_a_truncated_file_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="give the path"):
        read_stack(tmp_path / "none.npz")
    path = saved(tmp_path / "stack.npz")
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ValueError, match="cannot be read as an NPZ file"):
        read_stack(path)


# ---- electrons -----------------------------------------------------------------------------------


def test_electrons_are_counted_by_the_noise_of_the_images():
    """To 5 %; a band 0.4 times as wide is caught, for structure counts as noise.

    The variance of an image is a mean over independent frequencies: half of those beyond the band,
    fewer by Hann's 1.94 an axis. A relative error e of it leaves the median of n bright ones
    uncertain by 1.25 e / sqrt(n), and e^2 / 3 off (chi-squared).
    """
    units = np.where(np.arange(25) % 2, 0.02, 0.3)
    light = exposed(NOMINAL, 400.0)
    bright = light.bright
    units[bright] = 0.05
    rows = np.fft.fftfreq(LOW) * LOW / RADIUS
    error = np.sqrt(2 * 1.94**2 / np.sum(np.hypot(rows[:, None], rows) > 2 * 0.97))

    def variances(na):
        """Measured, over that of the electrons there are: (stacks, LEDs)."""
        measured = [counted(light, seed) for seed in range(STACKS)]
        measured = [s._replace(intensity=s.intensity * units[:, None, None]) for s in measured]
        return np.array([1 / (units * photon_scale(s._replace(na=na))) for s in measured])

    found = variances(NA)
    dark = found[:, ~bright]
    assert abs(dark.mean() - 1) < 4 * error / np.sqrt(dark.size) < 0.05
    shared = found[:, bright][:, 0]
    assert abs(shared.mean() - 1) < 4 * 1.25 * error / np.sqrt(STACKS * bright.sum()) + error**2 / 3
    assert variances(0.4 * NA).mean() > 1.1


def test_given_electrons_are_taken_and_pixels_too_coarse_are_told():
    stack = recorded(NOMINAL, 400.0)
    halved = in_electrons(stack, 0.5).intensity
    np.testing.assert_array_equal(halved, np.rint(stack.intensity / 2))
    with pytest.raises(ValueError, match=r"electrons of shape \(3,\)"):
        in_electrons(stack, np.ones(3))
    with pytest.raises(ValueError, match="the least -1"):
        in_electrons(stack, -1)
    with pytest.raises(ValueError, match="hardly any noise to count by"):
        in_electrons(stack._replace(intensity=np.ones_like(stack.intensity)))
    with pytest.raises(ValueError, match="image 0 is dark everywhere"):
        in_electrons(stack, 1e-6)
    with pytest.raises(ValueError, match="too few to measure noise by"):
        photon_scale(stack._replace(na=0.16))


# ---- calibration ---------------------------------------------------------------------------------


def held_out_misfit(found, stack):
    likelihood, y = found.calibration.likelihood(stack, UPSAMPLING, found.object)
    return misfit(likelihood, y, found.object[None])


@pytest.fixture(scope="module")
def measured():
    brightness = 3000 * np.random.default_rng(2).uniform(0.7, 1.3, 49)
    return recorded(WRONG, brightness, leds=led_grid(7))


@pytest.mark.slow
def test_the_microscope_is_found_again(measured):
    """An error of a tenth in any number is caught; the errors met are up to half of the bounds.

    A turn of the LEDs converges last: a third of it is left after 5 rounds, the default.
    """
    leds, aberration = calibrate(measured, UPSAMPLING, rounds=15, progress=False).calibration
    np.testing.assert_allclose(leds[:2], WRONG.leds[:2], atol=0.02)
    np.testing.assert_allclose(leds[2:], WRONG.leds[2:], atol=0.0012)
    np.testing.assert_allclose(aberration, WRONG.aberration, atol=0.006)


@pytest.mark.slow
def test_the_microscope_found_predicts_images_it_has_not_seen(measured):
    """Half of the LEDs, told apart as on a chess board, light the images of the other half.

    With the true microscope too they have more than the noise, for the object is fitted: 1.31 to
    1.39 times in four recordings, and 1.50 to 1.59 with the one found: 1.15 times as much, with a
    sd of 0.014.
    """
    half = np.arange(49) % 2 == 0
    fitted, held_out = measured.of(half), measured.of(~half)
    found = {
        "found": calibrate(fitted, UPSAMPLING, progress=False),
        "true": calibrate(fitted, UPSAMPLING, WRONG, progress=False),
        "nominal": with_nominal_microscope(fitted, UPSAMPLING),
    }
    misfits = {name: held_out_misfit(each, held_out) for name, each in found.items()}
    print("\nmisfit of the LEDs held out:", {k: round(float(v), 2) for k, v in misfits.items()})
    assert misfits["found"] < (1.15 + 4 * 0.014) * misfits["true"]
    assert misfits["nominal"] > 10 * misfits["true"]


def smooth_disc(side, offsets):
    """Pupils for `side` camera pixels, whose edge is as soft on any grid."""
    radius = NA / WAVELENGTH * side * PIXEL
    row, column = ((np.arange(side) - side // 2 - o[:, None]) / radius for o in offsets.T)
    passed = 1 / (1 + np.exp(17 * (np.hypot(row[:, :, None], column[:, None]) - 1)))
    return np.where(passed > 1e-3, passed, 0)


def rimmed(side, rim, places):
    """Optics for `side` camera pixels, of which `rim` are cut; `places` are of a side of 64."""
    places = places * side / 64
    centres = np.rint(places).astype(int)
    pupil = smooth_disc(side, places - centres)
    return models.FourierPtychography((2 * side, 2 * side), centres, pupil, (rim, rim))


@pytest.mark.slow
def test_a_window_of_a_larger_specimen_needs_a_rim():
    """A stack cut from a field twice as wide: explained with a rim, not without.

    The object fits two degrees of freedom of the noise for each of its frequencies.
    """
    places = np.rint(led_grid() / WAVELENGTH * 64 * PIXEL)
    grey = resize(data.coins()[:300, :300] / 255.0, (128, 128), anti_aliasing=True)
    field = np.asarray(rimmed(64, 16, places)(jnp.asarray(presets.complex_object(grey))))
    light = 1000 * np.abs(field) ** 2
    counts = np.random.default_rng(0).poisson(light)
    full_well = int(counts.max()) + 1

    def fitted(rim):
        """Misfit of the likeliest object, for each degree of freedom."""
        optics = rimmed(LOW + 2 * rim, rim, places)
        camera = models.Poisson(full_well)
        likelihood = models.IntensityLikelihood(optics, camera, 1000 / full_well)
        y = counts / full_well
        o = np.asarray(maximum_likelihood(likelihood, y, default_start(likelihood, y)).object)
        return misfit(likelihood, y, o[None]) / (1 - 2 * optics.frequencies() / y.size)

    right, wrong = fitted(8), fitted(0)
    print(f"with a rim {right:.3f}, without {wrong:.3f}")
    assert abs(right - 1) < 4 * np.sqrt(np.sum(2 * light**2 + light)) / np.sum(light)
    assert wrong > 2


def test_a_calibration_to_start_from_is_where_it_starts(measured):
    found = calibrate(measured, UPSAMPLING, WRONG, rounds=0, progress=False).calibration
    for ours, theirs in zip(found, WRONG, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-9)


@pytest.mark.slow
def test_each_led_has_its_own_dispersion():
    """An electron counted four times has four times the variance; every other LED does so.

    A fit that takes up the share h of the degrees of freedom leaves an LED (1 - 2 h) of its own
    variance and h of the mean one: between that and its own, by group, to four sd of what is free.
    """
    gains = np.where(np.arange(25) % 2, 4, 1)
    light = exposed(NOMINAL, 2000.0)
    gain = gains[:, None, None]
    counts = gain * np.random.default_rng(0).poisson(light.intensity / gain).astype(float)
    found = calibrate(light._replace(intensity=counts), UPSAMPLING, rounds=2, progress=False)
    assert found.dispersion.shape == (25,)
    np.testing.assert_array_equal(found.dispersion > 2, gains == 4)
    # On the mean of all it is right, to four sd and the bias that its docstring states.
    assert found.dispersion.mean() == pytest.approx(gains.mean(), rel=0.09)
    h = 2 * NOMINAL.optics(light, UPSAMPLING).frequencies() / counts.size
    for own in (1, 4):
        some = gains == own
        error = 1 + 4 * np.sqrt(2 / ((1 - h) * some.sum() * LOW**2))
        shared = ((1 - 2 * h) * own + h * gains.mean()) / (1 - h)
        low, high = sorted([own, shared])
        assert low / error < found.dispersion[some].mean() < high * error


def test_a_dispersed_stack_keeps_its_mean():
    light = exposed(NOMINAL, 2000.0)
    counts = light._replace(intensity=4.0 * np.random.default_rng(0).poisson(light.intensity / 4))
    divisors = np.linspace(2, 6, 25)
    divisors[:2] = np.nan, 0.8
    fewer = stacks.dispersed(counts, divisors, jax.random.key(0)).intensity
    np.testing.assert_array_equal(fewer, np.rint(fewer))
    np.testing.assert_array_equal(fewer[:2], counts.intensity[:2])
    rounding = largest_z(23) * 0.5 * LOW
    expected = counts.intensity.sum(axis=(1, 2)) / divisors
    assert np.abs(fewer.sum(axis=(1, 2)) - expected)[2:].max() < rounding
    with pytest.raises(ValueError, match="image 0 is dark everywhere"):
        stacks.dispersed(counts, np.full(25, 1e9), jax.random.key(0))


def test_intensities_that_are_no_electrons_are_refused(measured):
    with pytest.raises(ValueError, match="use in_electrons first"):
        calibrate(measured._replace(intensity=measured.intensity / 3), UPSAMPLING)


def test_optics_of_a_calibration_have_their_pupils_where_the_leds_are():
    blank = recorded(WRONG, 1.0)
    optics = WRONG.optics(blank, UPSAMPLING)
    places = led_grid() / WAVELENGTH * WIDE * PIXEL
    turned = np.stack([-places[:, 1], places[:, 0]], 1)
    places = places * 1.02 + 0.015 * turned + [0.4, -0.3]
    offsets = places - optics.centres
    assert np.abs(offsets).max() <= 0.5
    radius = RADIUS * WIDE / LOW
    expected = pupils((WIDE, WIDE), (radius, radius), offsets, WRONG.aberration)
    np.testing.assert_allclose(optics.pupil, expected, atol=1e-5)


@pytest.mark.parametrize("scale", np.linspace(0.5, 1.6, 12))
def test_the_least_upsampling_holds_every_led(scale):
    blank = recorded(NOMINAL, 1.0)
    blank = blank._replace(led_na=blank.led_na * scale)
    needed = stacks.least_upsampling(blank)
    NOMINAL._replace(leds=np.array([0.8, -0.8, 0, 0])).optics(blank, needed)


def test_an_upsampling_below_the_least_is_refused():
    blank = recorded(NOMINAL, 1.0)
    with pytest.raises(ValueError, match="leaves the band"):
        NOMINAL.optics(blank, stacks.least_upsampling(blank) - 1)


def test_the_start_is_of_bright_fields_alone():
    """Of mean amplitude 1: dark fields, each brought to the same mean, would change it by 0.2."""
    stack = recorded(NOMINAL, 3000.0, leds=led_grid(7))
    found = calibrate(stack, UPSAMPLING, rounds=0, progress=False).object
    assert np.abs(found).mean() == pytest.approx(1, abs=0.05)


def test_one_pupil_an_led_is_as_many_as_there_are_leds():
    centres = np.array([[0, 0], [1, 1]])
    with pytest.raises(ValueError, match="one for each of the 2 LEDs"):
        models.FourierPtychography((16, 16), centres, np.ones((3, 4, 4)))
    key = jax.random.key(0)
    pupil = np.asarray(jax.random.normal(key, (2, 4, 4)))
    both = models.FourierPtychography((16, 16), centres, pupil)
    o = jax.random.normal(key, (16, 16)) + 0j
    for i in range(2):
        one = models.FourierPtychography((16, 16), centres[i : i + 1], pupil[i])
        np.testing.assert_allclose(both(o)[i], one(o)[0], rtol=1e-5)
