"""Samplers against closed forms: every mean and covariance within Monte-Carlo error."""

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from known import batch_error, check_mean, check_moments, linear_gaussian, real_view
from posterior import diagnostics, models, samplers
from posterior.diagnostics import spread_over_error
from posterior.diagnostics.regions import block_means
from posterior.samplers.base import langevin_step
from posterior.samplers.ula import ULAState


def draw(post, sampler, key=1, **settings):
    return ps.sample(post, sampler, jax.random.key(key), progress=False, **settings).values


class HotPosterior(ps.Posterior):
    """A posterior at a temperature of 1.1: for samplers that are wrong by 10 %."""

    def log_prob_and_score(self, x):
        value, score = super().log_prob_and_score(x)
        return value / 1.1, score / 1.1


class HalfNoiseULA(samplers.ULA):
    """Deliberately broken: the noise lacks its sqrt(2)."""

    def step(self, key, state: ULAState):
        score = state.posterior.score(state.position)
        step = jnp.asarray(self.step_size, score.real.dtype)
        position = langevin_step(key, state.position, score, step, temperature=0.5)
        _, info = super().step(key, state)
        return state._replace(position=position), info


@pytest.mark.parametrize("dtype", [float, complex])
def test_mala_draws_a_linear_gaussian_posterior(x64, dtype):
    post, mean, covariance = linear_gaussian(16, 12, dtype)
    values = draw(post, samplers.MALA(), draws=4000, thin=10)
    check_moments(values, mean, covariance)
    assert np.max(diagnostics.rhat(real_view(values))) < 1.02


def test_a_temperature_10_percent_wrong_fails(x64):
    post, mean, covariance = linear_gaussian(16, 12, float)
    hot = HotPosterior(post.likelihood, post.prior, post.y)
    values = draw(hot, samplers.MALA(), draws=4000, thin=10)
    with pytest.raises(AssertionError):
        check_moments(values, mean, covariance)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize(
    "sampler, settings",
    [
        (samplers.MALA(), {"draws": 5000, "thin": 40}),
        (samplers.BlackJAX(blackjax.nuts), {"draws": 5000}),
        (samplers.TemperedSMC(moves=20), {"draws": 1000, "chains": 8}),
    ],
    ids=["mala", "nuts", "smc"],
)
def test_the_linear_gaussian_posterior_of_64_by_48(x64, sampler, settings, dtype):
    post, mean, covariance = linear_gaussian(64, 48, dtype)
    check_moments(draw(post, sampler, **settings), mean, covariance)


@pytest.mark.parametrize(
    "sampler, settings",
    [
        (samplers.BlackJAX(blackjax.nuts), {"draws": 2000}),
        # The score of a Gaussian is linear: one node is exact.
        (samplers.MALA(nodes=1), {"draws": 2000, "thin": 10}),
        (samplers.TemperedSMC(), {"draws": 2000}),
        # Twenty-five batches of two walkers each, so that no two share one.
        (samplers.Ensemble(walkers=50), {"draws": 50 * 1000, "chains": 4}),
    ],
    ids=["nuts", "mala by line integral", "smc", "emcee"],
)
def test_samplers_draw_a_small_linear_gaussian_posterior(x64, sampler, settings):
    post, mean, covariance = linear_gaussian(2, 2, complex)
    check_moments(draw(post, sampler, **settings), mean, covariance)


def one_dimension(sampler, variance=0.04):
    """E[(x - mean)^2] of a Gaussian posterior of this variance, and its Monte-Carlo error."""
    sd = float(np.sqrt(2 * variance))
    prior = models.GaussianPrior(0.3, 2 * variance, (1,))
    likelihood = models.LinearLikelihood(models.Identity((1,)), models.Gaussian(sd))
    post = ps.Problem(likelihood, prior).condition(np.array([0.3]))
    square = (draw(post, sampler, draws=20_000, chains=8) - 0.3) ** 2
    return square.mean(), float(batch_error(square)[0])


@pytest.mark.parametrize("fraction", [0.2, 1.0])
def test_ula_has_its_closed_form_bias(x64, fraction):
    variance = 0.04
    step = fraction * variance
    found, error = one_dimension(samplers.ULA(step))
    assert abs(found - variance / (1 - step / (2 * variance))) < 4 * error
    assert abs(found - variance) > 4 * error


def test_ula_without_its_root_two_fails(x64):
    found, error = one_dimension(HalfNoiseULA(0.2 * 0.04))
    assert abs(found - 0.04 / (1 - 0.1)) > 4 * error


def gamma_poisson(concentration=3.0, rate=20.0, size=100, full_well=50):
    """Independent pixels with a gamma prior: the posterior is gamma, with these parameters."""
    prior = models.PixelPrior.gamma(concentration, rate, (size,))
    likelihood = models.LinearLikelihood(models.Identity((size,)), models.Poisson(full_well))
    problem = ps.Problem(likelihood, prior)
    _, y = problem.simulate(jax.random.key(3))
    counts = np.asarray(y) * full_well
    assert counts.max() < full_well, "a saturated pixel has no conjugate posterior"
    return problem.condition(y), concentration + counts, rate + full_well


def check_gamma(values, concentration, rate):
    check_mean(values, concentration / rate)
    check_mean((values - concentration / rate) ** 2, concentration / rate**2)


PIXELWISE = samplers.MALA(preconditioner="diagonal")


def test_mala_draws_the_conjugate_gamma_posterior(x64):
    post, concentration, rate = gamma_poisson()
    check_gamma(draw(post, PIXELWISE, draws=2000, thin=10), concentration, rate)


@pytest.mark.slow
def test_a_noise_level_10_percent_wrong_fails_the_conjugate_posterior(x64):
    """sigma_0 = 1/sqrt(full well) 10 % too small: 61 electrons in place of 50."""
    post, concentration, rate = gamma_poisson()
    counts = np.asarray(post.y) * 50
    wrong = models.LinearLikelihood(models.Identity(post.shape), models.Poisson(61))
    post = ps.Problem(wrong, post.prior).condition(np.round(counts * 61 / 50) / 61)
    with pytest.raises(AssertionError):
        check_gamma(draw(post, PIXELWISE, draws=2000, thin=10), concentration, rate)


@pytest.mark.slow
@pytest.mark.parametrize("mean, sd", [(0.06, 0.02), (0.3, 0.06)])
def test_annealed_langevin_is_calibrated_on_a_field_of_few_photons(mean, sd):
    """Truths of the prior itself, 64x64 pixels of 1.5 and of 7.5 electrons, 60 levels of 4 steps.

    Spread over error of pixels and of means over 8x8 blocks is 1 for an exact sampler. Errors of
    1536 blocks, which hardly depend on each other, give the ratio an error of 2 %.
    """
    rows, columns = np.meshgrid(np.fft.fftfreq(64), np.fft.fftfreq(64), indexing="ij")
    power = (np.hypot(rows, columns) + 0.02) ** -3
    prior = models.GaussianField(power * sd**2 / power.mean(), mean)
    likelihood = models.LinearLikelihood(models.Identity((64, 64)), models.Poisson(25))
    problem = ps.Problem(likelihood, prior)
    truths = jnp.abs(jax.vmap(prior.sample)(jax.random.split(jax.random.key(0), 24)))
    sampler, found = samplers.AnnealedLangevin(levels=60, steps=4), []
    for i, truth in enumerate(truths):
        y = likelihood.simulate(jax.random.key(i), truth)
        found.append(draw(problem.condition(y), sampler, key=100 + i, chains=16, draws=1)[:, 0])
    draws, truths = np.stack(found), np.asarray(truths)

    for name, f in (("pixels", np.asarray), ("blocks", block_means)):
        ratio = spread_over_error(f(draws), f(truths))
        print(f"few photons, mean {mean}: spread over error of {name} {ratio:.3f}")
        assert abs(ratio - 1) < 0.08


def test_annealed_langevin_by_the_signal_dependent_error_on_few_photons(x64):
    """Seven photons a pixel: in the dark steps must not overshoot, nor the score be a Gaussian's.

    Every pixel by itself, to Monte-Carlo error and what 60 levels of 4 steps leave.
    """
    post, concentration, rate = gamma_poisson(3.0, 20.0, 8, 50)
    sampler = samplers.AnnealedLangevin(levels=60, steps=4)
    values = draw(post, sampler, chains=250, draws=1)[:, 0]
    mean, sd = concentration / rate, np.sqrt(concentration) / rate
    off = (values.mean(axis=0) - mean) / sd
    assert np.abs(off).max() < 4.5 / np.sqrt(250)
    assert abs(off.mean()) < 0.05
    assert abs(np.mean(values.std(axis=0) / sd) - 1) < 0.05


@pytest.mark.parametrize("path", ["convolved", "split"])
def test_a_pixel_that_noise_throws_to_zero_comes_back_and_no_further(path):
    """In float32, where the pull from zero overflows: under "split" it grows like 1/x^2."""
    post, _, _ = gamma_poisson(30.0, 60.0, 6, 200)
    dark = jnp.array([0.0, 1e-30, 1e-18, 1e-12, 1e-6, 1e-3], jnp.float32)
    sampler = samplers.AnnealedLangevin(levels=100, steps=5, path=path)
    state = sampler.init(jax.random.key(0), post, dark)._replace(index=jnp.asarray(250))
    keys = jax.random.split(jax.random.key(1), 200)
    moved = jax.jit(jax.vmap(lambda key: sampler.step(key, state)[0].position))(keys)
    assert np.all(np.isfinite(moved))
    assert moved.max() < 2 * post.y.max(), moved.max()


@pytest.mark.slow
@pytest.mark.parametrize("path", ["convolved", "split"])
def test_annealed_langevin_on_counts_by_the_signal_dependent_error(x64, path):
    """The paper's relaxation of real images (eq:gradient_poisson), on the conjugate posterior.

    It models counts as Gaussian: at 75 to 200 electrons a pixel its mean is off by less than
    0.05 sd and its sd by less than 5 % of the exact posterior's, averaged over the pixels.
    """
    post, concentration, rate = gamma_poisson(30.0, 60.0, 16, 200)
    sampler = samplers.AnnealedLangevin(levels=100, steps=5, path=path)
    values = draw(post, sampler, chains=250, draws=1)
    mean, sd = concentration / rate, np.sqrt(concentration) / rate
    assert abs(np.mean((values.mean((0, 1)) - mean) / sd)) < 0.05
    assert abs(np.mean(values.std((0, 1)) / sd) - 1) < 0.05
    assert values.min() > 0


@pytest.mark.parametrize(
    "preconditioner", ["fourier", pytest.param("auto", marks=pytest.mark.slow)]
)
def test_mala_draws_the_wiener_posterior_of_a_field(preconditioner):
    """GaussianField and Gaussian noise at 64x64, in float32, against the exact Wiener posterior."""
    rows, columns = np.meshgrid(np.fft.fftfreq(64), np.fft.fftfreq(64), indexing="ij")
    power = 1e-3 / (0.05 + np.hypot(rows, columns)) ** 2
    prior = models.GaussianField(power, 0.5)
    noise = 0.1
    likelihood = models.LinearLikelihood(models.Identity((64, 64)), models.Gaussian(noise))
    problem = ps.Problem(likelihood, prior)
    _, y = problem.simulate(jax.random.key(0))
    values = draw(
        problem.condition(y), samplers.MALA(preconditioner=preconditioner), draws=1000, thin=5
    )
    spectrum = power / (power + noise**2)
    mean = 0.5 + np.fft.ifft2(spectrum * np.fft.fft2(np.asarray(y) - 0.5)).real
    check_mean(values, mean)
    # A posterior coefficient has variance spectrum noise^2; each is a mean over 4 chains.
    deviation = np.fft.fft2(values - mean, norm="ortho")
    check_mean(np.abs(deviation) ** 2, spectrum * noise**2)
