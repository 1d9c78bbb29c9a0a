"""Quasi-Newton: closed forms, gradients that vanish, and starts that are told or refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from known import linear_gaussian
from posterior import models
from posterior.diagnostics import align
from posterior.estimators import default_start, maximum_likelihood, maximum_posterior
from posterior.estimators.quasi_newton import bright_fields, minimised


def vector(o):
    o = np.asarray(o).ravel()
    return np.concatenate([o.real, o.imag]) if np.iscomplexobj(o) else o


def microscope(camera=None, size=16):
    """An object of amplitude 0.5 to 1 and its likelihood: 25 LEDs, of which nine bright fields."""
    steps = 2 * (np.arange(5) - 2)
    centres = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    optics = models.FourierPtychography.from_radius((size, size), centres, 3.3, 1)
    camera = models.Gaussian(0.01) if camera is None else camera
    likelihood = models.IntensityLikelihood(optics, camera, 0.6)
    rough = np.random.default_rng(0).random((2, size, size))
    smooth = np.fft.ifft2(np.fft.fft2(rough) * lowpass(size, 6)).real
    smooth = (smooth - smooth.min()) / np.ptp(smooth)
    return jnp.asarray((0.5 + 0.5 * smooth[0]) * np.exp(1j * smooth[1])), likelihood


def lowpass(size, radius):
    return np.hypot(*np.meshgrid(*[size * np.fft.fftfreq(size)] * 2)) < radius


# ---- closed forms --------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [pytest.param(float, marks=pytest.mark.slow), complex])
def test_the_maximum_of_a_linear_gaussian_posterior_is_its_mean(x64, dtype):
    posterior, mean, _ = linear_gaussian(5, 4, dtype)
    found = maximum_posterior(posterior, tolerance=1e-12)
    np.testing.assert_allclose(vector(found.object), mean, atol=1e-8)
    assert found.object.dtype == posterior.dtype
    np.testing.assert_allclose(found.log_prob, posterior.log_prob(found.object), rtol=1e-12)


@pytest.mark.parametrize("dtype", [float, complex])
def test_the_maximum_of_a_linear_gaussian_likelihood_is_least_squares(x64, dtype):
    posterior, _, _ = linear_gaussian(4, 7, dtype)
    matrix = posterior.likelihood.optics.matrix
    found = maximum_likelihood(posterior.likelihood, posterior.y, tolerance=1e-12)
    exact = np.linalg.lstsq(matrix, posterior.y)[0]
    np.testing.assert_allclose(found.object, exact, atol=1e-8)


def test_weights_count_measurements_as_often(x64):
    posterior, _, _ = linear_gaussian(4, 7, float)
    matrix = posterior.likelihood.optics.matrix
    weights = np.array([1, 2, 0, 3, 1, 1, 2])
    found = maximum_likelihood(posterior.likelihood, posterior.y, weights=weights, tolerance=1e-12)
    exact = np.linalg.lstsq(np.repeat(matrix, weights, 0), np.repeat(posterior.y, weights))[0]
    np.testing.assert_allclose(found.object, exact, atol=1e-8)


def test_the_most_probable_light_is_what_was_counted(x64):
    likelihood = models.LinearLikelihood(models.Identity((6,)), models.Poisson(1000))
    y = np.array([0.004, 0.02, 0.1, 0.3, 0.5, 0.9])
    found = maximum_likelihood(likelihood, y, start=np.full(6, 0.4), tolerance=1e-9)
    np.testing.assert_allclose(found.object, y, rtol=1e-6)


# ---- phases --------------------------------------------------------------------------------------


def test_ptychography_without_noise_is_exact(x64):
    o, likelihood = microscope()
    band = lowpass(16, 6)  # what the pupils hold between them
    o = jnp.fft.ifft2(jnp.fft.fft2(o) * band)
    y = likelihood.expected(o)
    found = maximum_likelihood(likelihood, y, iterations=2000, tolerance=1e-11)
    aligned = align(np.asarray(found.object), np.asarray(o), ["global_phase"])
    np.testing.assert_allclose(np.fft.fft2(aligned) * band, np.fft.fft2(o), atol=1e-6)


@pytest.mark.slow
def test_the_gradient_vanishes_where_it_ends(x64):
    """On the exact likelihood of 6-bit counts, with a prior."""
    o, likelihood = microscope(models.Poisson(400, bits=6))
    y = likelihood.simulate(jax.random.key(0), o)
    prior = models.GaussianPrior(np.zeros(512), 0.5, (16, 16), complex)
    posterior = ps.Problem(likelihood, prior).condition(y)
    start = default_start(likelihood, y)
    found = maximum_posterior(posterior, iterations=3000, tolerance=1e-8)
    steepness = [np.linalg.norm(posterior.score(x)) for x in (start, found.object)]
    assert steepness[1] < 1e-8 * steepness[0]
    np.testing.assert_allclose(found.gradient, steepness[1] / steepness[0], rtol=1e-6)
    assert found.log_prob > posterior.log_prob(o)
    assert 10 < found.iterations < 3000


@pytest.mark.slow
def test_single_precision_ends_where_double_does():
    def ascend(iterations):
        o, likelihood = microscope(models.Poisson(400))
        y = np.asarray(likelihood.simulate(jax.random.key(0), o))
        found = maximum_likelihood(likelihood, y, iterations=iterations)
        return found.object.dtype, float(found.log_prob)

    dtype, log_prob = ascend(400)
    with jax.enable_x64(True):
        exact_dtype, exact = ascend(3000)
    assert (dtype, exact_dtype) == (jnp.complex64, jnp.complex128)
    # One nat in 256 pixels: far below what the noise leaves open.
    assert abs(log_prob - exact) < 1


def test_a_real_start_gives_a_real_object(x64):
    optics = models.Fourier((6, 6), oversampling=2)
    likelihood = models.IntensityLikelihood(optics, models.Gaussian(0.01))
    rng = np.random.default_rng(0)
    o = rng.random((6, 6))
    start = o + 0.02 * rng.standard_normal(o.shape)
    y = likelihood.expected(jnp.asarray(o))
    found = maximum_likelihood(likelihood, y, start, iterations=1000, tolerance=1e-11)
    assert found.object.dtype == float
    np.testing.assert_allclose(found.object, o, atol=1e-6)


def climbed(cost, start, iterations=300):
    """By L-BFGS in single precision, to a gradient of 1e-6."""
    run = jax.jit(lambda v: minimised(jax.value_and_grad(cost), v, iterations, 1e-6, 10))
    return run(jnp.asarray(start, "float32"))


def test_a_history_that_leads_nowhere_is_forgotten():
    """Beside the poles of -log v^2 + 3 v^2, least at v^2 = 1/3, two steps leave a useless one."""
    _, state = climbed(lambda v: jnp.sum(3 * v**2 - jnp.log(v**2)), [1e-5, 2.0, -1e-4, 5.0])
    assert abs(float(state.value) - 4 * (1 + np.log(3))) < 1e-5


def test_it_ends_where_rounding_leaves_no_step_down():
    counts = jnp.array([0.0, 50.0, 1000.0, 3.0])

    def cost(v):
        return jnp.sum(100 * v**2 - counts * jnp.log(v**2 + 1e-6))

    v, state = climbed(cost, [1.0, 1e-3, 0.1, -2.0])
    np.testing.assert_allclose(v**2, counts / 100, rtol=1e-3, atol=1e-5)
    assert state.failed_linesearch and state.iter_num < 100


def test_iterations_are_a_limit(x64):
    posterior, _, _ = linear_gaussian(5, 4, float)
    found = maximum_posterior(posterior, iterations=2, tolerance=0)
    assert found.iterations == 2
    more = maximum_posterior(posterior, iterations=4, tolerance=0)
    assert more.log_prob > found.log_prob


# ---- starts --------------------------------------------------------------------------------------


def test_the_start_of_ptychography_is_the_bright_field_amplitude(x64):
    """A slow amplitude passes every bright-field pupil as it is; dark fields are left out."""
    _, likelihood = microscope()
    wave = 0.7 + 0.1 * np.cos(2 * np.pi * np.arange(16) / 16)
    o = jnp.asarray(np.outer(wave, np.ones(16)) + 0j)
    start = default_start(likelihood, likelihood.expected(o))
    assert start.dtype == complex and start.shape == (16, 16)
    np.testing.assert_allclose(start, o, atol=0.03)


def test_the_start_is_brought_to_the_pixels_of_the_object(x64):
    optics = models.FourierPtychography.from_radius((24, 24), [[0, 0]], 3.5, 3)
    likelihood = models.IntensityLikelihood(optics, models.Gaussian(0.1), 2.0)
    phase = 2 * np.pi * np.arange(24) / 24
    o = 1 + 0.2 * np.add.outer(np.cos(phase), np.sin(2 * phase))
    start = default_start(likelihood, likelihood.expected(jnp.asarray(o)))
    np.testing.assert_allclose(start, o, atol=1e-12)


def test_without_bright_fields_all_images_serve():
    optics = models.FourierPtychography.from_radius((16, 16), [[5, 0], [-5, 0]], 2, 2)
    likelihood = models.IntensityLikelihood(optics, models.Gaussian(0.1))
    start = default_start(likelihood, np.full((2, 8, 8), 0.25))
    np.testing.assert_allclose(start, 0.5, atol=1e-6)


# ---- refusals ------------------------------------------------------------------------------------


def refused(match, *arguments, find=maximum_likelihood, **settings):
    with pytest.raises(ValueError, match=match) as caught:
        find(*arguments, **settings)
    assert "\n" not in str(caught.value)


def test_bad_input_is_refused():
    o, likelihood = microscope()
    y = likelihood.expected(o)
    start = np.ones((16, 16), complex)
    refused("data of shape", likelihood, y[:3])
    refused("not finite", likelihood, np.full(y.shape, np.nan))
    refused("start of shape", likelihood, y, start[:3])
    start[3, 4] = np.nan
    refused("start holds 1 values that are not finite", likelihood, y, start)
    refused("iterations 0", likelihood, y, iterations=0)
    refused("history 1.5", likelihood, y, history=1.5)
    refused("tolerance 1", likelihood, y, tolerance=1)
    refused("weights from -1 to -1", likelihood, y, weights=-1)
    refused("weights from 0 to 0", likelihood, y, weights=0)
    refused(r"weights of shape \(2,\)", likelihood, y, weights=np.ones(2))
    refused("likelihood is a int", 3, y)


def test_what_gives_no_start_is_refused():
    optics = models.Fourier((6, 6), oversampling=2)
    likelihood = models.IntensityLikelihood(optics, models.Gaussian(0.01))
    refused("Fourier optics give no start", likelihood, np.ones((12, 12)))


def test_a_dark_start_under_recorded_light_is_refused():
    likelihood = models.LinearLikelihood(models.Identity((3,)), models.Poisson(100))
    refused("the start is dark", likelihood, np.full(3, 0.5), np.array([0.3, -0.1, 0.3]))
    optics = models.Fourier((3,), oversampling=2)
    likelihood = models.IntensityLikelihood(optics, models.Poisson(100))
    refused("the start is dark", likelihood, np.full(6, 0.5), np.zeros(3))


def test_a_complex_start_of_a_real_object_is_refused():
    posterior, _, _ = linear_gaussian(5, 4, float)
    refused("start is complex", posterior, np.ones(5, complex), find=maximum_posterior)


def test_leds_inside_the_pupil_are_bright_fields():
    """Those whose centre lies less than the radius from the axis, 3.3 samples here."""
    _, likelihood = microscope()
    centres = np.asarray(likelihood.optics.centres)
    inside = np.linalg.norm(centres, axis=1) < 3.3
    np.testing.assert_array_equal(bright_fields(likelihood.optics), inside)
    assert inside.sum() == 9
