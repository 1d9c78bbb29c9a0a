"""Learned priors: with an exact network in place they must be the analytic prior, exactly."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from analytic import wiener

import posterior as ps
from posterior import models
from posterior.models import priors
from posterior.models.priors import EnergyPrior, ScorePrior
from posterior.models.priors.conservative import line_integral, loop_check, require_gradient
from posterior.models.priors.denoiser import Denoiser, Statistics
from posterior.models.priors.perturbation import score_from_denoised
from posterior.models.priors.unet import UNet
from posterior.models.realview import to_real

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


def test_signal_score_is_that_of_a_tabulated_prior(x64):
    """With the harmonic mean of the clean value in place of the network."""
    exact = priors.PixelPrior.gamma(4.0, 12.0, (7,))
    x, sigma = jnp.linspace(0.02, 1.0, 7), 0.3
    clean = exact.grid[1:]
    kernel = jnp.exp(-((x[:, None] - clean) ** 2) / (2 * sigma**2 * clean)) / jnp.sqrt(clean)
    weight = kernel * exact.density[1:] * jnp.gradient(clean)
    harmonic = weight.sum(1) / (weight / clean).sum(1)
    found = score_from_denoised(x, harmonic, sigma, "signal", False)
    np.testing.assert_allclose(found, exact.score(x, sigma), rtol=1e-5)


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


def network_denoiser(dtype="float64", perturbation="gaussian"):
    network = UNet(1, jax.random.key(4), (8, 8), fine=4)
    # A fresh network says almost nothing: enlarge its last layer, to have something to measure.
    network = eqx.tree_at(lambda n: n.fine_out.kernel, network, replace_fn=lambda k: 30 * k)
    network = jax.tree.map(lambda a: a.astype(dtype), network)
    floor = 0.01 if perturbation == "signal" else 0.0
    statistics = Statistics(0.3, 0.25, 0.01, 10.0, perturbation, lowest=floor)
    return Denoiser(network, statistics)


@pytest.mark.parametrize("perturbation", ["gaussian", "signal"])
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


@pytest.mark.slow
def test_signal_draws_are_positive_and_finite():
    prior = ScorePrior(network_denoiser("float32", "signal"), (4, 4), sampling_steps=10)
    draw = prior.sample(jax.random.key(0))
    assert np.all(np.isfinite(draw))
    assert draw.min() >= np.float32(0.01)


# ---- what is refused -----------------------------------------------------------------------------


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
