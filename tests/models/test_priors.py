"""Analytic priors: density and score at every annealing level against independent forms."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from analytic import wiener

from posterior.models import priors
from posterior.models.priors.perturbation import perturbed
from posterior.models.realview import from_real, to_real

SIGMAS = [0.0, 0.05, 0.7, 5.0]


def mixture_parts(dtype):
    rng = np.random.default_rng(0)
    n = 6 if dtype is complex else 3
    roots = rng.standard_normal((3, n, n))
    covariances = roots @ np.swapaxes(roots, 1, 2) / n + 0.05 * np.eye(n)
    return [0.5, 0.3, 0.2], rng.standard_normal((3, n)), covariances


def mixture(dtype):
    return priors.GaussianMixture(*mixture_parts(dtype), (3,), dtype)


def field(dtype, shape=(4, 6)):
    rows, cols = np.meshgrid(*(np.fft.fftfreq(n) for n in shape), indexing="ij")
    power = 0.1 + 1 / (0.05 + rows**2 + cols**2)
    mean = 0.3 + (0.2j if dtype is complex else 0)
    return priors.GaussianField(power, mean, dtype=dtype)


def gaussian(dtype):
    n = 6 if dtype is complex else 3
    root = np.random.default_rng(1).standard_normal((n, n))
    return priors.Gaussian(np.arange(n), root @ root.T + 0.1 * np.eye(n), (3,), dtype)


def isotropic(dtype):
    weights, means, _ = mixture_parts(dtype)
    return priors.GaussianMixture(weights, means, [0.3, 0.1, 0.7], (3,), dtype)


GAUSSIANS = {"mixture": mixture, "isotropic": isotropic, "field": field, "gaussian": gaussian}


@pytest.mark.parametrize("name", GAUSSIANS)
@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("sigma", SIGMAS)
def test_score_is_the_gradient_of_the_density(x64, name, dtype, sigma):
    prior = GAUSSIANS[name](dtype)
    v = to_real(prior.sample(jax.random.key(0)))
    density = jax.jit(
        jax.vmap(lambda v: prior.log_prob(from_real(v, prior.shape, prior.dtype), sigma))
    )
    h = 1e-5
    steps = h * np.eye(len(v))
    expected = (density(v + steps) - density(v - steps)) / (2 * h)
    found = to_real(prior.score(from_real(v, prior.shape, prior.dtype), sigma))
    np.testing.assert_allclose(found, expected, atol=1e-6 * max(np.abs(found).max(), 1.0))


@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("sigma", SIGMAS)
def test_mixture_density_against_scipy(x64, dtype, sigma):
    prior = mixture(dtype)
    s = sigma / 2 if dtype is complex else sigma
    x = prior.sample(jax.random.key(3))
    density = sum(
        w * scipy.stats.multivariate_normal(m, c + s**2 * np.eye(len(m))).pdf(to_real(x))
        for w, m, c in zip(*mixture_parts(dtype))
    )
    np.testing.assert_allclose(prior.log_prob(x, sigma), np.log(density), rtol=1e-9)


@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("sigma", SIGMAS)
def test_field_density_against_its_dense_covariance(x64, dtype, sigma):
    prior = field(dtype)
    n = int(np.prod(prior.shape))
    basis = np.eye(n).reshape(n, *prior.shape)
    colour = np.fft.ifft2(np.asarray(prior.power) * np.fft.fft2(basis)).real.reshape(n, n)
    s = sigma / 2 if dtype is complex else sigma
    normal = scipy.stats.multivariate_normal(np.zeros(n), colour + s**2 * np.eye(n))
    x = prior.sample(jax.random.key(1))
    rest = np.asarray(x - prior.mean).ravel()
    parts = [rest.real, rest.imag] if dtype is complex else [rest]
    expected = sum(normal.logpdf(p) for p in parts)
    np.testing.assert_allclose(prior.log_prob(x, sigma), expected, rtol=1e-9)


@pytest.mark.parametrize("name", GAUSSIANS)
@pytest.mark.parametrize("dtype", [float, complex])
def test_draws_and_density_are_of_one_law(x64, name, dtype):
    """E[score] = 0 and Stein's identity E[(x_i - E x_i) s_i] = -1, within Monte-Carlo error."""
    prior = GAUSSIANS[name](dtype)
    keys = jax.random.split(jax.random.key(7), 20_000)
    draws = jax.vmap(prior.sample)(keys)
    scores = np.asarray(jax.vmap(lambda x: to_real(prior.score(x)))(draws))
    z = scores.mean(0) / (scores.std(0) / np.sqrt(len(scores)))
    assert np.abs(z).max() < 4.5
    flat = np.asarray(jax.vmap(to_real)(draws))
    products = (flat - flat.mean(0)) * scores
    z = (products.mean(0) + 1) / (products.std(0) / np.sqrt(len(products)))
    assert np.abs(z).max() < 4.5
    spread = np.sqrt(np.mean((flat - flat.mean(0)) ** 2))
    assert abs(float(prior.scale) / spread - 1) < 0.03


def test_field_fitted_to_its_own_draws_finds_its_spectrum(x64):
    def spectrum(shape):
        rows, cols = np.meshgrid(*(np.fft.fftfreq(n) for n in shape), indexing="ij")
        radius = np.hypot(rows, cols)
        return radius, 0.01 / (0.05 + radius) ** 2

    prior = priors.GaussianField(spectrum((64, 64))[1], mean=0.4)
    draws = np.asarray(jax.vmap(prior.sample)(jax.random.split(jax.random.key(0), 64)))
    fitted = priors.GaussianField.fit(list(draws), (48, 80))
    radius, power = spectrum((48, 80))
    inside = (radius > 0.05) & (radius < 0.45)
    ratio = np.asarray(fitted.power)[inside] / power[inside]
    # A ring of 64 pictures has at least 64 * 2 * 3 degrees of freedom; the window blurs by 2 %.
    assert np.abs(ratio - 1).max() < 4 * np.sqrt(2 / 384) + 0.02
    assert fitted.shape == (48, 80)


def folded_log_density(z, sigma):
    """Of |x + sqrt(x) e|, x ~ gamma(3, 4), by a dense integral at each value of `z`."""
    clean = np.geomspace(1e-8, 12, 400_001)
    density = scipy.stats.gamma(3.0, scale=0.25).pdf(clean)
    sd = sigma * np.sqrt(clean)
    kernels = [sum(scipy.stats.norm.pdf(s, clean, sd) for s in (value, -value)) for value in z]
    return np.log([np.trapezoid(density * kernel, clean) for kernel in kernels])


@pytest.mark.parametrize("sigma", [0.0, 3.0])
def test_an_isotropic_mixture_is_a_mixture_of_round_covariances(sigma):
    """Far modes in single precision, where distances could be differences of large numbers."""
    rng = np.random.default_rng(0)
    weights, means, variances = [0.5, 0.3, 0.2], 35 * rng.standard_normal((3, 200)), [1.0, 0.5, 2.0]
    round_ = np.asarray(variances)[:, None, None] * np.eye(200)
    found = priors.GaussianMixture(weights, means, variances, (200,))
    expected = priors.GaussianMixture(weights, means, round_, (200,))
    for i in range(4):
        x = expected.sample(jax.random.key(i))
        np.testing.assert_allclose(found.sample(jax.random.key(i)), x, rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(found.log_prob(x, sigma), expected.log_prob(x, sigma), rtol=1e-5)
        scores = found.score(x, sigma), expected.score(x, sigma)
        np.testing.assert_allclose(*scores, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("sigma", [0.01, 0.05, 0.3, 1.0, 2.0])
def test_pixel_prior_against_a_dense_integral_of_the_folded_density(x64, sigma):
    """To the table's error, linear in 4001 cells of sqrt(x): at z = 0.001 4e-5, 2e-4 if finest."""
    z = np.asarray([0.001, 0.02, 0.5, 1.3, 4.0])
    prior, h = priors.PixelPrior.gamma(3.0, 4.0, (1,)), 1e-4 * z
    below, centre, above = (folded_log_density(z + step, sigma) for step in (-h, 0 * h, h))
    found = jax.vmap(lambda z: prior.log_prob(z, sigma))(z[:, None])
    np.testing.assert_allclose(found, centre, atol=4e-4 if sigma == 0.01 else 5e-5)
    slope = (above - below) / (2 * h)
    found = jax.vmap(lambda z: prior.score(z, sigma)[0])(z[:, None])
    np.testing.assert_allclose(found, slope, rtol=1e-3 if sigma == 0.01 else 5e-5, atol=1e-5)


def test_pixel_prior_without_the_fold_would_be_wrong_by_what_the_fold_says(x64):
    """At sigma = 1 the score of the unfolded variable is higher by 1 - tanh(z): 0.9 at z = 0.1."""
    z = np.asarray([0.1, 0.3])
    prior, clean = priors.PixelPrior.gamma(3.0, 4.0, (2,)), np.geomspace(1e-8, 12, 400_001)
    density = scipy.stats.gamma(3.0, scale=0.25).pdf(clean)
    kernel = density * scipy.stats.norm.pdf(z[:, None], clean, np.sqrt(clean))
    unfolded = 1 - z * np.trapezoid(kernel / clean, clean) / np.trapezoid(kernel, clean)
    found = unfolded - prior.score(jnp.asarray(z), 1.0)
    np.testing.assert_allclose(found, 1 - np.tanh(z), atol=1e-3)
    assert found.min() > 0.7


@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.3, 1.0])
def test_pixel_prior_score_is_the_gradient_of_its_density(x64, sigma):
    x = np.asarray([0.02, 0.11, 0.4, 0.73, 1.21, 2.0])
    # The quadrature's nodes slide over the table's corners: a wide step does not see them.
    prior, h = priors.PixelPrior.gamma(3.0, 4.0, (6,)), (1e-2 if sigma else 1e-5) * x
    steps = np.diag(h)
    density = jax.vmap(lambda x: prior.log_prob(x, sigma))
    expected = (density(x + steps) - density(x - steps)) / (2 * h)
    found = prior.score(jnp.asarray(x), sigma)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-3)


def test_pixel_prior_pulls_back_from_far_outside_its_table(x64):
    """Where no node of the quadrature meets the table: 1 to 100 times its end, and under its start.

    Against a dense integral over the table, to the next order of Laplace's method.
    """
    grid = np.linspace(0.5, 1.0, 201)
    prior, sigma = priors.PixelPrior(grid, np.ones(201), (5,)), 0.02
    z = np.asarray([1e-3, 0.02, 2.0, 10.0, 100.0])
    clean = np.linspace(0.5, 1.0, 400_001)
    log_kernel = -((z[:, None] - clean) ** 2) / (2 * sigma**2 * clean) - np.log(clean) / 2
    weight = scipy.special.softmax(log_kernel, axis=1)
    expected = np.sum(weight * (clean - z[:, None]) / (sigma**2 * clean), axis=1)
    # Below zero's neighbourhood the fold has its say, of tanh(z/sigma^2).
    expected += np.asarray(jnp.tanh(z / sigma**2) - 1) / sigma**2
    np.testing.assert_allclose(prior.score(jnp.asarray(z), sigma), expected, rtol=2e-2)


def test_pixel_prior_pulls_back_over_empty_bins(x64):
    """Where the table has no density, at an end or in a gap, it is as if it did not go there."""
    grid, sigma = np.linspace(0.0, 2.0, 201), 0.01
    lit = (grid > 0.495) & (grid < 0.705) | (grid > 1.195) & (grid < 1.305)
    prior = priors.PixelPrior(grid, lit.astype(float), (5,))
    x = np.asarray([0.05, 0.85, 1.05, 1.9, 7.0])
    nearest = np.asarray([0.5, 0.7, 1.2, 1.3, 1.3])
    fold = (np.tanh(x / sigma**2) - 1) / sigma**2
    expected = (nearest - x) / (sigma**2 * nearest) + fold
    np.testing.assert_allclose(prior.score(jnp.asarray(x), sigma), expected, rtol=1e-6)


def test_pixel_prior_folds_at_zero(x64):
    """Nothing below zero, all of it above, and no slope at zero."""
    prior = priors.PixelPrior.gamma(3.0, 4.0, (1,))
    z = jnp.linspace(0.0, 12.0, 801)[:, None]
    density = jnp.exp(jax.vmap(lambda z: prior.log_prob(z, 1.0))(z))
    np.testing.assert_allclose(np.trapezoid(density, z[:, 0]), 1, atol=1e-5)
    assert density[0] > 0.5
    assert np.abs(prior.score(z[0], 1.0)) < 1e-12
    assert prior.log_prob(-z[1], 1.0) == -np.inf
    assert prior.score(-z[9], 1.0) == -prior.score(z[9], 1.0)


@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0])
def test_pixel_prior_score_and_annealed_draws_are_of_one_law(x64, sigma):
    """Integrals of z^k p'(z) over z >= 0: E[score] = -p(0), E[z score] = -1.

    The folded density is not zero at the border, so the former keeps its border term.
    """
    prior = priors.PixelPrior.gamma(3.0, 4.0, (5000,))
    key_picture, key_error = jax.random.split(jax.random.key(5))
    z = perturbed(key_error, prior.sample(key_picture), sigma, "signal", False)
    score = np.asarray(prior.score(z, sigma))
    one = priors.PixelPrior.gamma(3.0, 4.0, (1,))
    border = np.exp(one.log_prob(jnp.zeros(1), sigma))
    for products, expected in ((score, -border), (z * score, -1.0)):
        error = np.std(products) / np.sqrt(z.size)
        assert abs(np.mean(products) - expected) < 4 * error, (np.mean(products), expected, error)
    assert (border > 0.5) == (sigma == 1.0), border


UNEVEN = {
    "even": np.linspace(0.2, 0.9, 77),
    "even in sqrt": np.linspace(0.0, 1.5, 301) ** 2,
    "over six decades": np.geomspace(1e-6, 1.0, 300),
    "of one cell": np.array([0.0, 1.0]),
    "crowded at zero": np.r_[np.linspace(0.0, 0.01, 500), 1.0, 2.0],
    "crowded in the middle": np.r_[0.0, np.linspace(0.5, 0.5 + 1e-4, 400), 1.0],
}


@pytest.mark.parametrize("grid", UNEVEN.values(), ids=UNEVEN)
def test_pixel_prior_finds_its_place_in_any_table(x64, grid):
    """As NumPy's interpolation; with a step fewer, of a crowded table, in another cell."""
    rng = np.random.default_rng(3)
    prior = priors.PixelPrior(grid, rng.random(grid.size), (1,))
    x = np.r_[rng.uniform(-0.1, 1.1 * grid[-1], 5000), grid, (grid[1:] + grid[:-1]) / 2]
    expected = np.interp(x, grid, prior.density, left=0, right=0)
    np.testing.assert_allclose(prior._density(jnp.asarray(x)), expected, rtol=1e-9, atol=1e-12)
    middles = jnp.asarray((grid[1:] + grid[:-1]) / 2)
    np.testing.assert_array_equal(prior.bins.cell(prior.grid, middles), np.arange(grid.size - 1))
    if prior.bins.steps > 2:
        fewer = dataclasses.replace(prior.bins, steps=prior.bins.steps - 1)
        assert np.any(fewer.cell(prior.grid, middles) != np.arange(grid.size - 1))


def test_pixel_prior_draws_follow_the_density(x64):
    prior = priors.PixelPrior.gamma(2.5, 3.0, (20_000,))
    draws = np.asarray(prior.sample(jax.random.key(0)))
    test = scipy.stats.kstest(draws, scipy.stats.gamma(2.5, scale=1 / 3).cdf)
    assert test.pvalue > 1e-3
    # The same test sees a density whose rate is 5 % wrong.
    wrong = scipy.stats.kstest(draws, scipy.stats.gamma(2.5, scale=1.05 / 3).cdf)
    assert wrong.pvalue < 1e-6


def test_pixel_prior_is_finite_in_float32_at_the_ends():
    prior = priors.PixelPrior.gamma(3.0, 4.0, (6,))
    x = jnp.asarray([0.0, 1e-12, 1e-3, 1.0, 50.0, 1e4])
    for sigma in (1e-3, 0.1, 3.0):
        assert np.all(np.isfinite(prior.score(x, sigma)))


@pytest.mark.parametrize("dtype", [float, complex])
def test_a_chain_starts_from_a_draw(dtype):
    prior, key = gaussian(dtype), jax.random.key(2)
    np.testing.assert_array_equal(prior.start(key), prior.sample(key))


@pytest.mark.parametrize("name", GAUSSIANS)
@pytest.mark.parametrize("dtype", [float, complex])
def test_precision_follows_the_switch(name, dtype):
    with jax.enable_x64(False):
        prior = GAUSSIANS[name](dtype)
        x = prior.sample(jax.random.key(0))
        assert x.dtype == (jnp.complex64 if dtype is complex else jnp.float32)
        assert prior.score(x, 0.1).dtype == x.dtype
        assert prior.log_prob(x, 0.1).dtype == jnp.float32


EYE = np.eye(3)
BAD = [
    (lambda: priors.Gaussian(0.0, -1.0, (3,)), "negative eigenvalue -1"),
    (lambda: priors.Gaussian(np.zeros(2), EYE, (3,)), r"\(1, 2\).*\(1, 3\)"),
    (lambda: priors.Gaussian([0, np.nan, 0], EYE, (3,)), "means holds NaN"),
    (lambda: priors.GaussianMixture([1, -1], np.zeros((2, 3)), [EYE, EYE], (3,)), r"\[1.0, -1.0\]"),
    (lambda: priors.GaussianMixture([1], np.zeros((1, 3)), [EYE], (3,), complex), r"\(1, 6\)"),
    (lambda: priors.GaussianMixture([1], np.zeros((1, 3)), [np.triu(EYE + 1)], (3,)), "symmetric"),
    (lambda: priors.GaussianField(np.array([[1.0, 0.0]])), "value 0"),
    (lambda: priors.GaussianField(np.array([[1.0, 2.0, 3.0]])), "power\\(-k\\)"),
    (lambda: priors.GaussianField(np.ones((2, 2)), mean=1j), "complex mean"),
    (lambda: priors.GaussianField.fit(np.ones((16, 16))), "constant"),
    (lambda: priors.GaussianField.fit([np.ones(5)]), r"\(5,\)"),
    (lambda: priors.GaussianField.fit(np.full((16, 16), np.nan)), "picture 0 holds NaN"),
    (lambda: priors.PixelPrior([0, 0.5, 0.4], np.ones(3), (2,)), "increase"),
    (lambda: priors.PixelPrior([0, 1], [0, 0], (2,)), "zero everywhere"),
    (lambda: priors.PixelPrior([0, 1], [1, 1, 1], (2,)), r"\(3,\)"),
    (lambda: field(float).log_prob(jnp.zeros((3, 3))), r"\(3, 3\)"),
    (lambda: field(float).log_prob(jnp.zeros((4, 6), complex)), "complex object"),
]


@pytest.mark.parametrize("build, sentence", BAD)
def test_bad_input_is_one_sentence(build, sentence):
    with pytest.raises(ValueError, match=sentence):
        build()


# ---- stiffness -----------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [float, complex])
def test_stiffness_is_the_largest_precision(x64, dtype):
    _, means, covariances = mixture_parts(dtype)
    gaussian = priors.Gaussian(means[0], covariances[0], (3,), dtype)
    largest = 1 / np.linalg.eigvalsh(covariances[0])[0]
    assert float(gaussian.stiffness) == pytest.approx(largest)


def test_stiffness_of_a_field_is_that_of_its_hessian(x64):
    prior = field(float)
    assert float(prior.stiffness) == pytest.approx(float(priors.Prior.stiffness.fget(prior)))


def test_stiffness_of_a_network_bounds_that_of_what_it_knows(x64):
    """Independent normal pixels of sd 0.25, learnt from 0.001 on."""
    prior = priors.EnergyPrior(wiener("energy"), (3, 3))
    assert prior.stiffness == pytest.approx(1e6)
    assert float(priors.Prior.stiffness.fget(prior)) == pytest.approx(1 / 0.25**2, rel=1e-3)
