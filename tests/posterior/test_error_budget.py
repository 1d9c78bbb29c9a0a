"""Where the error of an annealed draw comes from: likelihood, ending, steps, network.

One cause added to the other.

A study. Two networks are trained on draws of a mixture of Gaussians, half a minute each.
"""

import jax
import numpy as np
import pytest

import posterior as ps
from known import batch_error
from networks import trained_on, two_levels
from posterior import models, samplers

pytestmark = pytest.mark.slow
TRUTHS, FULL_WELL = 8, 200  # data and prior tell about as much
FINEST = 0.005  # of the networks; the annealing ends at twice that, in a descent


def test_error_budget_of_annealed_langevin_on_photon_counts():
    """Photon counts of pictures of 8x8 pixels that are dark or bright; the prior known.

    Against MALA under it and the exact likelihood: the distance of the means in posterior sd, the
    Monte-Carlo part taken off, and the ratio of the sd.
    """
    exact = two_levels()
    training = {"steps": 3000, "widths": [24], "batch": 32}
    score, energy = (trained_on(exact, kind=kind, **training)[1] for kind in ("score", "energy"))
    camera = models.Poisson(FULL_WELL)
    likelihood = models.LinearLikelihood(models.Identity(exact.shape), camera)
    problem = ps.Problem(likelihood, exact)
    keys = jax.random.split(jax.random.key(5), TRUTHS)
    recordings = [np.asarray(problem.simulate(key)[1]) for key in keys]

    ending = {"sigma_min": 2 * FINEST, "descent": 6}
    mala = samplers.MALA(), {"draws": 250, "thin": 10, "warmup": 600, "chains": 4}
    many, few = {"levels": 180, "steps": 16}, {"draws": 5, "chains": 100}
    fine = samplers.AnnealedLangevin(**many, sigma_min=FINEST / 5), few
    ended = samplers.AnnealedLangevin(**many, **ending), few
    usual = samplers.AnnealedLangevin(levels=45, steps=4, **ending), few
    arms = {
        "MALA again: the floor": (exact, *mala),
        "likelihood at a level: exact prior, 16 times the steps": (exact, *fine),
        "and the ending at a network's finest level": (exact, *ended),
        "and steps: as with a network": (exact, *usual),
        "all: the score of a network": (score, *usual),
        "all: the energy of another": (energy, *usual),
        "network alone: this energy, MALA": (energy, *mala),
        "a read noise that is not there, MALA": (exact, *mala),
    }
    noisier = models.PoissonGaussian(FULL_WELL, read_noise=3.0)  # 9 beside 40 to 160 photons
    believed = models.LinearLikelihood(likelihood.optics, noisier)
    reference = [drawn(exact, likelihood, y, *mala, key=1) for y in recordings]
    print("\n  mean off, sd ratio (in posterior sd)")
    found = {}
    for name, (prior, *how) in arms.items():
        used = believed if "read noise" in name else likelihood
        draws = [drawn(prior, used, y, *how, key=2) for y in recordings]
        found[name] = compared(draws, reference)
        print("  {:8.3f} {:8.3f}".format(*found[name]), name, flush=True)
    floor, likelihood_alone, *annealed, network, wrong = found.values()
    # The floor of 256 independent draws of 512 pixels in each set: 0.3 % of an sd.
    assert floor[0] < 0.02 and abs(floor[1] - 1) < 0.015
    assert wrong[1] > 1.03
    assert likelihood_alone[0] < 0.05 and abs(likelihood_alone[1] - 1) < 0.015
    # No better than that: they are what they were measured to be, and must not become worse.
    assert all(off < 0.15 and abs(ratio - 1) < 0.08 for off, ratio in annealed)
    assert network[0] < 0.3 and abs(network[1] - 1) < 0.12


def drawn(prior, likelihood, y, sampler, settings, key):
    """Mean, variance, and squared Monte-Carlo error of the mean, of every pixel."""
    posterior = ps.Problem(likelihood, prior).condition(y)
    # Dark or bright is sure: a chain that begins in the other mode would stay there.
    start = np.full(prior.shape, 0.2 if y.mean() < 0.5 else 0.8)
    run = ps.sample(
        posterior, sampler, jax.random.key(key), start=start, progress=False, **settings
    )
    draws = run.values.reshape(*run.values.shape[:2], -1)
    if draws.shape[1] < draws.shape[0]:  # independent draws: one chain of them
        draws = draws.reshape(1, -1, draws.shape[-1])
    return draws.mean((0, 1)), draws.var((0, 1)), batch_error(draws) ** 2


def compared(found, reference):
    """Distance of the means in posterior sd, less what is Monte Carlo, and ratio of the sd."""
    means, variances, errors = (np.array(part) for part in zip(*found))
    exact, spread, noise = (np.array(part) for part in zip(*reference))
    squared = np.mean(((means - exact) ** 2 - errors - noise) / spread)
    return float(np.sqrt(max(squared, 0.0))), float(np.sqrt(np.mean(variances) / np.mean(spread)))
