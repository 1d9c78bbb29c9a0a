"""Elementwise scores of the annealed variable against independent densities."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import logsumexp

from posterior import models
from posterior.models import annealing


def log_density_on_ring(re, im, y, variance):
    """log p(sqrt(y) | o~) by integrating the normal density of the field round the circle."""
    amplitude, sd = np.sqrt(y), np.sqrt(variance)

    def on_circle(angle):
        return stats.norm.pdf(amplitude * np.cos(angle), re, sd) * stats.norm.pdf(
            amplitude * np.sin(angle), im, sd
        )

    peak = np.arctan2(im, re)
    value, _ = integrate.quad(on_circle, peak - np.pi, peak + np.pi, points=[peak], epsabs=0)
    return np.log(value * amplitude)


@pytest.mark.parametrize("field", [0.8 + 0.1j, 0.05 - 0.02j, -0.3 + 0.9j, 1e-4 + 0j])
@pytest.mark.parametrize("y", [0.04, 0.9])
@pytest.mark.parametrize("sigma", [0.3, 1.0])
def test_complex_intensity_score_is_the_slope_of_the_ring_integral(x64, field, y, sigma):
    variance, h = sigma**2 / 4, 1e-4
    re, im = field.real, field.imag

    def slope(dre, dim):
        up = log_density_on_ring(re + dre, im + dim, y, variance)
        return (up - log_density_on_ring(re - dre, im - dim, y, variance)) / (2 * h)

    expected = slope(h, 0) + 1j * slope(0, h)
    found = annealing.intensity_score(jnp.asarray(field), jnp.asarray(y), jnp.asarray(variance))
    # Central differences of h = 1e-4 err by h^2 f'''/6, with f''' of order variance^-1.5.
    np.testing.assert_allclose(found, expected, atol=1e-6 / variance**1.5, rtol=1e-6)


def test_real_intensity_score_is_the_slope_of_the_folded_normal(x64):
    x = jnp.linspace(-1.5, 1.5, 31)
    y, variance = 0.5, 0.04

    def log_folded(x):
        a, sd = jnp.sqrt(y), jnp.sqrt(variance)
        log_pdf = jax.scipy.stats.norm.logpdf
        return jnp.logaddexp(log_pdf(a, x, sd), log_pdf(-a, x, sd))

    expected = jax.vmap(jax.grad(log_folded))(x)
    found = annealing.intensity_score(x, jnp.asarray(y), jnp.asarray(variance))
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


def quadrature_of_counts(field, count, full_well, annealing, background=0.0):
    """log p(N | f~) for radial f~ by brute force: counts of every |f~ + e|^2 + background."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(150)
    e, log_weight = np.sqrt(annealing) * nodes, np.log(np.maximum(weights, 1e-300))
    if np.iscomplexobj(field):
        intensity = (field.real + e[:, None]) ** 2 + (field.imag + e[None, :]) ** 2
        log_weight = log_weight[:, None] + log_weight[None, :]
    else:
        intensity = (field + e) ** 2
    log_pmf = stats.poisson.logpmf(count, full_well * (intensity + background))
    return logsumexp(log_pmf + log_weight)


# Levels at which 150 nodes still resolve the likelihood: noise not far below the annealing error.
@pytest.mark.parametrize("count", [0, 1, 4, 25, 400])
@pytest.mark.parametrize("thermal", [0.2, 1.0, 10.0])
@pytest.mark.parametrize("kind", [complex, float])
def test_counted_score_is_the_slope_of_the_quadrature(x64, count, thermal, kind):
    full_well = 100
    noise, error = 1 / (4 * full_well), thermal / (2 * full_well)
    sd, h = np.sqrt(noise + error), 1e-6
    for amplitude in np.sqrt(np.array([0.3, 1.0, 3.0]) * (count + 1) / full_well):
        field = amplitude * np.exp(0.7j) if kind is complex else amplitude
        direction = field / amplitude
        log_p = [
            quadrature_of_counts(field + step * direction, count, full_well, error)
            for step in (-h, h)
        ]
        expected = (log_p[1] - log_p[0]) / (2 * h)
        found = annealing.counted_intensity_score(
            jnp.asarray(field), jnp.asarray(count / full_well), noise, error
        )
        assert abs(found / direction - expected) * sd < 0.02


@pytest.mark.parametrize("kind", [complex, float])
def test_counted_score_without_annealing_is_that_of_the_counts(x64, kind):
    camera, y = models.Poisson(100), jnp.asarray([0.0, 0.01, 0.5, 1.2])
    field = jnp.asarray([0.2, 0.05, 0.6, 1.0], kind) * (np.exp(0.3j) if kind is complex else 1)
    found = annealing.counted_intensity_score(field, y, camera.sigma0**2 / 4, 0.0)
    expected = 2 * field * camera.full_well * (y / jnp.abs(field) ** 2 - 1)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("dark", [0.3, 3.0, 30.0])
@pytest.mark.parametrize("kind", [complex, float])
def test_counted_score_beside_a_background_is_near_that_of_the_quadrature(x64, dark, kind):
    """By what its docstring says; a background left out errs by 0.3 (0.3 electrons) to 2."""
    full_well, h, errors = 100, 1e-5, []
    noise, background = 1 / (4 * full_well), dark / full_well
    for count, thermal, bright in product([0, 1, 25, 400], [0.2, 1.0, 10.0], [0.3, 1.0, 3.0]):
        error = thermal / (2 * full_well)
        amplitude = np.sqrt(bright * (count + 1) / full_well)
        field = amplitude * np.exp(0.7j) if kind is complex else amplitude
        log_p = [
            quadrature_of_counts(field * (1 + d), count, full_well, error, background)
            for d in (-h, h)
        ]
        at = jnp.asarray(field), jnp.asarray(count / full_well), noise, error
        signal = annealing.signal_count(*at, background)
        found = annealing.counted_intensity_score(at[0], signal, noise, error)
        slope = (log_p[1] - log_p[0]) / (2 * h * amplitude)
        errors.append(abs(found * amplitude / field - slope) * np.sqrt(noise + error))
    assert max(errors) < 0.45
    assert np.sqrt(np.mean(np.square(errors))) < 0.15


def test_bright_counts_have_the_rician_score(x64):
    """Where sqrt(y) has one variance at every brightness: 1e6 electrons."""
    noise, field, y = 0.25e-6, jnp.asarray(0.9 + 0.3j), jnp.asarray(0.9)
    for level in (0.0, 1e-7, 1e-5, 1e-2):
        found = annealing.counted_intensity_score(field, y, noise, level)
        rician = annealing.intensity_score(field, y, noise + level)
        assert abs(found - rician) * np.sqrt(noise + level) < 0.01


def test_signal_score_is_the_slope_of_its_normal_density(x64):
    y, variance = 0.4, 0.02

    def log_density(x):
        return -0.5 * jnp.log(2 * jnp.pi * variance * x) - (y - x) ** 2 / (2 * variance * x)

    x = jnp.linspace(0.05, 2.0, 20)
    found = annealing.signal_score(x, jnp.asarray(y), jnp.asarray(variance))
    np.testing.assert_allclose(found, jax.vmap(jax.grad(log_density))(x), rtol=1e-10)


def test_published_form_is_half_the_score_at_four_times_the_variance(x64):
    """What eq:complex_final says, in terms of the consistent form: the measured trap."""
    field, y = jnp.asarray(0.7 + 0.4j), jnp.asarray(0.5)
    published = annealing.published_intensity_score(field, y, jnp.asarray(0.01))
    consistent = annealing.intensity_score(field, y, jnp.asarray(0.01))
    np.testing.assert_allclose(published, consistent / 2, rtol=1e-12)


@pytest.mark.parametrize("magnitude", [0.0, 1e-30, 1e-3, 1.0, 1e3, 1e10])
def test_scores_are_finite_in_float32(magnitude):
    field = jnp.asarray([magnitude + 0j, 1j * magnitude], jnp.complex64)
    for y in (0.0, 1e-12, 1.0):
        score = annealing.intensity_score(field, jnp.float32(y), jnp.float32(1e-4))
        assert np.all(np.isfinite(score)), (magnitude, y)
        real = annealing.intensity_score(field.real, jnp.float32(y), jnp.float32(1e-4))
        assert np.all(np.isfinite(real)), (magnitude, y)
        for level in (0.0, 1e-12, 1.0):
            for f in (field, field.real):
                counted = annealing.counted_intensity_score(f, jnp.float32(y), 1e-4, level)
                assert np.all(np.isfinite(counted)), (magnitude, y, level)


def testbessel_ratio_meets_its_series_without_a_step():
    z = jnp.asarray([0.00999, 0.01001], jnp.float32)
    left, right = annealing.bessel_ratio(z)
    assert abs(left - right) < 4 * np.finfo(np.float32).eps


def test_split_keeps_a_variance_where_the_level_touches_the_noise():
    noise = jnp.asarray([1.0, 2.0])
    left = annealing.remaining_variance(noise, jnp.asarray([1.5, 1.0]), "split")
    np.testing.assert_allclose(left, [1e-3, 1.0], rtol=1e-6)


def test_an_unknown_path_is_refused():
    with pytest.raises(ValueError, match=r"'straight'.*split"):
        annealing.remaining_variance(jnp.ones(1), jnp.ones(1), "straight")
