"""A measured stack: half of its LEDs predict the images of the other half; a study."""

import os

import jax
import numpy as np
import pytest

import posterior as ps
from known import with_nominal_microscope
from posterior import models, presets
from posterior.diagnostics import align, misfit
from posterior.estimators import calibrate
from posterior.stacks import in_electrons, least_upsampling, read_stack

pytestmark = [
    pytest.mark.slow,
    pytest.mark.data,
    pytest.mark.skipif("POSTERIOR_DATA" not in os.environ, reason="no study data"),
]
WIDEST = 0.19  # NA of the LEDs that are used: 61 of 225
CHAINS = 2


@pytest.fixture(scope="module")
def halves():
    path = os.path.join(os.environ["POSTERIOR_DATA"], "fpm", "bloodsmear_red.npz")
    stack = read_stack(path)
    stack = in_electrons(stack.of(np.linalg.norm(stack.led_na, axis=1) < WIDEST))
    # At random: every other LED of a spiral would leave out whole directions.
    fitted = np.random.default_rng(0).permutation(len(stack.led_na)) % 2 == 0
    return stack.of(fitted), stack.of(~fitted), least_upsampling(stack)


def misfits(name, found, halves):
    """Of the bright fields and of the dark ones, fitted and held out; each LED its brightness."""
    *stacks, upsampling = halves
    values = []
    for stack in stacks:
        for leds in (stack.bright, ~stack.bright):
            some = stack.of(leds)
            likelihood, y = found.calibration.likelihood(some, upsampling, found.object)
            values.append(misfit(likelihood, y, found.object[None]))
    said = "bright {:.1f}, dark {:.1f}; held out: bright {:.1f}, dark {:.1f}"
    print(f"{name}: " + said.format(*values))
    return values


def test_a_calibrated_microscope_predicts_images_it_has_not_seen(halves):
    fitted, _, upsampling = halves
    believed = misfits("\nnominal", with_nominal_microscope(fitted, upsampling), halves)
    found = calibrate(fitted, upsampling, progress=False)
    right = misfits("calibrated", found, halves)
    assert right[2] < 0.6 * believed[2]
    assert right[3] < 0.6 * believed[3]

    prior = models.ScorePrior.load("complex-cells", found.object.shape)
    o = found.object * presets.prior_scale(found.object, prior)
    likelihood, y = found.calibration.likelihood(fitted, upsampling, o)
    posterior = ps.Problem(likelihood, prior).condition(y)
    start = presets.start_of("annealed", posterior, jax.random.key(0), CHAINS)
    settings = {"chains": CHAINS, "draws": 1, "start": start, "progress": False}
    sampler = presets.learned_annealing(posterior)
    draws = ps.sample(posterior, sampler, jax.random.key(1), **settings).values[:, 0]
    mean = align(draws, draws[0], ["global_phase"]).mean(axis=0)
    drawn = misfits("mean of draws", found._replace(object=mean), halves)
    assert drawn[2] < 1.1 * right[2]
    # The photons do not explain what is left: such intervals are too narrow, and this tells it.
    assert misfit(likelihood, y, draws) > 1.5
