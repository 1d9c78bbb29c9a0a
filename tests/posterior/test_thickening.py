"""Thickening of recorded counts, against conjugate posteriors and quadrature."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import posterior as ps
from known import check_mean
from posterior import models, samplers

SIZE = 100


class GammaPixels(models.Prior):
    """Independent gamma pixels, known by their denoiser of counts."""

    concentration: float = 3.0
    rate: float = 20.0
    shape: tuple[int, ...] = eqx.field(static=True, default=(SIZE,))
    complex_valued: bool = eqx.field(static=True, default=False)
    perturbation: str = eqx.field(static=True, default="poisson")

    @property
    def scale(self):
        return jnp.sqrt(self.concentration) / self.rate

    def sample(self, key):
        return jax.random.gamma(key, self.concentration, self.shape) / self.rate

    def log_prob(self, x, sigma=0.0):
        raise ValueError("the poisson perturbation has no density")

    def denoise(self, x, sigma):
        exposure = 1 / sigma**2
        return (x * exposure + self.concentration) / (exposure + self.rate)


def gamma_counts(camera, prior=None, y=None):
    """The posterior of independent gamma pixels behind `camera`."""
    likelihood = models.LinearLikelihood(models.Identity((SIZE,)), camera)
    problem = ps.Problem(likelihood, GammaPixels() if prior is None else prior)
    return problem.condition(problem.simulate(jax.random.key(3))[1] if y is None else y)


def drawn(post, sampler=None, draws=1000):
    sampler = samplers.Thickening() if sampler is None else sampler
    key = jax.random.key(1)
    return ps.sample(post, sampler, key, chains=4, draws=draws, progress=False).values


def test_draws_of_the_conjugate_gamma_posterior(x64):
    post = gamma_counts(models.Poisson(50))
    concentration, rate = 3 + np.asarray(post.y) * 50, 20 + 50
    assert concentration.max() < 53, "a saturated pixel has no conjugate posterior"
    values = drawn(post, draws=300)
    check_mean(values, concentration / rate)
    # The last level keeps a share of the variance that is known.
    left = rate / (20 + 50 * 400)
    check_mean((values - concentration / rate) ** 2, (1 - left) * concentration / rate**2)


@pytest.mark.slow
def test_a_posterior_of_other_counts_fails(x64):
    """As drawn for 61 electrons where 50 were counted: 10 % less noise."""
    post = gamma_counts(models.Poisson(50))
    concentration = 3 + np.asarray(post.y) * 50
    wrong = gamma_counts(models.Poisson(61), y=np.round(np.asarray(post.y) * 61) / 61)
    with pytest.raises(AssertionError):
        check_mean((drawn(wrong, draws=300) - concentration / 70) ** 2, concentration / 70**2)


@pytest.mark.parametrize(
    "camera, y",
    [
        (models.Poisson(50), 1.0),
        pytest.param(models.Poisson(50, holds=60), 1.2, marks=pytest.mark.slow),
        pytest.param(models.Poisson(100, bits=4), 0.2, marks=pytest.mark.slow),
        (models.Poisson(100, bits=4), 1.0),
    ],
    ids=["saturated", "saturated above 1", "four bits", "four bits, saturated"],
)
def test_counts_that_the_recording_does_not_tell(x64, camera, y):
    check_hidden(camera, y)


def check_hidden(camera, y, sampler=None):
    """Against quadrature, within 6 % of the sd: the chain of counts has 30 steps."""
    post = gamma_counts(camera, GammaPixels(30.0, 35.0), np.full(SIZE, y))
    x = np.linspace(0.01, 4, 4000)
    weight = np.exp(np.asarray(jax.vmap(lambda v: camera.log_prob(y, v))(x)))
    weight *= scipy.stats.gamma(30.0, scale=1 / 35).pdf(x)
    weight /= weight.sum()
    mean = (weight * x).sum()
    sd = np.sqrt((weight * (x - mean) ** 2).sum())
    values = drawn(post, sampler, draws=100)
    assert abs(values.mean() - mean) < 0.06 * sd
    assert abs(values.std() / sd - 1) < 0.06


@pytest.mark.slow
def test_a_guess_of_the_hidden_counts_alone_fails(x64):
    """About the light of the least possible counts, without the chain."""
    with pytest.raises(AssertionError):
        check_hidden(models.Poisson(50), 1.0, samplers.Thickening(renewals=0))


def test_recordings_finer_than_the_prior_are_refused():
    """Draws would be a single picture, as if nothing were uncertain."""

    class Coarse(GammaPixels):
        finest = 0.02

    for full_well, words in ((10_000, "full wells up to 277"), (400, "lack 16 % of their")):
        post = gamma_counts(models.Poisson(full_well), Coarse())
        with pytest.raises(ValueError, match=words):
            samplers.Thickening().init(jax.random.key(0), post)
    samplers.Thickening().init(jax.random.key(0), gamma_counts(models.Poisson(277), Coarse()))


def test_electrons_behind_a_recording():
    whole = models.Poisson(50)
    low, high = whole.electrons_between(np.array([0.0, 0.5, 1.0]))
    np.testing.assert_array_equal(low, [0, 25, 50])
    np.testing.assert_array_equal(high, [0, 25, np.inf])
    coarse = models.Poisson(100, bits=4)
    counts = np.arange(101)
    codes = np.floor(counts * 15 / 100 + 0.5)
    low, high = coarse.electrons_between(np.arange(16) / 15)
    for code in range(16):
        assert low[code] == counts[codes == code].min()
        assert high[code] == (np.inf if code == 15 else counts[codes == code].max())


def test_settings_and_problems_are_refused_in_a_sentence():
    with pytest.raises(ValueError, match="levels 1"):
        samplers.Thickening(levels=1)
    with pytest.raises(ValueError, match="sigma_min -1"):
        samplers.Thickening(sigma_min=-1.0)
    key, y = jax.random.key(0), np.full(SIZE, 0.5)
    gaussian = models.GaussianPrior(0.5, 0.04, (SIZE,))
    counts = GammaPixels()

    def refused(prior, optics, camera, words):
        post = ps.Problem(models.LinearLikelihood(optics, camera), prior).condition(y)
        with pytest.raises(ValueError, match=words):
            samplers.Thickening().init(key, post)

    identity, poisson = models.Identity((SIZE,)), models.Poisson(50)
    refused(gaussian, identity, poisson, "'gaussian' perturbation: Thickening needs")
    refused(counts, models.Matrix(np.eye(SIZE)), poisson, "Matrix optics: Thickening")
    refused(counts, identity, models.PoissonGaussian(50, 2.0), "PoissonGaussian: Thickening")


def test_other_samplers_refuse_a_denoiser_of_counts():
    post = gamma_counts(models.Poisson(50))
    for sampler in (samplers.AnnealedLangevin(), samplers.SplitGibbs(), samplers.DPS()):
        with pytest.raises(ValueError, match="poisson"):
            ps.sample(post, sampler, jax.random.key(0), chains=1, draws=1, progress=False)
