"""Geweke's joint test: its level on exact moves, planted faults, and chains that stand still."""

import blackjax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from faults import GaussianCase, MixtureCase

import posterior as ps
from posterior import samplers
from posterior.diagnostics import JointTest, default_quantities, geweke
from posterior.diagnostics.joint import _rank_sum
from posterior.samplers.base import langevin_step

CASE = GaussianCase(size=16, rows=12)
ALL = default_quantities(CASE.problem)
FEW = {name: ALL[name] for name in ("log-likelihood", "log-posterior", "squared norm")}
MANY = {"chains": 1000, "quantities": FEW}


class Exact(eqx.Module):
    """Draws of the Gaussian posterior that a believed noise and temperature would have."""

    gain: jax.Array
    root: jax.Array

    def __init__(self, case=CASE, noise=1.0, temperature=1.0):
        gain, covariance = case.posterior(noise * case.noise)
        self.gain = jnp.asarray(gain)
        self.root = jnp.asarray(np.sqrt(temperature) * np.linalg.cholesky(covariance))

    def __call__(self, key, posterior, x):
        return self.gain @ posterior.y + self.root @ jax.random.normal(key, x.shape)


class Langevin(eqx.Module):
    """Twenty steps; the noise is sqrt(2 step) times `noise`; `metropolis` 0 accepts all."""

    step: jax.Array
    noise: jax.Array
    metropolis: jax.Array

    def __init__(self, step=0.02, noise=1.0, metropolis=1.0):
        self.step, self.noise, self.metropolis = map(jnp.asarray, (step, noise, metropolis))

    def __call__(self, key, posterior, x):
        def backward(x, other, score):
            return -jnp.sum((other - x - self.step * score) ** 2) / (4 * self.step)

        def move(x, key):
            key_noise, key_accept = jax.random.split(key)
            log_prob, score = posterior.log_prob_and_score(x)
            other = langevin_step(key_noise, x, score, self.step, self.noise**2)
            log_prob_there, score_there = posterior.log_prob_and_score(other)
            ratio = log_prob_there - log_prob
            ratio += backward(other, x, score_there) - backward(x, other, score)
            accepted = jnp.log(jax.random.uniform(key_accept)) < self.metropolis * ratio
            return jnp.where(accepted, other, x), None

        return jax.lax.scan(move, x, jax.random.split(key, 20))[0]


def joint_test(kernel, key=0, problem=CASE.problem, **settings):
    return geweke(problem, kernel, jax.random.key(key), **settings)


def test_moves_that_leave_the_posterior_pass():
    found = joint_test(Exact())
    assert found.verdict(alpha=0.001).startswith(f"passes: {len(ALL) + 2} quantities in 400 chains")
    assert found.moved > 0.5 and np.all(found.kept < 0.5)
    assert joint_test(Langevin(), **MANY).verdict(alpha=0.001).startswith("passes")


@pytest.mark.parametrize(
    "kernel, said",
    [
        (Exact(noise=1.1), "too low"),
        (Exact(temperature=1.1), "too low"),
        (Langevin(noise=np.sqrt(0.5)), "too high"),
        (Langevin(0.005, np.sqrt(0.5), metropolis=0.0), "too high"),
        (Langevin(0.045, metropolis=0.0), "too low"),
    ],
    ids=["noise 10 % too high", "temperature", "no sqrt 2", "ULA without sqrt 2", "large step"],
)
def test_planted_faults_are_caught(kernel, said):
    verdict = joint_test(kernel, **MANY).verdict(alpha=0.001)
    assert verdict.startswith("fails: log-") and said in verdict


def test_moves_that_never_saw_the_recording_are_caught():
    """Recorded anew after the last of them, they would pass."""
    found = joint_test(lambda key, posterior, x: posterior.prior.sample(key), quantities=FEW)
    assert found.verdict(alpha=0.001).startswith("fails: log-likelihood")


@pytest.mark.parametrize("step, said", [(1e-12, "hardly moved"), (1e-4, "times as many")])
def test_chains_that_hardly_move_cannot_be_judged(step, said):
    found = joint_test(Langevin(step), **MANY)
    assert found.verdict().startswith("cannot be judged") and said in found.verdict()
    assert found.moved < 0.1


def test_a_sampler_runs_at_the_settings_it_has():
    found = joint_test(samplers.ULA(0.045), quantities=FEW, transitions=10)
    assert found.verdict(alpha=0.001).startswith("fails: log-likelihood")


@pytest.mark.slow
def test_samplers_pass_and_do_not_pass_where_they_stand_still():
    for sampler in (samplers.MALA(0.02, "none"), samplers.BlackJAX(blackjax.nuts, step_size=0.2)):
        assert joint_test(sampler, steps=20, **MANY).verdict(alpha=0.001).startswith("passes")
    still = joint_test(samplers.MALA(1e-6, "none"), quantities=FEW)
    assert still.verdict().startswith("cannot be judged") and still.moved < 0.01


def test_the_verdict_says_how_many_more_transitions():
    found = JointTest(("a", "b"), np.zeros(2), np.full(2, 0.5), np.array([0.8, 0.1]), 0.9, 400, 10)
    # A correlation that falls to 0.8 in 10 transitions is 0.5 in log 0.5 / log 0.8 = 3.1 times 10.
    assert found.verdict().startswith("cannot be judged: a keeps a correlation of 0.80")
    assert found.verdict().endswith("take at least 3.2 times as many, or longer moves")
    assert "the object keeps" in found._replace(moved=0.1).verdict()
    assert found._replace(z=np.array([0.0, 9.0])).verdict().startswith("fails: b")


def test_ranks_are_those_of_scipy_ties_included():
    rng = np.random.default_rng(0)
    for a, b in (rng.integers(0, 5, (2, 60)), rng.standard_normal((2, 60))):
        expected = scipy.stats.mannwhitneyu(a, b, use_continuity=False, method="asymptotic")
        z, above = _rank_sum(a.astype(float), b.astype(float))
        assert 2 * scipy.stats.norm.sf(abs(z)) == pytest.approx(expected.pvalue, rel=1e-9)
        assert above == pytest.approx(expected.statistic / 60**2)
    assert _rank_sum(np.ones(30), np.ones(30)) == (0.0, 0.5)


def test_results_depend_on_the_key_and_not_on_the_batch():
    settings = {"chains": 20, "transitions": 1, "quantities": {"first": lambda x, y: x[0]}}
    first, other = joint_test(Exact(), **settings), joint_test(Exact(), key=1, **settings)
    batched = joint_test(Exact(), batch=5, **settings)
    np.testing.assert_allclose(batched.z, first.z, rtol=1e-6)
    assert first.z[0] != other.z[0]


@pytest.mark.slow
def test_exact_moves_fail_at_the_nominal_rate():
    """Of 400 tests at 5 %, 10 to 31 fail with probability 99 %; corrected for 15, no more."""
    found = [joint_test(Exact(), key, chains=100, transitions=5) for key in range(400)]
    false_alarms = sum(test.verdict().startswith("fails") for test in found)
    raw = 2 * scipy.stats.norm.sf(np.abs([test.z for test in found]))
    rates = dict(zip(found[0].names, np.sum(raw < 0.05, axis=0).tolist()))
    print(f"\n{false_alarms} of 400 fail; each quantity alone: {rates}")
    low, high = scipy.stats.binom(400, 0.05).interval(0.99)
    assert false_alarms <= high
    # Each of the 15 within the interval that holds all of them.
    low, high = scipy.stats.binom(400, 0.05).interval(1 - 0.01 / len(rates))
    assert all(low <= count <= high for count in rates.values())


def white(i):
    """The i-th of the object's components that are independent and standard normal a priori."""
    row = jnp.asarray(np.linalg.inv(np.linalg.cholesky(CASE.prior))[i])
    return lambda x, y: row @ x


@pytest.mark.slow
def test_the_verdict_on_independent_quantities_fails_at_the_nominal_rate():
    """Holm's correction is then exact but for 0.1 %: neither more nor fewer than 5 % fail."""
    asked = {f"component {i}": white(i) for i in range(8)}
    found = [
        joint_test(Exact(), key, chains=100, transitions=5, quantities=asked) for key in range(400)
    ]
    false_alarms = sum(test.verdict().startswith("fails") for test in found)
    print(f"\n{false_alarms} of 400 fail")
    least, most = scipy.stats.binom(400, 1 - (1 - 0.05 / 8) ** 8).interval(0.99)
    assert least <= false_alarms <= most


MIXTURE = MixtureCase()


def in_one_mode(key, posterior, x):
    return MIXTURE.drawer(lost=True)(key, posterior)[0, 0].astype(x.dtype)


def of_the_prior(key, posterior, x):
    return posterior.prior.sample(key)


POWER = {
    "noise level 10 % too high": (CASE.problem, Exact(noise=1.1)),
    "temperature 10 % too high": (CASE.problem, Exact(temperature=1.1)),
    "MALA without sqrt 2": (CASE.problem, Langevin(noise=np.sqrt(0.5))),
    "ULA without sqrt 2": (CASE.problem, Langevin(0.005, np.sqrt(0.5), metropolis=0.0)),
    "ULA with a large step": (CASE.problem, Langevin(0.045, metropolis=0.0)),
    "the prior": (CASE.problem, of_the_prior),
    "a lost mode": (MIXTURE.problem, in_one_mode),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", POWER)
def test_each_fault_is_caught_in_95_of_100_repetitions(fault):
    """Of 40, at 5 % over all quantities; the number of chains is printed."""
    problem, kernel = POWER[fault]
    asked = default_quantities(problem)
    for chains in (50, 100, 200, 400, 800):
        found = [
            joint_test(kernel, key, problem, chains=chains, quantities=asked) for key in range(40)
        ]
        caught = np.mean([test.verdict().startswith("fails") for test in found])
        print(f"\n{fault}: caught in {100 * caught:.0f} % of repetitions at {chains} chains")
        if caught >= 0.95:
            return
    pytest.fail(f"{fault} is caught in {100 * caught:.0f} % only")


@pytest.mark.slow
def test_a_lost_mode_is_caught():
    case = MixtureCase()
    for lost, said in ((False, "passes"), (True, "fails")):
        draw = case.drawer(lost)
        found = joint_test(
            lambda key, posterior, x, draw=draw: draw(key, posterior)[0, 0].astype(x.dtype),
            problem=case.problem,
        )
        assert found.verdict(alpha=0.001).startswith(said)


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"chains": 19}, "chains 19: give a whole number, 20 or more"),
        ({"transitions": 0}, "transitions 0"),
        ({"steps": 1.5}, "steps 1.5"),
        ({"quantities": {}}, "no quantities"),
        ({"quantities": {"all": lambda x, y: x}}, "all is no real number"),
        ({"quantities": {"root": lambda x, y: jnp.sqrt(x[0])}}, "root of an exact pair is NaN"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        joint_test(Exact(), **{"chains": 20, "transitions": 1, **settings})


def test_what_is_no_move_of_one_object_is_refused():
    settings = {"chains": 20, "transitions": 1, "quantities": {"first": lambda x, y: x[0]}}
    with pytest.raises(ValueError, match="Ensemble moves a population"):
        joint_test(samplers.Ensemble(walkers=32), **settings)
    with pytest.raises(ValueError, match="the kernel gives float32 .4,.: give an object"):
        joint_test(lambda key, posterior, x: x[:4], **settings)
    with pytest.raises(ValueError, match="the kernel gives a tuple: give an object"):
        joint_test(lambda key, posterior, x: (x, x), **settings)
    for wrong, message in (("mala", "'mala' is a str"), (samplers.MALA, "the class MALA: give")):
        with pytest.raises(ValueError, match=message):
            joint_test(wrong, **settings)
    with pytest.raises(ps.sampling.NonFiniteError, match="first is NaN in 20 of 20 chains"):
        joint_test(lambda key, posterior, x: x * jnp.nan, **settings)
