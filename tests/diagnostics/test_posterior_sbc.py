"""Calibration at one recording: passes exact samplers at its level, and what it can and cannot see.

The posterior given one exposure and given two are both written down, so that a fault can be planted
in the second run or in both.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from faults import GaussianCase

import posterior as ps
from posterior import models, samplers
from posterior.diagnostics import holm, posterior_sbc, sbc, uniformity
from posterior.diagnostics.quantities import SquaredNorm


class Exposed(GaussianCase):
    """A linear-Gaussian problem, one recording, and its posteriors given any number of exposures.

    Of a temperature, a noise level and a prior covariance that are so many times the true ones.
    """

    def __init__(self, size=8, rows=6):
        super().__init__(size, rows)
        self.y = np.asarray(self.problem.simulate(jax.random.key(5))[1])
        self.given = self.problem.condition(self.y)

    def exact(self, exposures, temperature=1.0, noise=1.0, prior=1.0):
        """The matrix that makes its mean of the mean exposure, and a root of its covariance."""
        precision = exposures / (noise * self.noise) ** 2
        h = self.matrix
        covariance = np.linalg.inv(np.linalg.inv(prior * self.prior) + precision * h.T @ h)
        return precision * covariance @ h.T, np.linalg.cholesky(temperature * covariance)

    def first(self, count, **fault):
        """Draws (count, size) given the recording."""
        gain, root = self.exact(1, **fault)
        # Not the seed of the matrix: these numbers would be its entries.
        n = np.random.default_rng(1).standard_normal((count, self.size))
        return gain @ self.y + n @ root.T

    def drawer(self, exposures=2, **fault):
        """A drawer given so many exposures."""
        return Drawer(*self.exact(exposures, **fault))


class Drawer(eqx.Module):
    """Draws by the matrix and the root of `Exposed.exact`; compiled once for all of them."""

    gain: jax.Array = eqx.field(converter=jnp.asarray)
    root: jax.Array = eqx.field(converter=jnp.asarray)

    def __call__(self, key, posterior):
        mean = posterior.y.reshape(-1, self.gain.shape[1]).mean(axis=0)
        return self.gain @ mean + jax.random.normal(key, (1, 20, len(self.gain))) @ self.root.T


SMALL, CASE = Exposed(), Exposed(64, 48)
ASKED = {
    "first": lambda x, y: x[0],
    "last": lambda x, y: x[-1],
    "misfit": lambda x, y: ((SMALL.matrix @ x - y) ** 2).sum(),
    "change": lambda x, y: (SMALL.matrix @ x) @ (y[1] - y[0]),
    "norm": SquaredNorm(),
}


def calibrated(case, simulations, first=None, second=None, **settings):
    drawer = case.drawer(**(second or {}))
    return posterior_sbc(
        case.given, case.first(simulations, **(first or {})), drawer, jax.random.key(0),
        simulations, progress=False, **settings,
    )  # fmt: skip


def alarms(ranks, size):
    """In how many calibrations of `size` simulations each, cut from ranks (n, Q), one rejects."""
    parts = ranks.reshape(-1, size, ranks.shape[1])
    p = [[uniformity(u) for u in part.T] for part in parts]
    return sum(min(holm(dict(enumerate(each))).values()) < 0.05 for each in p)


@pytest.mark.slow
def test_false_alarms_are_as_many_as_stated():
    """400 calibrations of 40 simulations each, at one recording."""
    found = calibrated(SMALL, 400 * 40, batch=100, quantities=ASKED)
    # Five quantities under Holm reject at most as often as one; each by itself as often as stated.
    least, most = scipy.stats.binom(400, 0.05).interval(0.99)
    assert alarms(found.ranks, 40) <= most
    for column in found.ranks.T:
        assert least <= alarms(column[:, None], 40) <= most


def test_exact_draws_pass():
    assert calibrated(CASE, 400).verdict(alpha=0.001).startswith("passes")


@pytest.mark.parametrize("fault", [{"temperature": 1.1}, {"noise": 1.1}], ids=str)
def test_a_fault_of_the_second_run_is_caught(fault):
    assert calibrated(CASE, 400, second=fault).verdict(alpha=0.001).startswith("fails")


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [{"temperature": 1.1}, {"noise": 1.1}, {"prior": 1.5}, {"exposures": 1}, {"exposures": 0}],
    ids=str,
)
def test_each_fault_of_the_second_run_is_caught_in_95_of_100_repetitions(fault):
    """Of 20 or more; the last believe a single exposure, and none. The number is printed."""
    found = calibrated(CASE, 16000, batch=100, second=fault)
    for size in (25, 50, 100, 200, 400, 800):
        caught = alarms(found.ranks, size) / (16000 // size)
        print(f"\n{fault}: caught in {100 * caught:.0f} % of repetitions at {size} simulations")
        if caught >= 0.95:
            return
    pytest.fail(f"{fault} is caught in {100 * caught:.0f} % only")


@pytest.mark.slow
@pytest.mark.parametrize("fault", [{"temperature": 1.1}, {"noise": 1.1}], ids=str)
def test_a_fault_of_both_runs_cancels_in_part(fault):
    """What is left of it is seen by the likelihood, in fewer calibrations of 100 simulations."""
    runs = {"second": {"second": fault}, "both": {"first": fault, "second": fault}}
    caught = {}
    for name, faults in runs.items():
        found = calibrated(CASE, 3200, batch=100, **faults)
        caught[name] = alarms(found.ranks, 100) / 32
        assert found.p["log-likelihood"] < 1e-6
    print(f"\n{fault}: caught in 100 simulations", caught)
    assert caught["both"] < caught["second"]


def test_another_prior_in_both_runs_is_not_seen_but_by_sbc():
    other = {"prior": 1.5}
    found = calibrated(CASE, 400, first=other, second=other)
    assert found.verdict(alpha=0.001).startswith("passes")
    asked = {"norm": SquaredNorm()}
    found = sbc(
        CASE.problem, CASE.drawer(1, **other), jax.random.key(0), 400, quantities=asked,
        progress=False,
    )  # fmt: skip
    assert found.verdict(alpha=0.001).startswith("fails")


def test_each_simulation_has_an_object_and_an_exposure_of_its_own():
    first = 100.0 * np.arange(40)[:, None] + np.zeros(SMALL.size)
    seen = []

    def drawer(key, posterior):
        jax.debug.callback(lambda y: seen.append(np.asarray(y)), posterior.y)
        return jnp.zeros((1, 1, SMALL.size))

    asked = {"first": lambda x, y: x[0]}
    run = {"quantities": asked, "batch": 15, "progress": False}
    posterior_sbc(SMALL.given, first, drawer, jax.random.key(0), 20, **run)
    jax.effects_barrier()
    recorded, second = np.moveaxis(np.array(seen), 1, 0)
    np.testing.assert_allclose(recorded, np.broadcast_to(SMALL.y, recorded.shape), rtol=1e-6)
    # Evenly chosen of 40; noise is far below the distance of objects.
    chosen = first[np.linspace(0, 39, 20).round().astype(int)] @ SMALL.matrix.T
    distance = np.abs(second[:, None] - chosen[None]).max(axis=2)
    nearest = np.argmin(distance, axis=1)
    assert distance.min(axis=1).max() < 6 * SMALL.noise
    assert set(nearest) == set(range(20))


@pytest.mark.slow
def test_mala_passes_at_the_recording_it_was_run_on():
    run = {"warmup": 200, "thin": 30, "progress": False}
    chains = ps.sample(
        SMALL.given, samplers.MALA(), jax.random.key(1), chains=50, draws=1, **run
    ).values[:, 0]
    found = posterior_sbc(
        SMALL.given, chains, samplers.MALA(), jax.random.key(0), 50, draws=100, quantities=ASKED,
        **run,
    )  # fmt: skip
    assert found.verdict(alpha=0.001).startswith("passes")


@pytest.mark.slow
def test_draws_that_forget_the_recordings_of_a_complex_object_are_caught():
    likelihood = models.IntensityLikelihood(models.Fourier((4,), 2), models.Poisson(100))
    problem = ps.Problem(likelihood, models.GaussianPrior(0.0, 0.1, (4,), complex))
    given = problem.condition(problem.simulate(jax.random.key(0))[1])

    def drawer(key, posterior):
        return jax.vmap(posterior.prior.sample)(jax.random.split(key, 200))[None]

    first = drawer(jax.random.key(1), given)[0]
    found = posterior_sbc(given, first, drawer, jax.random.key(0), progress=False)
    assert found.p["log-likelihood"] < 0.001


def test_first_draws_that_are_none_are_refused():
    first, run = SMALL.first(20), (SMALL.drawer(), jax.random.key(0))
    for wrong, message in (
        (first[:19], "19 first draws for 20 simulations"),
        (first[:, :7], r"first draws of shape \(20, 7\): give \(n, \*\(8,\)\)"),
        (first + 0j, "first draws are complex128, the object is float"),
        (first * np.nan, "first draws are not finite"),
        (first[:1].repeat(20, axis=0), "the 20 draws do not vary"),
    ):
        with pytest.raises(ValueError, match=message):
            posterior_sbc(SMALL.given, wrong, *run, 20)
    with pytest.raises(ValueError, match="posterior is a Problem: use problem.condition"):
        posterior_sbc(SMALL.problem, first, *run, 20)
    with pytest.raises(ValueError, match="19 simulations: give 20 or more"):
        posterior_sbc(SMALL.given, first, *run, 19)
