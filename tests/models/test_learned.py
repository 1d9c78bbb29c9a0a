"""Learned priors: with an exact network in place they must be the analytic prior, exactly."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from analytic import wiener

import posterior as ps
from networks import network_denoiser
from posterior import models
from posterior.diagnostics import psnr
from posterior.models import priors
from posterior.models.priors import EnergyPrior, ScorePrior
from posterior.models.priors.conservative import line_integral, loop_check, require_gradient
from posterior.models.priors.denoiser import Denoiser, Statistics
from posterior.models.priors.losses import signal_score_loss
from posterior.models.priors.perturbation import (
    folded_energy,
    folded_score,
    perturbed,
    score_from_denoised,
)
from posterior.models.priors.pictures import Pictures
from posterior.models.priors.training import Recipe, patch_loss
from posterior.models.realview import to_real
from posterior.samplers.checks import check_gaussian

KINDS = {"score": ScorePrior, "energy": EnergyPrior}
SHAPE = (4, 6)


def learned(kind, dtype):
    return KINDS[kind](wiener(kind, dtype is complex), SHAPE)


def analytic(dtype):
    return priors.Gaussian(0.3, 0.25**2, SHAPE, dtype)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("sigma", [0.01, 0.3, 5.0])
def test_score_is_that_of_the_prior_the_network_was_made_for(x64, kind, dtype, sigma):
    """Fixes the perturbation: sigma for real objects, sigma/2 in Re and in Im for complex ones."""
    prior, exact = learned(kind, dtype), analytic(dtype)
    x = exact.sample(jax.random.key(0))
    expected = exact.score(x, sigma)
    assert prior.dtype == expected.dtype
    np.testing.assert_allclose(prior.score(x, sigma), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(prior.scale, exact.scale)


@pytest.mark.parametrize("dtype", [float, complex])
def test_energy_is_the_log_density_up_to_a_constant(x64, dtype):
    prior, exact = learned("energy", dtype), analytic(dtype)
    x = jax.vmap(exact.sample)(jax.random.split(jax.random.key(0), 5))
    found = jax.vmap(lambda x: prior.log_prob(x, 0.2))(x)
    expected = jax.vmap(lambda x: exact.log_prob(x, 0.2))(x)
    np.testing.assert_allclose(found - found[0], expected - expected[0], rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [float, complex])
def test_denoising_is_the_mean_given_the_noisy_object(x64, kind, dtype):
    x = analytic(dtype).sample(jax.random.key(1))
    mean, variance = 0.3 * (1 + 1j) if dtype is complex else 0.3, 0.2**2
    variance = variance / 4 if dtype is complex else variance
    expected = mean + 0.25**2 / (0.25**2 + variance) * (x - mean)
    np.testing.assert_allclose(learned(kind, dtype).denoise(x, 0.2), expected, rtol=1e-9)


def test_data_in_other_units_than_the_prior_are_refused(x64):
    """A picture of 0..255 is; one of 0..1 is not, however noisy, nor one through gain."""
    prior = learned("score", float)
    picture = np.abs(np.asarray(analytic(float).sample(jax.random.key(0))))
    for gain, scale, sigma, refused in (
        (1, 1, 0.1, False),
        (1, 1, 30.0, False),
        (1, 255, 0.1, True),
        (255, 255, 0.1, False),
    ):
        optics = models.Blur(SHAPE, np.full((1, 1), float(gain)))
        likelihood = models.LinearLikelihood(optics, models.Gaussian(sigma))
        y = scale * picture + sigma * np.random.default_rng(0).standard_normal(SHAPE)
        if refused:
            with pytest.raises(ValueError, match="divide data and noise by their full scale"):
                ps.Problem(likelihood, prior).condition(y)
        else:
            ps.Problem(likelihood, prior).condition(y)


@pytest.mark.parametrize("dtype", [float, complex])
def test_tempering_begins_from_normal_channels_of_the_pictures(x64, dtype):
    """Their mean and sd, as drawn and as log_prob has it."""
    prior = learned("energy", dtype)
    base, stats = prior.tempering_base(), prior.statistics
    draws = np.stack([to_real(base.sample(k)) for k in jax.random.split(jax.random.key(0), 400)])
    error = stats.sd / np.sqrt(draws.size)
    assert abs(draws.mean() - stats.mean) < 4 * error
    assert abs(draws.std() - stats.sd) < 4 * error / np.sqrt(2)
    x = base.sample(jax.random.key(1))
    expected = scipy.stats.norm(stats.mean, stats.sd).logpdf(to_real(x)).sum()
    np.testing.assert_allclose(base.log_prob(x), expected, rtol=1e-12)
    denoiser = wiener("energy", dtype="float32", perturbation="signal", lowest=0.01)
    with pytest.raises(ValueError, match="forbids negative values: use MALA"):
        EnergyPrior(denoiser, SHAPE).tempering_base()


def test_tempering_under_an_energy_draws_its_posterior(x64):
    """In closed form: the exact network's energy is a normal density, blurred by its finest level.

    Its own draws, by one step here, are far from it, and no start.
    """
    exact = learned("energy", float)
    prior = EnergyPrior(exact.denoiser, SHAPE, sampling_steps=2)
    noise, seen = 0.2, 0.6
    likelihood = models.LinearLikelihood(models.Identity(SHAPE), models.Gaussian(noise))
    post = ps.Problem(likelihood, prior).condition(np.full(SHAPE, seen))
    run = ps.sample(
        post, ps.samplers.TemperedSMC(), jax.random.key(3), chains=16, draws=1000, progress=False
    )
    spread = 0.25**2 + prior.finest**2
    variance = 1 / (1 / spread + 1 / noise**2)
    mean = variance * (0.3 / spread + seen / noise**2)
    # Chains share nothing. Of 200 particles, not 1000, the variance would be 3 % too large.
    for found, expected in ((run.values, mean), ((run.values - mean) ** 2, variance)):
        by_chain = found.mean(axis=(1, 2, 3))
        assert abs(by_chain.mean() - expected) < 4 * by_chain.std(ddof=1) / np.sqrt(16)
        assert by_chain.std(ddof=1) / np.sqrt(16) < 0.01 * expected


@pytest.mark.parametrize("kind", KINDS)
def test_a_sampler_of_the_gaussian_error_says_what_takes_the_other(kind):
    """MALA needs a density, which a score network has not."""
    denoiser = wiener(kind, dtype="float32", perturbation="signal", lowest=0.01)
    posterior = SimpleNamespace(prior=KINDS[kind](denoiser, SHAPE))
    with pytest.raises(ValueError, match="or use AnnealedLangevin without a descent") as caught:
        check_gaussian(ps.samplers.Kawar(), posterior)
    assert ("MALA" in str(caught.value)) == (kind == "energy")


# ---- the signal-dependent error, folded ----------------------------------------------------------


CLEAN = np.geomspace(1e-6, 4.0, 40_001)
Z = np.asarray([1e-3, 0.02, 0.1, 0.4, 1.0])


def folded_weights(z, sigma):
    """p(x, z) dx on CLEAN for x ~ gamma(4, 12), z = |x + sqrt(x) e|: (len(z), len(CLEAN))."""
    sd = sigma * np.sqrt(CLEAN)
    kernel = sum(scipy.stats.norm.pdf(s * z[:, None], CLEAN, sd) for s in (1, -1))
    return kernel * scipy.stats.gamma(4.0, scale=1 / 12).pdf(CLEAN) * np.gradient(CLEAN)


def folded_slope(z, sigma):
    """d/dz of the logarithm of the dense integral, by finite differences."""
    h = 1e-4 * z
    above, below = (np.log(folded_weights(z + step, sigma).sum(1)) for step in (h, -h))
    return (above - below) / (2 * h)


@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0])
def test_signal_score_is_that_of_the_folded_variable(x64, sigma):
    """With the harmonic mean of the clean value in place of the network."""
    weight = folded_weights(Z, sigma)
    harmonic = weight.sum(1) / (weight / CLEAN).sum(1)
    found = score_from_denoised(Z, harmonic, sigma, "signal", False)
    np.testing.assert_allclose(found, folded_slope(Z, sigma), rtol=1e-5, atol=1e-6)
    # What each sign alone says of the clean value is the same: the network may be shown |x~|.
    one = weight / (1 + np.exp(-2 * Z[:, None] / sigma**2))
    np.testing.assert_allclose(one.sum(1) / (one / CLEAN).sum(1), harmonic, rtol=1e-12)


def test_signal_score_without_the_fold_is_wrong_by_a_known_amount(x64):
    """By (1 - tanh(z/sigma^2))/sigma^2: at sigma = 1 by 0.98 of 1 at z = 0.02, by 0.24 at 1."""
    weight = folded_weights(Z, 1.0)
    unfolded = 1 - Z * (weight / CLEAN).sum(1) / weight.sum(1)
    excess = unfolded - folded_slope(Z, 1.0)
    np.testing.assert_allclose(excess, 1 - np.tanh(Z), atol=1e-5)
    np.testing.assert_allclose(excess[[1, 4]], [0.98, 0.24], atol=5e-3)


@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0])
def test_energy_training_aims_at_the_folded_score(x64, sigma):
    """The mean of its target, given z, is the score, and no other score has a smaller loss."""
    clean = jnp.asarray(CLEAN)
    for z, slope in zip(Z, folded_slope(Z, sigma)):
        weight = jnp.asarray(folded_weights(z[None], sigma)[0])

        def loss(score, z=z, weight=weight):
            at = jax.vmap(lambda x: signal_score_loss(score, x, z, sigma, 0.01))(clean)
            return jnp.sum(weight * at) / jnp.sum(weight)

        gradient, curvature = jax.grad(loss)(slope), jax.hessian(loss)(slope)
        assert abs(gradient / curvature) < 1e-5 * (1 + abs(slope))


@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0])
def test_energy_of_a_clean_value_is_minus_its_log_density(x64, sigma):
    z, clean = jnp.asarray(Z), 0.3
    both = [scipy.stats.norm.pdf(s * Z, clean, sigma * clean**0.5) for s in (1, -1)]
    expected = -np.log(sum(both)) - 0.5 * np.log(2 * np.pi * sigma**2 * clean)
    np.testing.assert_allclose(folded_energy(z, clean, sigma), expected, rtol=1e-9, atol=1e-9)
    slope = jax.grad(lambda z: jnp.sum(folded_energy(z, clean, sigma)))
    np.testing.assert_allclose(-slope(z), folded_score(z, clean, sigma), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(slope(0 * z), 0, atol=1e-9)
    assert np.all(np.isfinite(folded_energy(jnp.float32(100 * Z), jnp.float32(clean), 1e-3)))


class ConstantNetwork(eqx.Module):
    """Makes the denoiser say the statistics' mean, whatever it sees: exact for one clean value."""

    one: jax.Array
    channels: int = eqx.field(static=True, default=1)
    stride: int = eqx.field(static=True, default=1)

    def __call__(self, x, log_level):
        return -self.one * x / jnp.exp(log_level)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0])
def test_signal_prior_of_one_clean_value(x64, kind, sigma):
    """Score and what is denoised, of either sign, at zero too; the energy's density beside them."""
    statistics = Statistics(0.3, 0.2, 0.01, 2.0, "signal", lowest=0.01)
    prior = KINDS[kind](Denoiser(ConstantNetwork(jnp.ones(())), statistics), (2, 4))
    x = jnp.asarray([[0.0, 1e-5, 1e-3, 0.02], [0.2, 1.0, -0.02, -1.0]])
    np.testing.assert_allclose(prior.denoise(x, sigma), 0.3, rtol=1e-9)
    np.testing.assert_allclose(
        prior.score(x, sigma), folded_score(x, 0.3, sigma), rtol=1e-9, atol=1e-9
    )
    if kind == "energy":
        expected = -jnp.sum(folded_energy(jnp.abs(x), 0.3, sigma))
        np.testing.assert_allclose(prior.log_prob(jnp.abs(x), sigma), expected, rtol=1e-9)
        assert prior.log_prob(x, sigma) == -np.inf


@pytest.mark.parametrize("kind", KINDS)
def test_signal_loss_of_an_exact_network_is_zero(x64, kind):
    """On pictures of one value; the energy's would not be, were its target not folded."""
    statistics = Statistics(0.25, 0.2, 0.01, 2.0, "signal", lowest=0.01)
    pictures, recipe = Pictures([np.full((8, 8, 1), 0.25)]), Recipe(kind, size=8)
    keys = jax.random.split(jax.random.key(0), 100)

    def losses(one):
        denoiser = Denoiser(ConstantNetwork(one), statistics)
        return jax.vmap(lambda key: patch_loss(denoiser, key, pictures, recipe))(keys)

    np.testing.assert_allclose(losses(jnp.ones(())), 0, atol=1e-9)
    assert losses(jnp.full((), 0.9)).min() > 1e-6


def test_signal_network_and_error_know_no_sign():
    statistics = Statistics(0.3, 0.2, 0.01, 2.0, "signal", lowest=0.01)
    denoiser = Denoiser(ConstantNetwork(jnp.full((), 0.5)), statistics)
    key, clean = jax.random.key(0), jnp.full((4, 4, 1), 0.05)
    x = perturbed(key, clean, 1.0, "signal", False)
    assert x.min() >= 0
    assert np.std(denoiser(x, 1.0)) > 0.005
    np.testing.assert_array_equal(denoiser(x, 1.0), denoiser(-x, 1.0))
    assert perturbed(key, clean, 1.0, "gaussian", False).min() < 0


# ---- draws and starts ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [float, complex])
def test_draws_have_the_moments_of_the_prior(kind, dtype):
    """Of 1000 draws of 24 pixels; the bias of 40 Heun steps, 1 %, is part of the bound."""
    prior = KINDS[kind](wiener(kind, dtype is complex, dtype="float32"), SHAPE)
    keys = jax.random.split(jax.random.key(3), 1000)
    draws = jax.vmap(to_real)(jax.jit(jax.vmap(prior.sample))(keys))
    error = 0.25 / np.sqrt(draws.size)
    assert abs(draws.mean() - 0.3) < 4 * error
    assert abs(draws.std() / 0.25 - 1) < 4 / np.sqrt(2 * draws.size) + 0.01


class Silent(eqx.Module):
    """A network that must not be asked."""

    channels: int = eqx.field(static=True, default=1)
    stride: int = eqx.field(static=True, default=1)

    def __call__(self, x, log_level):
        raise AssertionError("the network was evaluated")


def silent(channels=1, mean=0.8, **statistics):
    statistics = Statistics(mean, 0.2, 0.01, 2.0, **statistics)
    return Denoiser(Silent(channels), statistics)


@pytest.mark.parametrize("dtype, channels", [(float, 1), (float, 3), (complex, 2)])
def test_start_is_dispersed_as_the_pictures_and_asks_no_network(precision, dtype, channels):
    shape = (40, 50, 3) if channels == 3 else (40, 50)
    prior = ScorePrior(silent(channels, complex_valued=dtype is complex), shape)
    x = jax.jit(prior.start)(jax.random.key(0))
    assert (x.shape, x.dtype) == (shape, prior.dtype)
    values = np.asarray(to_real(x))
    assert abs(values.mean() - 0.8) < 4 * 0.2 / np.sqrt(values.size)
    assert abs(values.std() / 0.2 - 1) < 4 / np.sqrt(2 * values.size)


def test_posterior_starts_where_the_prior_does_and_never_below_the_least_value():
    """Of a dark prior, a fifth of whose start would be negative."""
    prior = ScorePrior(silent(mean=0.17, perturbation="signal", lowest=0.01), (16, 16))
    likelihood = models.LinearLikelihood(models.Identity((16, 16)), models.Poisson(100))
    y, key = np.full((16, 16), 0.2), jax.random.key(1)
    found = ps.Posterior(likelihood, prior, jnp.asarray(y)).start(key)
    np.testing.assert_array_equal(found, prior.start(key))
    assert found.min() == np.float32(0.01)
    assert 0.1 < np.mean(found == found.min()) < 0.3


@pytest.mark.parametrize("dtype", [float, complex])
def test_posterior_takes_it_as_any_prior(x64, dtype):
    likelihood = models.LinearLikelihood(models.Identity(SHAPE), models.Gaussian(0.1))
    exact = ps.Problem(likelihood, analytic(dtype))
    x, y = exact.simulate(jax.random.key(0))
    problem = ps.Problem(likelihood, learned("score", dtype))
    np.testing.assert_allclose(
        problem.condition(y).annealed_score(x, 0.1),
        exact.condition(y).annealed_score(x, 0.1),
        rtol=1e-9,
    )


def test_below_the_finest_level_sigma_is_held_there(x64):
    prior = ScorePrior(wiener(sigma_min=0.05), SHAPE)
    x = analytic(float).sample(jax.random.key(0))
    np.testing.assert_array_equal(prior.score(x, 0.0), prior.score(x, 0.05))


def test_above_the_broadest_level_the_errors_variance_stays_right(x64):
    prior = ScorePrior(wiener(sigma_max=10.0), SHAPE)
    x = 50.0 * jax.random.normal(jax.random.key(0), SHAPE)
    np.testing.assert_allclose(prior.score(x, 50.0), analytic(float).score(x, 50.0), rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_precision_of_the_object_is_kept(precision, kind):
    prior = KINDS[kind](wiener(kind, dtype="float32"), SHAPE)
    x = jnp.full(SHAPE, 0.2, precision)
    assert prior.score(x, 0.1).dtype == precision
    assert prior.sample(jax.random.key(0)).dtype == precision


# ---- a network that is no closed form ------------------------------------------------------------


@pytest.mark.parametrize(
    "perturbation", [pytest.param("gaussian", marks=pytest.mark.slow), "signal"]
)
def test_energy_score_is_the_gradient_and_its_jacobian_symmetric(x64, perturbation):
    prior = EnergyPrior(network_denoiser(perturbation=perturbation), (4, 4))
    x = 0.3 + 0.1 * jax.random.uniform(jax.random.key(0), (16,))

    def score(x):
        return prior.score(x.reshape(4, 4), 0.2).ravel()

    h = 1e-6 * np.eye(16)
    density = jax.jit(jax.vmap(lambda x: prior.log_prob(x.reshape(4, 4), 0.2)))
    slope = (density(x + h) - density(x - h)) / 2e-6
    np.testing.assert_allclose(score(x), slope, rtol=1e-5, atol=1e-5 * np.abs(slope).max())
    jacobian = np.asarray(jax.jit(jax.jacrev(score))(x))
    assert np.abs(jacobian - jacobian.T).max() < 1e-12 * np.abs(jacobian).max()


@pytest.mark.slow
def test_loops_tell_an_energy_from_a_score(x64):
    key, start = jax.random.key(1), jnp.full((4, 4), 0.3)
    energy = loop_check(EnergyPrior(network_denoiser(), (4, 4)), key, 0.2, start)
    score = loop_check(ScorePrior(network_denoiser(), (4, 4)), key, 0.2, start)
    assert energy.asymmetry < 1e-10
    # What is left of a gradient's loop is the quadrature's error.
    assert energy.loop < 1e-6 * energy.leg
    assert score.asymmetry > 1e-2
    assert score.loop > 1e-3 * score.leg


def test_line_integral_of_a_gradient_is_the_difference_of_densities(x64):
    prior = EnergyPrior(network_denoiser(), (4, 4))
    a, b = 0.3 + 0.05 * jax.random.normal(jax.random.key(0), (2, 4, 4))
    expected = prior.log_prob(b, 0.2) - prior.log_prob(a, 0.2)
    np.testing.assert_allclose(line_integral(prior, a, b, 0.2), expected, rtol=1e-6)


def test_score_that_is_no_gradient_is_refused_with_its_figure(x64):
    prior = ScorePrior(network_denoiser(), (4, 4))
    with pytest.raises(ValueError, match="nats round a loop"):
        require_gradient(prior, jax.random.key(1), 0.2, 1e-9, start=jnp.full((4, 4), 0.3))


class SlightlyOff(EnergyPrior):
    """Its score has an error of `OFF`, the same in every pixel."""

    OFF = 0.1

    def channel_score(self, x, sigma):
        return super().channel_score(x, sigma) + self.OFF


def test_what_a_signal_energy_denoises_is_no_more_wrong_than_its_score(x64):
    """1/D is off by sigma^2 OFF/z, which has no bound at z = 0; asked at half the mean or above it
    is off by 2 sigma^2 OFF/0.3 at most. A mean of 25 pixels is 4.5 standard errors above half of
    what it should be; at the border, which is left out, there are as few as 9.
    """
    sigma, clean = 0.3, 0.3
    statistics = Statistics(clean, 0.2, 0.01, 2.0, "signal", lowest=0.01)
    prior = SlightlyOff(Denoiser(ConstantNetwork(jnp.ones(())), statistics), (32, 32))
    z = perturbed(jax.random.key(0), jnp.full((32, 32), clean), sigma, "signal", False)
    assert z.min() < 0.01 * clean
    worst = 2 * sigma**2 * prior.OFF / clean
    found = 1 / prior.denoise(z, sigma)
    assert jnp.abs(found - 1 / clean)[2:-2, 2:-2].max() < worst
    roughly = 1 / prior.harmonic_mean(z[..., None], sigma)
    assert jnp.abs(roughly - 1 / clean).max() > 20 * worst


def test_a_signal_energy_denoises_as_well_as_a_score_network():
    """Within 1 dB, where what its score says of each pixel as it is, is 5 dB worse or more."""
    rows, columns = np.ogrid[:64, :64]
    picture = np.full((64, 64), 0.02)
    for row, column, radius, light in [(18, 20, 9, 0.6), (46, 40, 11, 0.4), (14, 50, 7, 0.8)]:
        away = np.hypot(rows - row, columns - column)
        picture = picture + light / (1 + np.exp((away - radius) / 1.5))
    score, energy = (kind.load("nuclei", (64, 64), "signal") for kind in KINDS.values())

    def decibels(denoise, sigma):
        noisy = perturbed(jax.random.key(0), jnp.float32(picture), sigma, "signal", False)
        return psnr(np.asarray(denoise(noisy, sigma)), picture)

    def rough(x, sigma):
        return energy.harmonic_mean(x[..., None], sigma)[..., 0]

    for sigma in (0.1, 0.2):
        by_score, by_energy, roughly = (
            decibels(eqx.filter_jit(f), jnp.float32(sigma))
            for f in (score.denoise, energy.denoise, rough)
        )
        assert by_score - 1 < by_energy
        assert roughly < by_energy - 5


@pytest.mark.slow
def test_signal_draws_are_positive_and_finite():
    prior = ScorePrior(network_denoiser("float32", "signal"), (4, 4), sampling_steps=10)
    draw = prior.sample(jax.random.key(0))
    assert np.all(np.isfinite(draw))
    assert draw.min() >= np.float32(0.01)


# ---- what is refused -----------------------------------------------------------------------------


def test_counts_have_neither_score_nor_density():
    denoiser = silent(perturbation="poisson", lowest=0.0)
    prior = ScorePrior(denoiser, (4, 4))
    for refused in (prior.log_prob, lambda x: prior.score(x, 0.1)):
        with pytest.raises(ValueError, match="counts have no score"):
            refused(jnp.ones((4, 4)))
    with pytest.raises(ValueError, match="counts have no density"):
        EnergyPrior(denoiser, (4, 4))


def test_score_prior_has_no_density():
    prior = ScorePrior(wiener(dtype="float32"), SHAPE)
    with pytest.raises(ValueError, match="has no density"):
        prior.log_prob(jnp.zeros(SHAPE), 0.1)


@pytest.mark.parametrize(
    "shape, words",
    [
        ((6, 8), "multiples of 4"),
        ((8,), "height, width"),
        ((8, 8, 3), "3 channels"),
        ((8, 0), "must be positive"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(shape, words):
    with pytest.raises(ValueError, match=words):
        ScorePrior(network_denoiser("float32"), shape)


def test_complex_object_is_refused_by_a_real_prior():
    prior = ScorePrior(wiener(dtype="float32"), SHAPE)
    with pytest.raises(ValueError, match="complex object"):
        prior.score(jnp.zeros(SHAPE, complex), 0.1)
