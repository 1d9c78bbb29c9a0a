"""Split Gibbs, DAPS, DPS, SNIPS and the stochastic denoiser, against posteriors that are known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import posterior as ps
from known import check_moments, linear_gaussian, real_view
from posterior import models, samplers
from posterior.models.annealing import component_sd
from posterior.models.priors.base import Prior
from posterior.models.realview import normal_like
from posterior.samplers import reverse
from posterior.samplers.daps import flow


def draw(post, sampler, chains, key=1, **settings):
    """Independent draws (4, chains/4, *shape): each chain gives one."""
    settings = {"draws": 1, "progress": False, **settings}
    values = ps.sample(post, sampler, jax.random.key(key), chains=chains, **settings).values
    return values.reshape(4, -1, *post.shape)


def check_law(values, mean, covariance):
    """Every mean and covariance, and the overall width, within Monte-Carlo error.

    The squared distances in units of the covariance have mean n and variance 2 n: five of their
    standard errors.
    """
    check_moments(values, mean, covariance)
    width, error = relative_variance(values, mean, covariance)
    assert abs(width - 1) < 5 * error, (width, error)


def relative_variance(values, mean, covariance):
    """Mean squared deviation from the exact mean over the exact one, and its standard error."""
    rest = real_view(values).reshape(-1, len(mean)) - mean
    squares = np.sum(rest * np.linalg.solve(covariance, rest.T).T, axis=1) / len(mean)
    return squares.mean(), np.sqrt(2 / len(mean) / len(rest))


def broadened(post, rho):
    """Mean and covariance of a linear-Gaussian posterior whose likelihood is broadened by `rho`."""
    complex_object = post.prior.complex_valued
    matrix = np.asarray(jax.vmap(post.likelihood.optics, out_axes=1)(jnp.eye(post.shape[0])))
    data = np.asarray(post.y)
    if complex_object:
        matrix = np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])
        data = np.concatenate([data.real, data.imag])
    variance = post.likelihood.camera.sigma**2 * np.eye(len(data))
    variance += component_sd(rho, complex_object) ** 2 * matrix @ matrix.T
    prior = np.asarray(post.prior.covariance)
    pull = np.linalg.solve(variance, matrix).T
    covariance = np.linalg.inv(np.linalg.inv(prior) + pull @ matrix)
    mean = covariance @ (np.linalg.solve(prior, np.asarray(post.prior.mean)) + pull @ data)
    return mean, covariance


def denoising(dtype=float, noise=0.1, size=6):
    """A correlated Gaussian picture under white Gaussian noise, its prior sd about 0.2."""
    n = size * (2 if dtype is complex else 1)
    root = np.random.default_rng(0).standard_normal((n, n)) / np.sqrt(n)
    prior = models.GaussianPrior(0.5, 0.04 * (0.3 * np.eye(n) + root @ root.T), (size,), dtype)
    likelihood = models.LinearLikelihood(models.Identity((size,)), models.Gaussian(noise))
    problem = ps.Problem(likelihood, prior)
    return problem.condition(problem.simulate(jax.random.key(0))[1])


# ---- split Gibbs --------------------------------------------------------------------------------


def draws_of_the_prior_step(dtype):
    """Of p(x) N(x; u, rho^2), rho among the prior's scales; their exact mean and covariance."""
    prior, rho = denoising(dtype).prior, jnp.asarray(0.3 if dtype is complex else 0.15)
    u = prior.sample(jax.random.key(2))
    step = samplers.SplitGibbs(prior_steps=16)._object_given
    keys = jax.random.split(jax.random.key(3), 6000)
    values = jax.jit(jax.vmap(lambda key: step(key, prior, u, rho)))(keys)
    precision = 1 / component_sd(rho, dtype is complex) ** 2
    inverse = np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(inverse + precision * np.eye(len(inverse)))
    mean = covariance @ (inverse @ prior.mean + precision * real_view(u[None, None])[0, 0])
    return np.asarray(values).reshape(4, -1, *prior.shape), mean, covariance


@pytest.mark.parametrize("dtype", [pytest.param(float, marks=pytest.mark.slow), complex])
def test_the_prior_step_draws_the_denoising_posterior(x64, dtype):
    check_law(*draws_of_the_prior_step(dtype))


@pytest.mark.slow
def test_a_reverse_diffusion_about_the_denoised_mean_alone_is_too_narrow(x64, monkeypatch):
    """What J is for: without it, in 16 steps, a sixth of the variance is missing."""

    def bridge(key, prior, x, sigma, following):
        clean, q = prior.denoise(x, sigma), following / sigma
        noise = following * jnp.sqrt(1 - q**2) * normal_like(key, x)
        return clean + q**2 * (x - clean) + noise

    monkeypatch.setattr(reverse, "reverse_step", bridge)
    width, error = relative_variance(*draws_of_the_prior_step(float))
    assert width < 0.9 - 5 * error, width


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [float, complex])
def test_split_gibbs_draws_a_linear_gaussian_posterior(x64, dtype):
    """Under a dense matrix; the exact answer has the broadening by the finest coupling."""
    post, mean, covariance = linear_gaussian(6, 4, dtype)
    np.testing.assert_allclose(broadened(post, 0.0)[0], mean, rtol=1e-8)
    sampler = samplers.SplitGibbs(iterations=200, moves=20)
    rho = float(sampler.init(jax.random.key(0), post).sigmas[-1])
    check_law(draw(post, sampler, 3000), *broadened(post, rho))


@pytest.mark.slow
def test_a_coupling_as_large_as_the_noise_draws_what_it_says_and_not_the_posterior(x64):
    """At rho/2 = s per real component the noise has twice its variance."""
    post, mean, covariance = linear_gaussian(6, 4, complex)
    rho = 2 * post.likelihood.camera.sigma
    values = draw(post, samplers.SplitGibbs(iterations=30, rho_min=rho), 1000)
    check_law(values, *broadened(post, rho))
    with pytest.raises(AssertionError):
        check_law(values, mean, covariance)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [float, complex])
def test_a_descent_draws_the_object_under_a_broadened_likelihood(x64, dtype):
    """Ended at a level as large as the noise: twice it in the likelihood of x~ ("convolved"), and
    once more from x~ to x, three times the variance in all. Without the descent, x~ itself."""
    post = denoising(dtype)
    level = post.likelihood.camera.sigma * (2 if dtype is complex else 1)
    settings = {"levels": 40, "steps": 8, "step_size": 0.3, "sigma_min": level}
    values = draw(post, samplers.AnnealedLangevin(**settings, descent=16), 4000)
    check_law(values, *broadened(post, np.sqrt(2) * level))
    with pytest.raises(AssertionError):
        check_law(draw(post, samplers.AnnealedLangevin(**settings), 4000), *broadened(post, level))


def at_one_level(step_size, sigma, count=4000):
    """Draws of x~ at a level that stays: 120 steps, the start forgotten."""
    ends = {"sigma_max": sigma, "sigma_min": sigma}
    sampler = samplers.AnnealedLangevin(levels=2, steps=60, step_size=step_size, **ends)
    return draw(denoising(), sampler, count)


@pytest.mark.parametrize("step_size", [0.6, pytest.param(1.2, marks=pytest.mark.slow)])
def test_a_step_of_any_size_leaves_a_gaussian_with_its_covariance(x64, step_size):
    """x~ under a prior and a likelihood that are both broader by the level: exactly known.

    A plain Langevin step h leaves each eigenvalue v of that covariance at v/(1 - h/(2 v)).
    """
    post, sigma = denoising(), 0.1
    noise = post.likelihood.camera.sigma**2 + sigma**2
    prior = np.asarray(post.prior.covariance) + sigma**2 * np.eye(6)
    covariance = np.linalg.inv(np.linalg.inv(prior) + np.eye(6) / noise)
    weights = np.linalg.solve(prior, np.asarray(post.prior.mean)) + np.asarray(post.y) / noise
    values, mean = at_one_level(step_size, sigma), covariance @ weights
    check_law(values, mean, covariance)
    h = step_size / (1 / sigma**2 + 1 / noise)
    v, axes = np.linalg.eigh(covariance)
    with pytest.raises(AssertionError):
        check_law(values, mean, (axes * v / (1 - h / (2 * v))) @ axes.T)
    with pytest.raises(AssertionError):
        check_law(values, mean, 1.1 * covariance)


@pytest.mark.parametrize("dtype", [float, complex])
def test_the_data_level_is_that_of_the_noise(dtype):
    """Half of it in Re and in Im: noise of sd 0.1 each is the level 0.2 of a complex object."""
    np.testing.assert_allclose(denoising(dtype).data_level(), 0.2 if dtype is complex else 0.1)


def test_tweedie_is_for_the_gaussian_error():
    prior = models.PixelPrior.gamma(4.0, 12.0, (7,))
    with pytest.raises(ValueError, match="Tweedie's formula is for the gaussian one"):
        prior.denoise(jnp.ones(7), 0.1)


def test_a_draw_ends_in_one_way():
    with pytest.raises(ValueError, match="one way to end a draw, not both"):
        samplers.AnnealedLangevin(polish=10, descent=4)


class SmoothGamma(Prior):
    """Independent gamma pixels with the gaussian error, by quadrature about the annealed value."""

    concentration: int = eqx.field(static=True)
    rate: float
    shape: tuple[int, ...] = eqx.field(static=True)
    complex_valued: bool = eqx.field(static=True, default=False)
    perturbation: str = eqx.field(static=True, default="gaussian")

    @property
    def scale(self):
        return np.sqrt(self.concentration) / self.rate

    def sample(self, key):
        """A sum of exponentials: quicker to compile than jax.random.gamma."""
        parts = jax.random.exponential(key, (int(self.concentration), *self.shape))
        return parts.sum(0) / self.rate

    def log_prob(self, x, sigma=0.0):
        nodes = jnp.linspace(-6, 6, 25)
        clean = x[..., None] + sigma * nodes
        lit = jnp.maximum(clean, 1e-12)
        density = (self.concentration - 1) * jnp.log(lit) - self.rate * lit
        density = jnp.where(clean > 0, density, -1e4 * (1 - clean / sigma))
        return jnp.sum(jax.nn.logsumexp(density - nodes**2 / 2, axis=-1))


COUNTS = np.repeat([0, 1, 3, 8, 20], 2)
FULL_WELL = 50


def photon_moments(full_well, rho=0.0):
    """Mean and sd of a gamma(3, 20) pixel given each count, the likelihood broadened by `rho`."""
    x = np.linspace(1e-5, 1.5, 6001)[:, None]
    nodes = np.linspace(-6, 6, 121)
    light = np.maximum(x + rho * nodes, 0)
    kernel = np.exp(-(nodes**2) / 2)
    prior = scipy.stats.gamma(3.0, scale=1 / 20).pdf(x[:, 0])
    moments = []
    for count in COUNTS:
        weight = prior * (scipy.stats.poisson.pmf(count, full_well * light) @ kernel)
        mean = weight @ x[:, 0] / weight.sum()
        moments.append((mean, np.sqrt(weight @ (x[:, 0] - mean) ** 2 / weight.sum())))
    return np.transpose(moments)


def check_pixels(values, mean, sd):
    """Largest of all means and variances in units of its standard error, once in 2000 runs."""
    squares = (values - mean) ** 2
    z = np.concatenate(
        [
            (part.mean(0) - exact) / (part.std(0) / np.sqrt(len(part)))
            for part, exact in ((values, mean), (squares, sd**2))
        ]
    )
    assert np.abs(z).max() < scipy.stats.norm.isf(0.0005 / (2 * z.size)), np.abs(z).max()


@pytest.mark.slow
def test_split_gibbs_draws_the_gamma_posterior_of_photon_counts(x64):
    """Dark pixels too: the posterior of no electrons has an sd of 0.025, the coupling is 0.006.

    Beside the conjugate posterior itself the coupling costs 0.02 sd in a mean, and 3 % of an sd.
    A full well 22 % wrong, which is a noise level 10 % wrong, fails.
    """
    likelihood = models.LinearLikelihood(models.Identity(COUNTS.shape), models.Poisson(FULL_WELL))
    prior = SmoothGamma(3, 20.0, COUNTS.shape)
    post = ps.Problem(likelihood, prior).condition(COUNTS / FULL_WELL)
    sampler = samplers.SplitGibbs(iterations=50, moves=5, prior_steps=6)
    rho = float(sampler.init(jax.random.key(0), post).sigmas[-1])
    values = draw(post, sampler, 500).reshape(-1, COUNTS.size)
    mean, sd = photon_moments(FULL_WELL, rho)
    check_pixels(values, mean, sd)
    conjugate = scipy.stats.gamma(3.0 + COUNTS, scale=1 / (20.0 + FULL_WELL))
    assert np.abs((mean - conjugate.mean()) / conjugate.std()).max() < 0.025
    assert np.abs(sd / conjugate.std() - 1).max() < 0.03
    with pytest.raises(AssertionError):
        check_pixels(values, *photon_moments(1.22 * FULL_WELL, rho))


# ---- the stochastic denoiser --------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [pytest.param(float, marks=pytest.mark.slow), complex])
def test_the_stochastic_denoiser_draws_a_gaussian_posterior(x64, dtype):
    post = denoising(dtype)
    values = draw(post, samplers.Kawar(), 1000)
    check_law(values, *broadened(post, 0.0))
    with pytest.raises(AssertionError):
        check_law(values, *broadened(post, 0.1))


def test_the_stochastic_denoiser_takes_photon_noise_for_white(x64):
    """Its one noise level is the mean sd; for complex objects the level of twice that."""
    likelihood = models.LinearLikelihood(models.Identity((2,)), models.Poisson(100))
    problem = ps.Problem(likelihood, models.GaussianPrior(0.5, 0.04, (2,)))
    state = samplers.Kawar().init(jax.random.key(0), problem.condition(np.array([0.09, 0.64])))
    np.testing.assert_allclose(state.noise_level, (0.03 + 0.08) / 2, rtol=1e-6)
    np.testing.assert_array_equal(state.position, state.posterior.y)
    state = samplers.Kawar().init(jax.random.key(0), denoising(complex))
    np.testing.assert_allclose(state.noise_level, 0.2, rtol=1e-6)


# ---- SNIPS --------------------------------------------------------------------------------------


def of_gains(gains, dtype=float):
    """A Posterior with those singular values, exact mean and covariance: noise of 0.1."""
    size, complex_object = len(gains), dtype is complex
    rng = np.random.default_rng(3)

    def rotation():
        square = rng.standard_normal((size, size)) + 1j * rng.standard_normal((size, size))
        return np.linalg.qr(square if complex_object else square.real)[0]

    matrix = (rotation() * gains) @ rotation()
    prior = denoising(dtype, size=size).prior
    problem = ps.Problem(
        models.LinearLikelihood(models.Matrix(matrix), models.Gaussian(0.1)), prior
    )
    post = problem.condition(problem.simulate(jax.random.key(0))[1])
    return post, *broadened(post, 0.0)


@pytest.mark.parametrize(
    "gains, dtype",
    [
        ([3.0, 1.0, 0.3, 0.1, 0.0], float),
        pytest.param([3.0, 1.0, 0.3, 0.1, 0.0], complex, marks=pytest.mark.slow),
    ],
)
def test_snips_draws_a_linear_gaussian_posterior(x64, gains, dtype):
    """Gains on both sides of the noise, and one of nothing, whose component is the prior's."""
    post, mean, covariance = of_gains(gains, dtype)
    values = draw(post, samplers.SNIPS(), 3000)
    check_law(values, mean, covariance)
    with pytest.raises(AssertionError):
        check_law(values, mean, np.asarray(post.prior.covariance))
    with pytest.raises(AssertionError):
        check_law(values, mean, 1.1 * covariance)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [3, 9])
def test_snips_takes_fewer_rows_and_more(x64, rows):
    post, mean, covariance = linear_gaussian(6, rows, float, noise=0.1)
    check_law(draw(post, samplers.SNIPS(), 3000), mean, covariance)


def test_snips_refuses_what_is_not_linear_and_gaussian():
    poisson = models.LinearLikelihood(models.Identity((3,)), models.Poisson(50))
    post = ps.Problem(poisson, models.GaussianPrior(0.5, 0.04, (3,))).condition(np.full(3, 0.5))
    with pytest.raises(ValueError, match="a Poisson camera: SNIPS is for linear measurements"):
        samplers.SNIPS().init(jax.random.key(0), post)
    large = models.LinearLikelihood(models.Identity((65, 64)), models.Gaussian(0.1))
    post = ps.Problem(large, models.GaussianField(np.ones((65, 64)))).condition(np.ones((65, 64)))
    with pytest.raises(ValueError, match="of 4160 real dimensions"):
        samplers.SNIPS().init(jax.random.key(0), post)


# ---- diffusion posterior sampling ---------------------------------------------------------------


@pytest.mark.parametrize(
    "noise, spread",
    [
        (0.1, 0.68),
        pytest.param(0.05, 1.18, marks=pytest.mark.slow),
        pytest.param(0.2, 0.58, marks=pytest.mark.slow),
    ],
)
def test_dps_finds_the_mean_and_not_the_spread(x64, noise, spread):
    """Its documented limit: at a prior sd of 0.2 its sd is `spread` times the posterior's."""
    post = denoising(noise=noise)
    mean, covariance = broadened(post, 0.0)
    values = draw(post, samplers.DPS(), 600)

    def distance(x):
        return np.sqrt(np.mean((x - mean) ** 2 / np.diag(covariance)))

    found = distance(values.mean((0, 1)))
    assert found < 0.55
    assert found < distance(0.5) / 1.5
    if noise == 0.1:
        assert found < 0.2 < distance(np.asarray(post.y)) / 2
    width, error = relative_variance(values, values.mean((0, 1)), covariance)
    assert abs(np.sqrt(width) / spread - 1) < 0.1
    assert abs(width - 1) > 10 * error


@pytest.mark.slow
@pytest.mark.parametrize("sampler", [samplers.DPS(), samplers.DAPS()], ids=["dps", "daps"])
def test_the_intensities_of_a_complex_object_are_explained(x64, sampler):
    """The misfit of a draw comes down to 1.8 times the photon noise, from far above it."""
    optics = models.Fourier((4, 4), oversampling=2)
    likelihood = models.IntensityLikelihood(optics, models.Poisson(1000))
    problem = ps.Problem(likelihood, models.GaussianPrior(0.3, 0.02, (4, 4), complex))
    post = problem.condition(problem.simulate(jax.random.key(0))[1])

    def misfit(x):
        squares = (post.y - likelihood.expected(x)) ** 2 / (np.maximum(post.y, 1e-3) / 1000)
        return np.sqrt(np.mean(squares))

    draws = ps.sample(post, sampler, jax.random.key(1), draws=1, chains=20, progress=False)
    found = [misfit(x) for x in draws.values[:, 0]]
    assert np.median(found) < 1.8, found
    assert misfit(post.start(jax.random.key(2))) > 5


# ---- decoupled annealing ------------------------------------------------------------------------


def level_sds(sampler, post):
    sigmas = sampler.init(jax.random.key(0), post).sigmas
    return component_sd(np.asarray(sigmas), post.prior.complex_valued)


def decoupled(post, sampler):
    """Mean and covariance of a decoupled run's draws: normal at every level, in the prior's axes.

    An Euler step of the flow shrinks a deviation v wide to (v + q s^2)/(v + s^2) of itself, q the
    ratio of its levels; the draw about the flow's end weighs that end and the recording.
    """
    v, axes = np.linalg.eigh(post.prior.covariance)
    centre = axes.T @ np.asarray(post.prior.mean)
    y = axes.T @ real_view(np.asarray(post.y)[None, None])[0, 0]
    noise = post.likelihood.camera.sigma**2
    fractions = np.append(np.geomspace(1, 1 / sampler.flow_steps, sampler.flow_steps), 0)
    mean, variance = centre, v
    for sigma in level_sds(sampler, post):
        squares = (sigma * fractions[:-1, None]) ** 2
        kept = np.prod((v + (fractions[1:] / fractions[:-1])[:, None] * squares) / (v + squares), 0)
        spread = 1 / (1 / noise + 1 / sigma**2)
        mean = spread * (y / noise + (centre + kept * (mean - centre)) / sigma**2)
        variance = spread + (spread / sigma**2 * kept) ** 2 * (variance + sigma**2)
    return axes @ mean, (axes * variance) @ axes.T


@pytest.mark.parametrize("dtype", [pytest.param(complex, marks=pytest.mark.slow), float])
def test_decoupled_annealing_draws_the_gaussian_that_it_says_and_not_the_posterior(x64, dtype):
    post, sampler = denoising(dtype), samplers.DAPS(levels=25, moves=30)
    values = draw(post, sampler, 3000)
    mean, covariance = decoupled(post, sampler)
    check_law(values, mean, covariance)
    with pytest.raises(AssertionError):
        check_law(values, *broadened(post, 0.0))
    with pytest.raises(AssertionError):
        check_law(values, *decoupled(post, samplers.DAPS(levels=25, flow_steps=1)))


@pytest.mark.parametrize("noise, spread", [(0.05, 1.02), (0.1, 1.06), (0.2, 1.13)])
def test_decoupled_annealing_is_wider_than_the_posterior(x64, noise, spread):
    """Its documented limit, by the closed form: how wide, and off by up to 0.3 sd."""
    post = denoising(noise=noise)
    (mean, covariance), exact = decoupled(post, samplers.DAPS()), broadened(post, 0.0)
    width = np.sqrt(np.trace(covariance) / np.trace(exact[1]))
    assert abs(width - spread) < 0.01
    assert 0.1 < np.abs((mean - exact[0]) / np.sqrt(np.diag(exact[1]))).max() < 0.3


@pytest.mark.parametrize("dtype", [float, complex])
def test_the_flow_carries_a_gaussian_to_its_prior(x64, dtype):
    """Exactly: x - m shrinks by sqrt(v / (v + s^2)); the Euler steps err as 1/n."""
    prior, sigma = denoising(dtype).prior, jnp.asarray(0.3)
    x = prior.sample(jax.random.key(2)) + sigma * normal_like(
        jax.random.key(3), jnp.zeros(6, dtype)
    )
    v, axes = np.linalg.eigh(prior.covariance)
    shrink = np.sqrt(v / (v + component_sd(0.3, dtype is complex) ** 2))
    deviation = real_view(np.asarray(x)[None, None])[0, 0] - np.asarray(prior.mean)
    exact = prior.mean + axes @ (shrink * (axes.T @ deviation))
    errors = [
        np.abs(real_view(np.asarray(flow(prior, x, sigma, n))[None, None])[0, 0] - exact).max()
        for n in (40, 80, 160)
    ]
    assert errors[-1] < 0.03 * np.abs(deviation).max(), errors
    assert errors[2] < 0.7 * errors[1] < 0.7**2 * errors[0], errors


# ---- what all of them refuse and keep -----------------------------------------------------------


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: samplers.SplitGibbs(iterations=1), "iterations 1"),
        (lambda: samplers.SplitGibbs(moves=0), "moves 0"),
        (lambda: samplers.SplitGibbs(prior_steps=0), "prior_steps 0"),
        (lambda: samplers.SplitGibbs(step_size=2.5), "step_size 2.5"),
        (lambda: samplers.SplitGibbs(rho_min=-1.0), "rho_min -1.0"),
        (lambda: samplers.SplitGibbs(rho_min=1.0, rho_max=0.5), "rho_min 1.0 is above"),
        (lambda: samplers.DPS(levels=1), "levels 1"),
        (lambda: samplers.DPS(zeta=0.0), "zeta 0.0"),
        (lambda: samplers.DPS(sigma_max=0.0), "sigma_max 0.0"),
        (lambda: samplers.DAPS(levels=1), "levels 1"),
        (lambda: samplers.DAPS(flow_steps=0), "flow_steps 0"),
        (lambda: samplers.DAPS(moves=0), "moves 0"),
        (lambda: samplers.DAPS(step_size=2.0), "step_size 2.0"),
        (lambda: samplers.DAPS(sigma_min=1.0, sigma_max=0.5), "sigma_min 1.0 is above"),
        (lambda: samplers.SNIPS(levels=1), "levels 1"),
        (lambda: samplers.SNIPS(steps=0), "steps 0"),
        (lambda: samplers.SNIPS(step_size=2.0), "step_size 2.0"),
        (lambda: samplers.SNIPS(sigma_min=-1.0), "sigma_min -1.0"),
        (lambda: samplers.Kawar(steps=0), "steps 0"),
        (lambda: samplers.Kawar(step_size=0.0), "step_size 0.0"),
        (lambda: samplers.Kawar(sigma_y=0.1, sigma_min=0.2), "sigma_min 0.2 is above sigma_y"),
    ],
)
def test_settings_are_refused_in_a_sentence(make, words):
    with pytest.raises(ValueError, match=words):
        make()


RUNS = {
    "split gibbs": samplers.SplitGibbs(),
    "daps": samplers.DAPS(),
    "dps": samplers.DPS(),
    "kawar": samplers.Kawar(),
    "snips": samplers.SNIPS(),
}


@pytest.mark.parametrize("name", RUNS)
def test_another_perturbation_is_refused(name):
    kind, camera = "signal", models.Poisson(50)
    if name == "snips":
        kind, camera = "poisson", models.Gaussian(0.1)
    likelihood = models.LinearLikelihood(models.Identity((3,)), camera)
    prior = models.PixelPrior.gamma(3.0, 20.0, (3,), perturbation=kind)
    post = ps.Problem(likelihood, prior).condition(np.array([0.1, 0.2, 0.3]))
    with pytest.raises(ValueError, match=f"'{kind}' perturbation: give"):
        RUNS[name].init(jax.random.key(0), post)


def test_the_stochastic_denoiser_refuses_other_optics():
    likelihood = models.LinearLikelihood(models.Matrix(np.eye(3)), models.Gaussian(0.1))
    post = ps.Problem(likelihood, models.GaussianPrior(0.5, 0.04, (3,))).condition(np.zeros(3))
    with pytest.raises(ValueError, match="Matrix optics: Kawar denoises the picture itself"):
        samplers.Kawar().init(jax.random.key(0), post)


@pytest.mark.parametrize("kind", [samplers.Kawar, samplers.AnnealedLangevin])
def test_a_warmup_does_not_shift_the_draws(kind):
    """Every draw is the end of a whole run, whatever number of warm-up steps is asked for."""
    post, sampler = denoising(), kind(levels=4, steps=3)
    straight, warmed = (draw(post, sampler, 4, draws=2, warmup=steps) for steps in (0, 7))
    np.testing.assert_array_equal(straight, warmed)


def test_draws_start_anew_from_a_given_start():
    """The level of the first step is the broadest one again, about the start."""
    post = denoising()
    for sampler in RUNS.values():
        state = sampler.init(jax.random.key(0), post, jnp.full(post.shape, 0.7))
        np.testing.assert_array_equal(state.origin, jnp.full(post.shape, 0.7))
        x, level = sampler.restarted(jax.random.key(1), state), state.sigmas[0]
        assert 0.01 * level < np.std(x - 0.7) < 3 * level
