"""Half of a stack predicts the other: residuals on a microscope and an object that are known."""

import jax.numpy as jnp
import numpy as np
import pytest

from posterior.diagnostics import misfit
from posterior.estimators.calibration import NOMINAL, Calibrated
from posterior.stacks import Stack
from posterior.studies import Answer, StackHalves, stack_table
from posterior.studies.stack_plot import prediction

LOW, UPSAMPLING, NA = 32, 3, 0.1
LEDS, ELECTRONS = 25, 2000


def led_grid():
    axis = 0.042 * (np.arange(5) - 2)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2) + 1e-5


def specimen(side=UPSAMPLING * 48):
    x, y = np.meshgrid(*[2 * np.pi * np.arange(side) / side] * 2)
    return (0.8 + 0.1 * np.cos(3 * x) * np.sin(2 * y)) * np.exp(0.4j * np.sin(4 * x + y))


@pytest.fixture(scope="module")
def stack():
    """Poisson counts of 25 LEDs of a known microscope."""
    blank = Stack(np.ones((LEDS, LOW, LOW)), led_grid(), NA, 0.6e-6, 1.6e-6)
    field = np.asarray(NOMINAL.optics(blank, UPSAMPLING)(jnp.asarray(specimen())))
    light = ELECTRONS * np.abs(field) ** 2
    # No LED is ever quite dark, or it has no brightness to be fitted.
    counts = np.random.default_rng(0).poisson(np.maximum(light, 1e-3)).astype(float)
    counts[:, 0, 0] = np.maximum(counts[:, 0, 0], 1)
    return blank._replace(intensity=counts)


@pytest.fixture(scope="module")
def study(stack):
    """As if calibration had found the truth."""
    half = np.arange(LEDS) % 2 == 0
    found = Calibrated(
        NOMINAL._replace(background=True),
        specimen(),
        np.ones(half.sum()),
        np.full(half.sum(), 20.0),
    )
    return StackHalves(stack.of(half), stack.of(~half), UPSAMPLING, found, "complex-cells", 2, 0)


def test_the_true_object_has_the_residuals_of_photon_noise(study):
    found = study.residuals(specimen())
    for value, stack in zip(found[::2], (study.fitted, study.held_out)):
        pixels = stack.intensity[stack.bright].size
        assert abs(value - 1) < 4 * np.sqrt(2.2 / pixels)
    wrong = study.residuals(np.abs(specimen()) + 0j)
    assert min(wrong[::2]) > 3


@pytest.mark.slow
def test_systems_are_given_the_images_of_the_fitted_half(study):
    recording = study.recording()
    assert recording.measured and recording.y.shape == (13, LOW, LOW)
    o = study.found.object
    # In the units of the prior, by its mean energy.
    scaled = o * np.sqrt(2 * (0.241**2 + 0.311**2) / np.mean(np.abs(o) ** 2))
    found = misfit(recording.likelihood, recording.y, scaled[None])
    assert abs(found - 1) < 4 * np.sqrt(2.2 / recording.y.size)


def test_the_table_tells_bright_from_dark_and_seen_from_held_out(study):
    draws = np.stack([specimen(), 1.02 * specimen()])
    answers = {
        "draws": Answer(draws[None], np.array([4.0]), 10**6),
        "one": Answer(draws[None, :1], np.array([4.0]), 10**6),
        "lacking": Answer(np.empty(0), np.empty(0), 0, "recording 0: no weights"),
    }
    table = stack_table(study, answers)
    rows = [line for line in table.splitlines() if line.startswith("| ")]
    assert len(rows) == 4 and len({row.count("|") for row in rows}) == 1
    expected = [f"{value:.2f}" for value in study.residuals(specimen())]
    assert rows[1].split(" | ")[1:5] == expected
    assert "- lacking: no answer to recording 0" in table
    fitted = study.fitted
    shares = (
        20 / fitted.of(k).intensity.mean(axis=(1, 2)) for k in (fitted.bright, ~fitted.bright)
    )
    bright, dark = (f"{100 * np.median(share):.1f}" for share in shares)
    assert f"Background is {bright} % of bright fields and {dark} % of dark fields" in table


def test_the_figure_shows_a_held_out_bright_field_and_what_is_left_of_it(study):
    """Of the true object photon noise is left: mean square 1, to 4 sd of 32 x 32 pixels."""
    answer = Answer(np.stack([specimen()] * 2)[None], np.array([4.0]), 10**6)
    figure = prediction(
        study, {"draws": answer, "one": answer._replace(images=answer.images[:, :1])}
    )
    titles = [axis.get_title() for axis in figure.axes]
    assert {"measured, held out", "draws, mean of 2", "one"} <= set(titles)
    bright = study.held_out.of(study.held_out.bright)
    led = np.linalg.norm(bright.led_na, axis=1).argmin()
    np.testing.assert_array_equal(figure.axes[0].images[0].get_array(), bright.intensity[led])
    left = figure.axes[4].images[0].get_array()
    assert abs(np.mean(left**2) - 1) < 4 * np.sqrt(2.2 / left.size)
    assert f"mean square {np.mean(left**2):.1f}" in titles[4]


def test_a_stack_too_small_is_refused(stack, tmp_path):
    path = tmp_path / "stack.npz"
    np.savez(
        path, intensity=stack.intensity, led_na=stack.led_na, na=NA, wavelength=0.6e-6,
        pixel_size=1.6e-6,
    )  # fmt: skip
    with pytest.raises(ValueError, match="1 LEDs below NA 0.01"):
        StackHalves.of(path, 0, 0.01, "complex-cells", 2, 0)
    with pytest.raises(ValueError, match="--view 8: give 16 to 32"):
        StackHalves.of(path, 8, 0.2, "complex-cells", 2, 0)
    with pytest.raises(ValueError, match="no score weights"):
        StackHalves.of(path, 0, 0.2, "nowhere", 2, 0)
