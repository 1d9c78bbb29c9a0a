"""Several exposures: the exact density of all, and the annealed score of one longer exposure."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import posterior as ps
from known import check_moments, linear_gaussian
from posterior import models, samplers
from posterior.models.camera import Camera
from posterior.models.realview import from_real, to_real

COUNT = 3
RNG = np.random.default_rng(0)
FIELD = RNG.uniform(0.3, 0.6, 5) * np.exp(2j * np.pi * RNG.random(5))
LINEAR = models.Matrix(RNG.uniform(0.05, 0.2, (7, 5)))
FAR = models.Fourier((5,), oversampling=2)

# name: (likelihood of one exposure, an object)
CASES = {
    "gaussian": (models.LinearLikelihood(LINEAR, models.Gaussian(0.1)), FIELD.real),
    "complex": (models.LinearLikelihood(FAR, models.Gaussian(0.1)), FIELD),
    "counts": (models.LinearLikelihood(LINEAR, models.Poisson(100)), np.abs(FIELD)),
    "more than white": (
        models.LinearLikelihood(LINEAR, models.Poisson(100, holds=300)),
        5 * np.abs(FIELD),
    ),
    "intensity": (models.IntensityLikelihood(FAR, models.Poisson(100), 0.8), FIELD),
    "8 bits": (models.IntensityLikelihood(FAR, models.Poisson(900, bits=8)), FIELD),
    "read noise": (models.LinearLikelihood(LINEAR, models.PoissonGaussian(50, 2.0)), abs(FIELD)),
}


DEAR = ("counts", "more than white", "intensity", "8 bits", "read noise")


def recorded(name):
    """The likelihood of one exposure, that of three, an object and three exposures of it."""
    one, x = CASES[name]
    several = models.Exposures(one, COUNT)
    x = jnp.asarray(x)
    return one, several, x, eqx.filter_jit(several.simulate)(jax.random.key(1), x)


# Every electron that a reading may come from is dear to compile.
EACH = [pytest.param(n, marks=[pytest.mark.slow] if n in DEAR else []) for n in CASES]


@pytest.mark.parametrize("name", EACH)
def test_the_density_is_that_of_each_exposure_and_the_score_its_gradient(x64, name):
    one, several, x, y = recorded(name)
    assert y.shape == several.data_shape == (COUNT, *one.data_shape)
    assert len(np.unique(y, axis=0)) == COUNT
    log_prob = jax.jit(jax.vmap(lambda v: several.log_prob(from_real(v, x.shape, x.dtype), y)))
    alone = jax.jit(jax.vmap(lambda y: one.log_prob(x, y)))
    v, h = to_real(x), 1e-5
    places = v + h * jnp.concatenate([jnp.eye(len(v)), -jnp.eye(len(v)), jnp.zeros((1, len(v)))])
    *sides, here = log_prob(places)
    assert here == pytest.approx(jnp.sum(alone(y)))
    above, below = np.reshape(sides, (2, len(v)))
    found = to_real(eqx.filter_jit(several.score)(x, y))
    np.testing.assert_allclose(found, (above - below) / (2 * h), atol=1e-5 * np.abs(found).max())


@pytest.mark.parametrize("name", EACH[:5])
def test_without_an_annealing_error_the_annealed_score_is_the_score(x64, name):
    """The mean of the exposures is sufficient."""
    _, several, x, y = recorded(name)
    found = jax.jit(lambda x, y: several.annealed_score(x, y, 0.0))(x, y)
    exact = eqx.filter_jit(several.score)(x, y)
    np.testing.assert_allclose(found, exact, atol=1e-9 * np.abs(exact).max())


def test_the_annealed_score_has_one_error_for_all_exposures(x64):
    """y_i = x + e + n_i: given x~ = x + e the mean has the variance sigma^2/count + e's, once."""
    noise, level = 0.3, 0.5
    one = models.LinearLikelihood(models.Identity((4,)), models.Gaussian(noise))
    several, x = models.Exposures(one, COUNT), jnp.arange(4.0)
    y = several.simulate(jax.random.key(0), x)
    covariance = noise**2 * np.eye(COUNT) + level**2
    exact = np.ones(COUNT) @ np.linalg.solve(covariance, y - x)
    np.testing.assert_allclose(several.annealed_score(x, y, level), exact, rtol=1e-9)
    assert several.curvature(False, y, level, "convolved") == pytest.approx(
        np.ones(COUNT) @ np.linalg.solve(covariance, np.ones(COUNT))
    )


def two_exposures():
    """A linear-Gaussian posterior given two exposures, and its exact mean and covariance."""
    one, _, _ = linear_gaussian(3, 4, float)
    problem = ps.Problem(models.Exposures(one.likelihood, 2), one.prior)
    _, y = problem.simulate(jax.random.key(1))
    h, noise = one.likelihood.optics.matrix, one.likelihood.camera.sigma
    mean, prior = np.asarray(one.prior.mean).ravel(), np.asarray(one.prior.covariance)
    covariance = np.linalg.inv(np.linalg.inv(prior) + 2 * h.T @ h / noise**2)
    exact = covariance @ (np.linalg.solve(prior, mean) + h.T @ np.sum(y, axis=0) / noise**2)
    return problem.condition(y), exact, covariance


def test_a_posterior_of_two_exposures_has_its_closed_form(x64):
    given, mean, covariance = two_exposures()
    places = mean + RNG.standard_normal((5, 3))
    found = jax.vmap(given.log_prob)(places)
    exact = scipy.stats.multivariate_normal(mean, covariance).logpdf(places)
    np.testing.assert_allclose(found - found[0], exact - exact[0], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sampler, draws",
    [(samplers.MALA(), 1000), (samplers.AnnealedLangevin(levels=100, steps=5), 250)],
    ids=["exact", "annealed"],
)
def test_samplers_draw_it(x64, sampler, draws):
    given, mean, covariance = two_exposures()
    found = ps.sample(given, sampler, jax.random.key(0), draws=draws, progress=False)
    check_moments(found.values, mean, covariance)


@pytest.mark.parametrize("name", CASES)
def test_they_are_linear_where_one_is(name):
    one, _ = CASES[name]
    assert models.Exposures(one, 2).linear == one.linear == (name not in ("intensity", "8 bits"))


def test_optics_are_those_of_one_exposure_as_often(x64):
    optics = models.Exposures(CASES["counts"][0], COUNT).optics
    matrix = jax.vmap(optics, out_axes=-1)(jnp.eye(5)).reshape(-1, 5)
    field = RNG.standard_normal(optics.out_shape)
    np.testing.assert_allclose(optics.adjoint(field), matrix.T @ field.ravel())
    np.testing.assert_allclose(optics.row_norms().ravel(), np.linalg.norm(matrix, axis=1))
    assert optics.norm_squared() == pytest.approx(np.linalg.norm(matrix, 2) ** 2)


class Film(Camera):
    """A camera of somebody else."""

    sigma0: float = 0.1
    read_variance: float = 0.0
    counting: bool = False

    def sample(self, key, expected):
        return expected

    def log_prob(self, y, expected):
        return -((y - expected) ** 2)

    def check(self, y):
        pass


def test_what_is_no_likelihood_of_exposures_is_refused():
    one = CASES["counts"][0]
    with pytest.raises(ValueError, match="a Matrix: give that of a single exposure"):
        models.Exposures(LINEAR, 2)
    with pytest.raises(ValueError, match="a Exposures: give that of a single"):
        models.Exposures(models.Exposures(one, 2), 2)
    for count in (0, 1.5):
        with pytest.raises(ValueError, match=f"count {count}: give a whole number"):
            models.Exposures(one, count)
    with pytest.raises(ValueError, match="camera Film: several exposures are for"):
        models.Exposures(models.LinearLikelihood(LINEAR, Film()), 2)
    x = jnp.ones(5)
    with pytest.raises(ValueError, match="'signal': several exposures need a prior with"):
        models.Exposures(one, 2).annealed_score(x, jnp.ones((2, 7)), 0.1, perturbation="signal")
