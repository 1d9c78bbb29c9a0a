"""Background of the images of a stack: found beside the brightness, by the noise there is."""

import jax.numpy as jnp
import numpy as np
import pytest

from known import largest_z
from posterior.diagnostics import misfit
from posterior.estimators import calibrate
from posterior.estimators.calibration import NOMINAL
from posterior.stacks import Stack

LOW, UPSAMPLING, LEDS = 32, 3, 25
SIDE = UPSAMPLING * 48  # with the rim
STACKS = 20
SEEING = NOMINAL._replace(background=True)


def led_grid():
    axis = 0.042 * (np.arange(5) - 2)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2) + 1e-5


def specimen():
    x, y = np.meshgrid(*[2 * np.pi * np.arange(SIDE) / SIDE] * 2)
    rough = np.random.default_rng(1).standard_normal((SIDE, SIDE))
    rough = np.fft.ifft2(np.fft.fft2(rough) * np.exp(-((np.hypot(*grid_of(SIDE)) / 30) ** 2))).real
    return (0.8 + 0.1 * np.cos(9 * x) * np.sin(8 * y)) * np.exp(0.5j * rough / rough.std())


def grid_of(side):
    return np.meshgrid(*[np.fft.fftfreq(side, 1 / side)] * 2)


BRIGHTNESS = 2000 * np.random.default_rng(2).uniform(0.7, 1.3, LEDS)
BACKGROUND = np.random.default_rng(3).uniform(20, 60, LEDS)


@pytest.fixture(scope="module")
def light():
    """Electrons that the object sends into each image, at a brightness of 1."""
    blank = Stack(np.ones((LEDS, LOW, LOW)), led_grid(), 0.1, 0.6e-6, 1.6e-6)
    field = np.asarray(NOMINAL.optics(blank, UPSAMPLING)(jnp.asarray(specimen())), complex)
    return blank._replace(intensity=np.abs(field) ** 2)


def counted(light, background, seed=0):
    expected = BRIGHTNESS[:, None, None] * light.intensity + np.reshape(background, (-1, 1, 1))
    counts = np.random.default_rng(seed).poisson(expected)
    return light._replace(intensity=counts.astype(float))


def sd_of(light, background):
    """Of the background of each image beside its brightness, by their Fisher information."""
    expected = BRIGHTNESS[:, None, None] * light.intensity + background[:, None, None]
    parts = np.stack([light.intensity, np.ones_like(light.intensity)])
    information = np.einsum("aijk,bijk,ijk->iab", parts, parts, 1 / expected)
    return np.sqrt(np.linalg.inv(information)[:, 1, 1])


def backgrounds(likelihood):
    return np.ravel(likelihood.background) * likelihood.camera.full_well


def test_the_background_of_each_image_is_found_within_its_error(light):
    """Of the true object: by the z of many stacks, whose mean is 0 and whose variance is 1."""
    sd = sd_of(light, BACKGROUND)
    z = np.stack(
        [
            (backgrounds(SEEING.likelihood(stack, UPSAMPLING, specimen())[0]) - BACKGROUND) / sd
            for stack in (counted(light, BACKGROUND, seed) for seed in range(STACKS))
        ]
    )
    assert (4 * sd < BACKGROUND).all(), "a bound at 0 would cut the errors"
    assert np.abs(z).max() < largest_z(z.size)
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert abs(z.var() - 1) < 4 * np.sqrt(2 / z.size)


def test_a_background_is_never_negative(light):
    """Where there is none half of the images say 0, the others what their noise allows."""
    found = [
        backgrounds(SEEING.likelihood(counted(light, 0.0, seed), UPSAMPLING, specimen())[0])
        for seed in range(STACKS)
    ]
    z = np.stack(found) / sd_of(light, np.full(LEDS, 1e-2))
    assert z.min() >= 0 and z.max() < largest_z(z.size)
    assert abs(np.mean(z < 1e-3) - 0.5) < 4 * 0.5 / np.sqrt(z.size)


def test_a_background_that_no_model_holds_is_seen_in_the_misfit(light):
    stack = counted(light, BACKGROUND)
    for calibration, right in ((SEEING, True), (NOMINAL, False)):
        likelihood, y = calibration.likelihood(stack, UPSAMPLING, specimen())
        found = misfit(likelihood, y, specimen()[None])
        assert (abs(found - 1) < 4 * np.sqrt(2.2 / y.size)) == right
    assert found > 1.2


@pytest.mark.slow
def test_background_and_object_are_found_together(light):
    """The object is fitted too and takes some: to 4 sd and a tenth, where none would be all of it.

    Without background in the model the dark fields are not explained, nor the LEDs in their places.
    """
    stack = counted(light, BACKGROUND)
    found = calibrate(stack, UPSAMPLING, SEEING, progress=False)
    blind = calibrate(stack, UPSAMPLING, NOMINAL, progress=False)
    off = found.background - BACKGROUND
    print("\nz:", np.round(off / sd_of(light, BACKGROUND), 1), "off:", np.round(off, 1))
    print(
        "dispersion:",
        np.round(np.median(found.dispersion), 2),
        np.round(np.median(blind.dispersion), 2),
    )
    assert not blind.background.any()
    assert (np.abs(off) < 4 * sd_of(light, BACKGROUND) + 0.1 * BACKGROUND).all()
    dark = ~stack.bright
    assert np.median(blind.dispersion[dark]) > 1.2 * np.median(found.dispersion[dark])
