"""Ptychography of a held-out object under the complex prior, beside quasi-Newton: a study."""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from posterior import models, presets
from posterior.diagnostics import align, phase_psnr, psnr, spread_over_error
from posterior.estimators import default_start, maximum_likelihood
from posterior.studies.ptychography import microscope
from posterior.studies.specimens import reference

pytestmark = [
    pytest.mark.slow,
    pytest.mark.data,
    pytest.mark.skipif("POSTERIOR_DATA" not in os.environ, reason="no study data"),
]
SIDE, CHAINS = 128, 4


def held_out_object(row):
    """From the columns of the reference object that no network saw, in the prior's units."""
    folder = os.path.join(os.environ["POSTERIOR_DATA"], "fpm")
    return reference(folder, "red")[row * SIDE : (row + 1) * SIDE, 384:]


def measured(truth, leds, sigma_0):
    likelihood = microscope(jnp.asarray(truth), leds, models.Poisson(round(1 / sigma_0**2), 8))
    y = likelihood.simulate(jax.random.key(0), jnp.asarray(truth))
    prior = models.ScorePrior.load("complex-cells", truth.shape)
    return ps.Problem(likelihood, prior).condition(y)


def amplitude_psnr(found, truth):
    return psnr(np.abs(found), np.abs(truth))


# Settings were looked at on the second of four objects; the others are without that.
CASES = [(89, 0.025, 1), (89, 0.05, 1), (89, 0.1, 1), (89, 0.2, 1)]
CASES += [(9, 0.1, 1), (25, 0.1, 1), (49, 0.1, 1)]
CASES += [(89, 0.05, 0), (89, 0.1, 3), (89, 0.2, 2)]


@pytest.mark.parametrize("leds, sigma_0, row", CASES)
def test_the_posterior_mean_beats_quasi_newton(leds, sigma_0, row):
    truth = held_out_object(row)
    posterior = measured(truth, leds, sigma_0)
    likelihood, y = posterior.likelihood, posterior.y
    fitted = maximum_likelihood(likelihood, y, default_start(likelihood, y)).object
    keys = jax.random.split(jax.random.key(1))
    start = presets.start_of("annealed", posterior, keys[0], CHAINS)
    sampler = presets.learned_annealing(posterior)
    settings = {"chains": CHAINS, "draws": 1, "start": start, "progress": False}
    draws = ps.sample(posterior, sampler, keys[1], **settings).values[:, 0]
    draws, fitted = (align(np.asarray(o), truth, ["global_phase"]) for o in (draws, fitted))
    mean = draws.mean(axis=0)
    ratio = spread_over_error(draws[None], truth[None])
    found = [f(o, truth) for f in (amplitude_psnr, phase_psnr) for o in (fitted, mean)]
    print(
        f"\nptychography of object {row}, {leds} LEDs, sigma_0 {sigma_0}: "
        f"amplitude quasi-Newton {found[0]:.1f} dB, mean of {CHAINS} draws {found[1]:.1f}; "
        f"phase {found[2]:.1f}, {found[3]:.1f}; spread over error {ratio:.2f}"
    )
    assert found[1] > found[0]
    assert found[3] > found[2]
