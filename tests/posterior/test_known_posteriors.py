"""Samplers against closed forms: every mean and covariance within Monte-Carlo error."""

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
import posterior as ps
import pytest
from known import linear_gaussian, moment_z, real_view
from posterior import diagnostics, models, samplers
from posterior.samplers.base import langevin_step

# The largest of m normal deviates exceeds this bound once in 10^4 repetitions, or less.
MEAN_BOUND = 4.5


def largest_normal(count):
    """A bound on the largest of `count` standard normal deviates, once in 2000 runs above it."""
    return float(-jax.scipy.stats.norm.ppf(0.0005 / (2 * count)))


def check_moments(values, mean, covariance):
    z_mean, z_covariance = moment_z(values, mean, covariance)
    n = len(mean)
    assert z_mean < largest_normal(n)
    assert z_covariance < largest_normal(n * (n + 1) // 2)


class HotMALA(samplers.MALA):
    """Deliberately broken: draws at a temperature of 1.1."""

    def step(self, key, state):
        hot = Hot(state.posterior)
        state, info = super().step(key, state._replace(posterior=hot))
        return state._replace(posterior=hot.cold), info


class Hot:
    """A posterior whose log-density is divided by 1.1."""

    def __init__(self, cold):
        self.cold = cold

    def log_prob_and_score(self, x):
        value, score = self.cold.log_prob_and_score(x)
        return value / 1.1, score / 1.1


class HalfNoiseULA(samplers.ULA):
    """Deliberately broken: the noise lacks its sqrt(2)."""

    def step(self, key, state):
        score = state.posterior.score(state.position)
        step = jnp.asarray(self.step_size, score.real.dtype)
        position = langevin_step(key, state.position, score, step, temperature=0.5)
        return super().step(key, state)[0]._replace(position=position), super().step(key, state)[1]


@pytest.mark.parametrize("dtype", [float, complex])
def test_mala_draws_the_linear_gaussian_posterior(x64, dtype):
    post, mean, covariance = linear_gaussian(64 if dtype is float else 24, 48 if dtype is float else 18, dtype)
    draws = ps.sample(post, samplers.MALA(), jax.random.key(1), draws=4000, thin=10, progress=False)
    check_moments(draws.values, mean, covariance)
    assert np.max(diagnostics.rhat(real_view(draws.values))) < 1.02


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize(
    "sampler, settings",
    [
        (samplers.MALA(), {"draws": 8000, "thin": 40}),
        (samplers.BlackJAX(blackjax.nuts), {"draws": 8000}),
        (samplers.TemperedSMC(moves=20), {"draws": 4000, "chains": 8}),
    ],
    ids=["mala", "nuts", "smc"],
)
def test_the_linear_gaussian_posterior_of_64_by_48(x64, sampler, settings, dtype):
    post, mean, covariance = linear_gaussian(64, 48, dtype)
    draws = ps.sample(post, sampler, jax.random.key(2), progress=False, **settings)
    check_moments(draws.values, mean, covariance)


@pytest.mark.parametrize(
    "sampler, settings",
    [
        (samplers.BlackJAX(blackjax.nuts), {"draws": 2000}),
        (samplers.TemperedSMC(), {"draws": 2000}),
        (samplers.Ensemble(), {"draws": 32 * 4000, "chains": 4}),
    ],
    ids=["nuts", "smc", "emcee"],
)
def test_samplers_draw_a_small_linear_gaussian_posterior(x64, sampler, settings):
    post, mean, covariance = linear_gaussian(2, 2, complex)
    draws = ps.sample(post, sampler, jax.random.key(2), progress=False, **settings)
    check_moments(draws.values, mean, covariance)


def test_a_temperature_10_percent_wrong_fails(x64):
    post, mean, covariance = linear_gaussian(64, 48, float)
    draws = ps.sample(post, HotMALA(), jax.random.key(1), draws=4000, thin=10, progress=False)
    with pytest.raises(AssertionError):
        check_moments(draws.values, mean, covariance)


def one_dimension(variance, sampler, draws=20_000):
    prior = models.GaussianPrior(0.3, 2 * variance, (1,))
    likelihood = models.LinearLikelihood(models.Identity((1,)), models.Gaussian(np.sqrt(2 * variance)))
    post = ps.Problem(likelihood, prior).condition(np.array([0.3]))
    values = ps.sample(
        post, sampler, jax.random.key(0), draws=draws, chains=8, progress=False
    ).values - 0.3
    square = values**2
    return square.mean(), diagnostics.mcse(square)[0]


@pytest.mark.parametrize("fraction", [0.2, 1.0])
def test_ula_has_its_closed_form_bias(x64, fraction):
    variance = 0.04
    step = fraction * variance
    found, error = one_dimension(variance, samplers.ULA(step))
    expected = variance / (1 - step / (2 * variance))
    assert abs(found - expected) < 4 * error
    assert abs(found - variance) > 4 * error


def test_ula_without_its_root_two_fails(x64):
    variance = 0.04
    found, error = one_dimension(variance, HalfNoiseULA(0.2 * variance))
    assert abs(found - variance / (1 - 0.1)) > 4 * error


def gamma_poisson(concentration=3.0, rate=20.0, size=400, full_well=50):
    prior = models.PixelPrior.gamma(concentration, rate, (size,))
    likelihood = models.LinearLikelihood(models.Identity((size,)), models.Poisson(full_well))
    problem = ps.Problem(likelihood, prior)
    x, y = problem.simulate(jax.random.key(3))
    counts = np.asarray(y) * full_well
    return problem.condition(y), concentration + counts, rate + full_well


def test_mala_draws_the_conjugate_gamma_posterior(x64):
    post, concentration, rate = gamma_poisson()
    draws = ps.sample(
        post, samplers.MALA(preconditioner="diagonal"), jax.random.key(0), draws=2000, thin=10, progress=False
    ).values
    mean, variance = concentration / rate, concentration / rate**2
    z = (draws.mean((0, 1)) - mean) / diagnostics.mcse(draws)
    assert np.abs(z).max() < largest_normal(len(mean))
    squares = (draws - mean) ** 2
    z = (squares.mean((0, 1)) - variance) / diagnostics.mcse(squares)
    assert np.abs(z).max() < largest_normal(len(mean))


def test_a_full_well_10_percent_wrong_fails_the_conjugate_posterior(x64):
    post, concentration, rate = gamma_poisson()
    wrong = models.LinearLikelihood(models.Identity((400,)), models.Poisson(55))
    y = np.asarray(post.y) * 50 / 55
    draws = ps.sample(
        ps.Problem(wrong, post.prior).condition(y),
        samplers.MALA(preconditioner="diagonal"),
        jax.random.key(0),
        draws=2000,
        thin=10,
        progress=False,
    ).values
    z = (draws.mean((0, 1)) - concentration / rate) / diagnostics.mcse(draws)
    assert np.abs(z).max() > largest_normal(400)


def test_annealed_langevin_on_counts_by_the_signal_dependent_error(x64):
    """The paper's real-image relaxation (eq:gradient_poisson), on the conjugate posterior.

    It models the counts as Gaussian and is reflected at zero; at 30 counts a pixel and more the
    mean is within 2 % of a posterior sd-free bias that the counts' skewness explains.
    """
    post, concentration, rate = gamma_poisson(30.0, 40.0, 100, 200)
    sampler = samplers.AnnealedLangevin(levels=100, steps=10)
    draws = ps.sample(post, sampler, jax.random.key(0), chains=400, draws=1, progress=False).values
    mean, sd = concentration / rate, np.sqrt(concentration) / rate
    bias = (draws.mean((0, 1)) - mean) / sd
    ratio = draws.std((0, 1)) / sd
    assert abs(bias.mean()) < 0.05
    assert abs(ratio.mean() - 1) < 0.05
