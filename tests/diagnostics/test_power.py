"""Which fault is seen by which quantity, and at how many simulations; false alarms beside it.

A study. One pool of simulations a fault is cut into as many calibrations as it holds.
"""

import jax
import numpy as np
import pytest
import scipy.stats
from faults import GaussianCase, MixtureCase

import posterior as ps
from posterior import models, samplers
from posterior.diagnostics import holm, sbc, uniformity
from posterior.models.gallery import one_complex_pixel

pytestmark = pytest.mark.slow

POOL, SIZES = 16000, (25, 50, 100, 200, 400, 800)
CASE, MIXTURE = GaussianCase(), MixtureCase()


class Denoising:
    """1024 unknown pixels, each with its own noise."""

    problem = ps.Problem(
        models.LinearLikelihood(models.Identity((32, 32)), models.Gaussian(0.5)),
        models.GaussianField(np.ones((32, 32))),
    )


FAULTS = {
    "temperature 10 % too high": (CASE.problem, CASE.drawer(temperature=1.1)),
    "Langevin noise without sqrt 2": (CASE.problem, CASE.langevin(noise=np.sqrt(0.5))),
    "noise level 10 % too high": (CASE.problem, CASE.drawer(noise=1.1 * CASE.noise)),
    "a lost mode": (MIXTURE.problem, MIXTURE.drawer(lost=True)),
    "the prior": (CASE.problem, CASE.of_the_prior),
    "the prior, 1024 unknowns": (Denoising.problem, CASE.of_the_prior),
    "right marginals, no correlations": (CASE.problem, CASE.drawer(marginals=True)),
    "another recording": (CASE.problem, CASE.of_other_data),
}


def pooled(problem, drawer, count=POOL, **settings):
    """Calibration of a pool, and a function that cuts it into p-values (repeats, Q) at a size."""
    found = sbc(problem, drawer, jax.random.key(0), count, batch=100, progress=False, **settings)

    def p_values(size):
        parts = found.ranks[: len(found.ranks) // size * size].reshape(-1, size, len(found.names))
        return np.array([[uniformity(u) for u in part.T] for part in parts])

    return found, p_values


def rejections(p):
    """Which repetitions reject once p (repeats, Q) is corrected for Q."""
    return np.array([min(holm(dict(enumerate(row))).values()) < 0.05 for row in p])


def smallest(caught):
    """The smallest size at which 95 % of the repetitions are caught, or a dash."""
    sizes = [size for size, share in caught.items() if share >= 0.95]
    return str(min(sizes)) if sizes else "-"


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_caught_in_95_of_100_repetitions(fault):
    found, p_values = pooled(*FAULTS[fault])
    by_quantity = {name: {} for name in found.names}
    together = {}
    for size in SIZES:
        p = p_values(size)
        together[size] = rejections(p).mean()
        for name, column in zip(found.names, p.T):
            by_quantity[name][size] = np.mean(column < 0.05)
    print(f"\n{fault}: caught at {smallest(together)} simulations; by one quantity alone:")
    print("  " + ", ".join(f"{name} {smallest(caught)}" for name, caught in by_quantity.items()))
    assert max(together.values()) >= 0.95


def test_false_alarms_of_an_exact_sampler_are_as_many_as_stated():
    """400 calibrations of 40 simulations each, and each quantity by itself."""
    found, p_values = pooled(CASE.problem, CASE.drawer())
    p = p_values(40)
    alarms = dict(zip(found.names, np.sum(p < 0.05, axis=0)), together=np.sum(rejections(p)))
    print("\nfalse alarms in", len(p), {name: int(count) for name, count in alarms.items()})
    least, most = scipy.stats.binom(len(p), 0.05).interval(0.99)
    assert all(least <= count <= most for count in alarms.values())


def test_the_printed_equation_is_caught_and_the_consistent_one_is_closer():
    """Paper, eq:complex_final, beside the default: the largest distance of ranks from uniform."""
    known, run = one_complex_pixel(), {"chains": 40, "draws": 1}
    problem = ps.Problem(known.likelihood, known.prior)
    settings = {"levels": 200, "steps": 5, "path": "split"}
    distances, shares = {}, {}
    for name, published in (("consistent", False), ("printed", True)):
        sampler = samplers.AnnealedLangevin(**settings, published=published)
        found, p_values = pooled(problem, sampler, 800, **run)
        caught = {size: rejections(p_values(size)).mean() for size in SIZES[:4]}
        shares[name] = max(caught.values())
        distances[name] = max(scipy.stats.kstest(u, "uniform").statistic for u in found.ranks.T)
        print(f"\n{name}: caught at {smallest(caught)}; {found.verdict()}")
    print({name: round(float(value), 3) for name, value in distances.items()})
    assert shares["printed"] >= 0.95
    assert distances["printed"] > 2 * distances["consistent"]
