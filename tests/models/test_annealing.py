"""Elementwise scores of the annealed variable against independent densities."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

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


def test_bessel_ratio_meets_its_series_without_a_step():
    z = jnp.asarray([0.00999, 0.01001], jnp.float32)
    left, right = annealing._bessel_ratio(z)
    assert abs(left - right) < 4 * np.finfo(np.float32).eps


def test_split_keeps_a_variance_where_the_level_touches_the_noise():
    noise = jnp.asarray([1.0, 2.0])
    left = annealing.remaining_variance(noise, jnp.asarray([1.5, 1.0]), "split")
    np.testing.assert_allclose(left, [1e-3, 1.0], rtol=1e-6)


def test_an_unknown_path_is_refused():
    with pytest.raises(ValueError, match=r"'straight'.*split"):
        annealing.remaining_variance(jnp.ones(1), jnp.ones(1), "straight")
