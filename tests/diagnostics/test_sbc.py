"""Simulation-based calibration: passes exact samplers at its level, catches what is planted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from faults import GaussianCase, MixtureCase
from matplotlib.figure import Figure

import posterior as ps
from posterior import samplers
from posterior.diagnostics import Calibration, plot_ranks, sbc
from posterior.diagnostics.quantities import LogPrior, SquaredNorm
from posterior.models.gallery import gamma_poisson

CASE = GaussianCase()
EXACT = CASE.drawer()
DENSITY = {
    "log-posterior": lambda x, y: (
        CASE.problem.likelihood.log_prob(x, y) + CASE.problem.prior.log_prob(x)
    )
}
# The rest of them, and the smallest number of simulations, are in test_power.py.
FAULTS = {
    "temperature 10 % too high": (CASE.drawer(temperature=1.1), 400),
    "another recording": (CASE.of_other_data, 100),
}


def calibrated(case, sampler, simulations=100, key=0, **settings):
    return sbc(case.problem, sampler, jax.random.key(key), simulations, progress=False, **settings)


@pytest.mark.parametrize(
    "case", [CASE, pytest.param(MixtureCase(), marks=pytest.mark.slow)], ids=["gaussian", "mixture"]
)
def test_exact_draws_pass(case):
    found = calibrated(case, EXACT if case is CASE else case.drawer(), 200)
    assert found.verdict(alpha=0.001).startswith("passes")
    for level in (0.5, 0.8, 0.95):
        shares, errors = np.array(list(found.coverage(level).values())).T
        assert np.all(np.abs(shares - level) < 4 * errors)
        share, error = found.hpd_coverage(level)
        assert abs(share - level) < 4 * error


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_caught(fault):
    drawer, simulations = FAULTS[fault]
    assert calibrated(CASE, drawer, simulations).verdict(alpha=0.001).startswith("fails")


def test_a_lost_mode_is_caught():
    found = calibrated(MixtureCase(), MixtureCase().drawer(lost=True), 200)
    assert found.p["mean [4:8]"] < 1e-6 and found.p["mean [0:4]"] > 0.001


def test_a_draw_without_density_fails_whatever_its_rank():
    """Of fifty exact draws of positive pixels one is below zero: no rank moves by more than 2 %."""
    known = gamma_poisson(4)
    problem = ps.Problem(known.likelihood, known.prior)

    def sometimes_below(key, posterior):
        draws = known.exact(key, posterior.y, 50)[None]
        return draws.at[0, 7, 2].multiply(-1.0)

    asked = {"log-prior": LogPrior(known.prior), "norm": SquaredNorm()}
    found = sbc(problem, sometimes_below, jax.random.key(1), 40, quantities=asked, progress=False)
    assert found.verdict() == "fails: draws of density 0 in 40 of 40 simulations"
    assert found._replace(impossible=0).verdict(0.001).startswith("passes")


def test_the_verdict_says_what_is_wrong():
    narrow = {"first": lambda x, y: x[0]}
    found = calibrated(CASE, CASE.drawer(temperature=0.5), 400, quantities=narrow)
    assert "fails: first" in found.verdict() and "too narrow" in found.verdict()
    found = calibrated(CASE, CASE.drawer(temperature=2.0), 400, quantities=narrow)
    assert "too wide" in found.verdict()
    found = calibrated(
        CASE, lambda key, p: CASE.drawer()(key, p) + 0.3, quantities=narrow, simulations=200
    )
    assert "too high" in found.verdict()


def test_a_reference_without_the_data_is_blind_to_the_prior():
    """TARP with a fixed reference passes the prior for the posterior (Lemos et al. 2023)."""
    fixed = {"distance to 1": lambda x, y: jnp.sum((x - 1) ** 2)}
    blind = calibrated(CASE, CASE.of_the_prior, 200, quantities=fixed)
    assert blind.verdict(alpha=0.001).startswith("passes")
    seen = calibrated(CASE, CASE.of_the_prior, 200)
    assert seen.p["distance to estimate"] < 1e-6


def test_mala_passes_and_chains_that_hardly_move_are_not_judged():
    problem = GaussianCase(size=8, rows=6)
    run = {"draws": 60, "warmup": 200}
    found = calibrated(problem, samplers.MALA(), 100, thin=10, **run)
    assert found.verdict(alpha=0.001).startswith("passes")
    assert np.all(found.effective >= 5)
    slow = calibrated(problem, samplers.MALA(1e-5, "none"), 20, draws=60, warmup=0)
    assert slow.verdict().startswith("cannot be judged")


def test_a_slow_quantity_does_not_hide_one_that_fails():
    ranks = np.stack([np.full(50, 0.999), np.linspace(0.01, 0.99, 50)], axis=1)
    found = Calibration(("wrong", "slow"), ranks, np.array([100.0, 3.0]))
    assert found.verdict().startswith("fails: wrong")
    found = Calibration(("right", "slow"), ranks[:, ::-1], np.array([100.0, 3.0]))
    assert found.verdict().startswith("cannot be judged: 3 independent draws of slow")
    assert "at least 1.7 times" in found.verdict()
    found = Calibration(("slow",), ranks[:, :1], np.array([3.0]))
    assert found.verdict().startswith("cannot be judged")


def test_coverage_follows_the_ranks():
    ranks = (np.arange(100) + 0.5)[:, None] / 100
    shares = Calibration(("f",), ranks, np.array([50.0])).coverage(0.8)
    assert shares == {"f": (pytest.approx(0.8), pytest.approx(0.04))}
    with pytest.raises(ValueError, match="level 0"):
        Calibration(("f",), ranks, np.array([50.0])).coverage(0)


@pytest.mark.slow
@pytest.mark.parametrize("temperature, sign", [(0.8, -1), (1.25, 1)])
def test_regions_of_draws_too_narrow_hold_too_few_truths(temperature, sign):
    """By the chi-square law of the density of a Gaussian with that temperature, 50 draws of it."""
    drawer = CASE.drawer(temperature=temperature)
    share, error = calibrated(CASE, drawer, 400, quantities=DENSITY).hpd_coverage(0.8)
    # Of 64 degrees of freedom: the truth's squared radius, in units of the draws'.
    radius = scipy.stats.chi2(CASE.size)
    expected = radius.cdf(temperature * radius.ppf(0.8))
    # Of a limit that 50 draws set: its own spread moves the share by its curvature, not more.
    assert abs(share - expected) < 4 * error + 0.02
    assert sign * (share - 0.8) > 6 * error


def test_the_region_is_one_sided_in_the_log_posterior():
    ranks = np.stack([np.linspace(0.005, 0.995, 100), np.full(100, 0.35)], axis=1)
    found = Calibration(("norm", "log-posterior"), ranks, np.array([50.0, 50.0]))
    assert found.hpd_coverage(0.7) == (1.0, pytest.approx(np.sqrt(0.21 / 100)))
    assert found.hpd_coverage(0.6)[0] == 0.0
    with pytest.raises(ValueError, match="level 1: it must lie between 0 and 1"):
        found.hpd_coverage(1)
    with pytest.raises(ValueError, match="no log-posterior among the quantities"):
        found._replace(names=("norm", "other")).hpd_coverage(0.5)


def test_quantities_of_too_few_draws_have_no_say():
    ranks = np.stack([np.full(50, 0.999), np.linspace(0.01, 0.99, 50)], axis=1)
    found = Calibration(("slow", "right"), ranks, np.array([3.0, 100.0]))
    assert list(found.judged_p) == ["right"] and found.judged_p["right"] > 0.5
    assert found.p["slow"] < 1e-6
    labels = {t.get_text() for t in plot_ranks(found).get_legend().get_texts()}
    assert labels == {"slow, too few draws", f"right, p = {found.judged_p['right']:.2g}"}


def test_what_can_rank_nothing_is_refused():
    small, asked = GaussianCase(2, 2), {"f": lambda x, y: 0 * x[0]}
    with pytest.raises(ValueError, match="in all 20 simulations every draw is as its object in f:"):
        calibrated(small, lambda key, p: jnp.zeros((1, 1, 2)), 20, quantities=asked)
    with pytest.raises(ValueError, match="problem is a Posterior: give a Problem"):
        sbc(small.problem.condition(np.zeros(2)), EXACT, jax.random.key(0), 20)


def test_same_key_same_ranks():
    first, again, other = (calibrated(CASE, EXACT, 20, key=key) for key in (0, 0, 1))
    np.testing.assert_array_equal(first.ranks, again.ranks)
    assert np.all(first.ranks != other.ranks)


def test_too_few_simulations_and_draws_are_refused():
    with pytest.raises(ValueError, match="7 draws a chain: give 8 or more"):
        calibrated(CASE, samplers.MALA(), 20, draws=7)
    with pytest.raises(ValueError, match="give 20 or more"):
        calibrated(CASE, EXACT, 19)


def test_the_picture_has_a_line_for_each_quantity():
    found = calibrated(CASE, CASE.drawer(temperature=1.1), 100)
    axes = Figure().add_subplot()
    assert plot_ranks(found, axes) is axes
    assert len(axes.lines) == len(found.names) + 1
    assert plot_ranks(found).get_xlabel() == "rank of the truth among the draws"
