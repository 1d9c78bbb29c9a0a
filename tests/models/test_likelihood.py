"""Every likelihood proves itself: gradients, unbiased scores, the Fisher identity, batches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from posterior import models
from posterior.models.realview import from_real, to_real

RNG = np.random.default_rng(0)
MATRIX = RNG.standard_normal((7, 5)) / 2
COMPLEX_MATRIX = (RNG.standard_normal((7, 5)) + 1j * RNG.standard_normal((7, 5))) / 3
POSITIVE_MATRIX = RNG.uniform(0.05, 0.2, (7, 5))

# name: (likelihood, an object)
CASES = {
    "linear, gaussian": lambda: (
        models.LinearLikelihood(models.Matrix(MATRIX), models.Gaussian(0.1)),
        RNG_OBJECT.real,
    ),
    "linear, gaussian, complex": lambda: (
        models.LinearLikelihood(models.Matrix(COMPLEX_MATRIX), models.Gaussian(0.1)),
        RNG_OBJECT,
    ),
    "linear, counts": lambda: (
        models.LinearLikelihood(models.Matrix(POSITIVE_MATRIX), models.Poisson(100)),
        jnp.abs(RNG_OBJECT),
    ),
    "linear, 4 bits": lambda: (
        models.LinearLikelihood(models.Identity((5,)), models.Poisson(100, bits=4)),
        jnp.abs(RNG_OBJECT) / 2,
    ),
    "linear, read noise": lambda: (
        models.LinearLikelihood(models.Identity((5,)), models.PoissonGaussian(100, 2.0, bits=8)),
        jnp.abs(RNG_OBJECT) / 2,
    ),
    "intensity, counts": lambda: (
        models.IntensityLikelihood(models.Fourier((5,), oversampling=2), models.Poisson(100)),
        RNG_OBJECT / 2,
    ),
    "intensity, counts, real": lambda: (
        models.IntensityLikelihood(models.Fourier((5,), oversampling=2), models.Poisson(100)),
        RNG_OBJECT.real / 2,
    ),
    "intensity, 8 bits, irradiance": lambda: (
        models.IntensityLikelihood(
            models.Matrix(COMPLEX_MATRIX), models.Poisson(500, bits=8), np.linspace(0.2, 0.5, 7)
        ),
        RNG_OBJECT / 2,
    ),
    "intensity, counts, background": lambda: (
        models.IntensityLikelihood(
            models.Matrix(COMPLEX_MATRIX), models.Poisson(100), 0.3, np.linspace(0, 0.2, 7)
        ),
        RNG_OBJECT / 2,
    ),
    "intensity, gaussian": lambda: (
        models.IntensityLikelihood(models.Fourier((5,)), models.Gaussian(0.05)),
        RNG_OBJECT,
    ),
}
RNG_OBJECT = jnp.asarray(
    np.array([0.5, 0.9, 0.4, 0.7, 0.6]) * np.exp(1j * np.array([0.1, 1.0, -2.0, 3.0, 0.5]))
)


def case(name):
    likelihood, x = CASES[name]()
    return likelihood, x.astype(jnp.complex128 if jnp.iscomplexobj(x) else jnp.float64)


# Every electron that a reading may come from: twice as dear as all others, and in test_camera too.
EACH = [pytest.param(n, marks=[pytest.mark.slow] if "read noise" in n else []) for n in CASES]


@pytest.mark.parametrize("name", EACH)
def test_score_against_finite_differences(x64, name):
    likelihood, x = case(name)
    y = likelihood.simulate(jax.random.key(1), x)
    v, h = to_real(x), 1e-5
    log_prob = jax.jit(jax.vmap(lambda v: likelihood.log_prob(from_real(v, x.shape, x.dtype), y)))
    steps = h * jnp.eye(len(v))
    expected = (log_prob(v + steps) - log_prob(v - steps)) / (2 * h)
    found = to_real(jax.jit(lambda x: likelihood.score(x, y))(x))
    np.testing.assert_allclose(found, expected, atol=1e-5 * max(1.0, np.abs(found).max()))


@pytest.mark.parametrize("name", EACH)
def test_score_has_mean_zero_and_variance_fisher(x64, name):
    """E[score] = 0 and E[score_i^2] = -E[d score_i/dx_i], under the likelihood's own simulator."""
    likelihood, x = case(name)
    count = 4000

    @jax.jit
    @jax.vmap
    def score_and_curvature(key):
        y = likelihood.simulate(key, x)

        def score(v):
            return to_real(likelihood.score(from_real(v, x.shape, x.dtype), y))

        return score(to_real(x)), -jnp.diagonal(jax.jacfwd(score)(to_real(x)))

    scores, curvature = score_and_curvature(jax.random.split(jax.random.key(2), count))
    scores, curvature = np.asarray(scores), np.asarray(curvature)
    error = scores.std(0) / np.sqrt(count)
    assert np.abs(scores.mean(0) / error).max() < 4
    difference = scores**2 - curvature
    error = difference.std(0) / np.sqrt(count)
    assert np.abs(difference.mean(0) / error).max() < 4


def test_a_wrong_full_well_fails_the_same_identities(x64):
    """The test of the test: a simulator 10 % brighter than the likelihood believes."""
    likelihood, x = case("linear, counts")
    keys = jax.random.split(jax.random.key(2), 4000)
    data = jax.vmap(lambda k: likelihood.simulate(k, 1.1 * x))(keys)
    scores = np.asarray(jax.vmap(lambda y: likelihood.score(x, y))(data))
    z = scores.mean(0) / (scores.std(0) / np.sqrt(len(scores)))
    assert np.abs(z).max() > 4


@pytest.mark.parametrize("name", EACH)
def test_a_batch_changes_nothing(x64, name):
    likelihood, x = case(name)
    y = likelihood.simulate(jax.random.key(1), x)
    batch = jnp.stack([x, 1.1 * x, 0.9 * x])
    score = jax.jit(lambda x: likelihood.score(x, y))
    together = jax.jit(jax.vmap(score))(batch)
    apart = jnp.stack([score(x) for x in batch])
    np.testing.assert_allclose(together, apart, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("path", ["split", "convolved"])
@pytest.mark.parametrize("name", ["linear, gaussian", "linear, gaussian, complex"])
def test_annealed_score_of_gaussian_noise_is_closed_form(x64, name, path):
    likelihood, x = case(name)
    y = likelihood.simulate(jax.random.key(1), x)
    matrix = likelihood.optics.matrix
    part = 4 if jnp.iscomplexobj(x) else 1
    norms = jnp.sum(jnp.abs(matrix) ** 2, axis=1)
    sigma = 0.05 / jnp.sqrt(norms.max())
    sign = -1 if path == "split" else 1
    variance = 0.1**2 + sign * sigma**2 * norms / part
    expected = matrix.conj().T @ ((y - matrix @ x) / variance)
    found = likelihood.annealed_score(x, y, sigma, path)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.parametrize("path", ["split", "convolved"])
def test_annealed_score_of_counts_ends_at_the_exact_score(x64, path):
    likelihood, x = case("linear, counts")
    y = likelihood.simulate(jax.random.key(1), x)
    found = likelihood.annealed_score(x, y, 1e-9, path)
    np.testing.assert_allclose(found, likelihood.score(x, y), rtol=1e-6)


@pytest.mark.parametrize("electrons", [1.0, 4.0, 15.0])
def test_few_counts_pull_neither_up_nor_down_if_the_light_is_known(x64, electrons):
    """E[annealed score] = 0 over annealing errors as large as the noise, and counts.

    With the noise of the perturbed light in place of that of the light, it is not.
    """
    n, full_well = 200_000, 25
    light = jnp.full(n, electrons / full_well)
    likelihood = models.LinearLikelihood(models.Identity((n,)), models.Poisson(full_well))
    y = jnp.asarray(np.random.default_rng(0).poisson(electrons, n) / full_well)
    sigma = jnp.sqrt(electrons) / full_well
    x = light + sigma * jax.random.normal(jax.random.key(1), (n,))
    found = likelihood.annealed_score(x, y, sigma, clean=light)
    assert abs(found.mean()) < 4 * found.std() / np.sqrt(n)
    biased = likelihood.annealed_score(x, y, sigma)
    assert biased.mean() > 10 * biased.std() / np.sqrt(n)


@pytest.mark.parametrize("x", [0.03, 0.4, 0.97])
def test_annealed_score_by_the_signal_dependent_error_ends_at_the_exact_score(x64, x):
    likelihood = models.LinearLikelihood(models.Identity((4,)), models.Poisson(50))
    x, y = jnp.full(4, x), jnp.asarray([0.0, 1.0, 7.0, 40.0]) / 50
    found = likelihood.annealed_score(x, y, 1e-9, perturbation="signal")
    np.testing.assert_allclose(found, likelihood.score(x, y), rtol=1e-6)


@pytest.mark.parametrize(
    "name", ["intensity, counts", "intensity, counts, real", "intensity, counts, background"]
)
def test_annealed_score_of_intensities_ends_at_the_exact_score(x64, name):
    likelihood, x = case(name)
    y = likelihood.simulate(jax.random.key(1), x)
    assert y.max() < 1, "a saturated pixel has another score"
    found = likelihood.annealed_score(x, y, 1e-9, "convolved")
    np.testing.assert_allclose(found, likelihood.score(x, y), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("camera", [models.Poisson(100), models.Poisson(100, 4)])
def test_a_saturated_pixel_says_only_that_it_is_bright(x64, camera):
    """Against the exact tail, in units of 1/sd; a clipped value taken as it is would err by 3."""
    x, y = jnp.linspace(0.9, 1.5, 7), jnp.ones(7)
    linear = models.LinearLikelihood(models.Identity((7,)), camera)
    sd = camera.sigma0 * jnp.sqrt(x)
    error = (linear.annealed_score(x, y, 1e-6) - linear.score(x, y)) * sd
    assert jnp.abs(error).max() < 0.08
    assert jnp.abs(linear.score(x, y)[-1] * sd[-1]) < 1e-3
    intensity = models.IntensityLikelihood(models.Identity((7,)), camera)
    field = jnp.sqrt(x) * np.exp(0.3j)
    error = (intensity.annealed_score(field, y, 1e-6) - intensity.score(field, y)) * sd / 2
    assert jnp.abs(error).max() < 0.08


def test_background_is_light_beside_that_of_the_object(x64):
    """Against scipy's counts; an amplitude is of the light that is left."""
    background = np.array([0.0, 0.1, 0.5])
    camera, optics = models.Poisson(100), models.Identity((3,))
    likelihood = models.IntensityLikelihood(optics, camera, 0.4, background)
    x, y = jnp.asarray([0.6 + 0.2j, 0.9j, 0.3]), np.array([0.2, 0.45, 0.49])
    light = 0.4 * np.abs(x) ** 2 + background
    np.testing.assert_allclose(likelihood.expected(x), light, rtol=1e-12)
    expected = stats.poisson.logpmf(np.rint(100 * y), 100 * light).sum()
    np.testing.assert_allclose(likelihood.log_prob(x, y), expected, rtol=1e-10)
    found = likelihood.amplitude(y)
    np.testing.assert_allclose(found, np.sqrt([0.2 / 0.4, 0.35 / 0.4, 0]), rtol=1e-12)


def test_amplitudes_beside_a_background_have_the_noise_of_all_counts(x64):
    """Of 4e4 simulated sqrt(y - background), to 4 sd of their variance and its second order."""
    camera, optics = models.Poisson(10000), models.Identity((2,))
    likelihood = models.IntensityLikelihood(optics, camera, 1.0, np.array([0.05, 0.4]))
    x = jnp.asarray([0.5, 0.6])
    draws = jax.vmap(lambda key: likelihood.simulate(key, x))(
        jax.random.split(jax.random.key(0), 40000)
    )
    found = np.asarray(jax.vmap(likelihood.amplitude)(draws)).var(axis=0)
    variance, _ = likelihood.noise(False, likelihood.expected(x))
    np.testing.assert_allclose(found, variance, rtol=4 * np.sqrt(2 / 40000) + 0.001)


@pytest.mark.parametrize("x64_object", [0.7 + 0.2j])
def test_annealed_score_of_a_complex_pixel_is_the_marginal_of_the_model(x64, x64_object):
    """y = |o~ + rest|^2 exactly, rest of variance (sigma_0^2 - sigma_t^2)/4 (eq:relaxed...)."""
    likelihood = models.IntensityLikelihood(models.Identity((1,)), models.Poisson(100))
    x, y, sigma = jnp.asarray([x64_object]), jnp.asarray([0.6]), 0.06
    variance = jnp.asarray((0.1**2 - sigma**2) / 4)
    expected = models.annealing.intensity_score(x, y, variance)
    found = likelihood.annealed_score(x, y, sigma, "split")
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_signal_annealing_is_for_counts_of_the_picture_itself(x64):
    likelihood, x = case("linear, counts")
    y = likelihood.simulate(jax.random.key(1), x)
    with pytest.raises(ValueError, match="Identity optics"):
        likelihood.annealed_score(x, y, 0.1, perturbation="signal")


@pytest.mark.parametrize("name", CASES)
def test_float32_stays_float32_and_finite(name):
    likelihood, x = CASES[name]()
    x = x.astype(jnp.complex64 if jnp.iscomplexobj(x) else jnp.float32)
    y = likelihood.simulate(jax.random.key(1), x)

    @jax.jit
    def values(x, y):
        annealed = [likelihood.annealed_score(x, y, 0.02, path) for path in ("split", "convolved")]
        return likelihood.log_prob(0 * x, y), likelihood.score(x, y), *annealed

    in_the_dark, *scores = values(x, y)
    for value in scores:
        assert value.dtype == x.dtype
        assert np.all(np.isfinite(value))
    assert np.isfinite(in_the_dark)


def test_new_data_do_not_recompile():
    traces = []

    @eqx.filter_jit
    def score(likelihood, x, y):
        traces.append(1)
        return likelihood.score(x, y)

    likelihood, x = CASES["intensity, 8 bits, irradiance"]()
    for i in range(3):
        y = likelihood.simulate(jax.random.key(i), x)
        score(likelihood, x, y)
    assert len(traces) == 1


def test_a_complex_field_before_a_counting_camera_is_refused():
    likelihood = models.LinearLikelihood(models.Fourier((4,)), models.Poisson(100))
    with pytest.raises(ValueError, match="IntensityLikelihood"):
        likelihood.expected(jnp.ones(4))


def with_background(background):
    return models.IntensityLikelihood(models.Identity((2,)), models.Poisson(9), 1.0, background)


@pytest.mark.parametrize(
    "build, sentence",
    [
        (lambda: models.IntensityLikelihood(models.Identity((2,)), models.Poisson(9), -1.0), "-1"),
        (lambda: with_background(-0.1), "background -0.1: it must be finite, and 0 or more"),
        (lambda: with_background([0.1, np.nan]), "background nan"),
        (lambda: with_background(np.zeros(3)), r"background of shape \(3,\) for data of shape"),
        (lambda: models.LinearLikelihood(models.Poisson(9), models.Poisson(9)), "optics is a"),
        (lambda: models.LinearLikelihood(models.Identity((2,)), 100.0), "camera is a float"),
    ],
)
def test_bad_parts_are_one_sentence(build, sentence):
    with pytest.raises(ValueError, match=sentence):
        build()
