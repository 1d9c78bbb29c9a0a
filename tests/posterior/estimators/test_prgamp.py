"""prGAMP: moments by quadrature, its own error on random matrices, and the least error there is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate
from scipy.special import ive

from posterior import models
from posterior.estimators import prgamp
from posterior.estimators.prgamp import field_moments

UNKNOWNS, MEASURED = 200, 1000
WELL, DIM = 160_000, 1 / 16
NOISE = np.sqrt(1 / WELL / DIM) / 2  # of an amplitude


@pytest.mark.parametrize(
    "amplitude, noise, field, variance",
    [(1.0, 0.1, 0.8 + 0.3j, 0.2), (0.3, 0.5, -0.1j, 1.5), (2.0, 0.01, 1.9 + 0j, 0.02)],
)
def test_moments_of_a_field_are_those_by_quadrature(x64, amplitude, noise, field, variance):
    """Over Re and Im of z: normal about `field`, times the Rician likelihood of its modulus."""

    def density(im, re):
        z = re + 1j * im
        prior = np.exp(-(abs(z - field) ** 2) / variance)
        rician = np.exp(-((amplitude - abs(z)) ** 2) / noise) * ive(
            0, 2 * amplitude * abs(z) / noise
        )
        return prior * rician

    half = 7 * np.sqrt(variance / 2)
    grid = np.linspace(-half, half, 601)
    re, im = np.meshgrid(field.real + grid, field.imag + grid, indexing="ij")
    weight = density(im, re)
    # The trapezoid rule of a smooth function that vanishes at the ends.
    total = integrate.trapezoid(integrate.trapezoid(weight))
    mean = integrate.trapezoid(integrate.trapezoid(weight * (re + 1j * im))) / total
    square = integrate.trapezoid(integrate.trapezoid(weight * abs(re + 1j * im) ** 2)) / total
    found, spread = field_moments(*map(jnp.asarray, (amplitude, noise, field, variance)))
    np.testing.assert_allclose(found, mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(spread, square - abs(mean) ** 2, rtol=1e-6)


def random_problem(dtype, seed):
    """White objects of mean 0.5, behind a matrix of independent normal entries; dim light."""
    rng = np.random.default_rng(seed)
    entries = rng.standard_normal((2, MEASURED, UNKNOWNS)) / np.sqrt(2 * UNKNOWNS)
    matrix = entries[0] + 1j * entries[1]
    prior = models.GaussianPrior(0.5, 0.25**2, (UNKNOWNS,), dtype)
    x = np.asarray(prior.sample(jax.random.key(seed)))
    likelihood = models.IntensityLikelihood(models.Matrix(matrix), models.Poisson(WELL), DIM)
    y = likelihood.simulate(jax.random.key(seed + 100), jnp.asarray(x))
    return prior, x, likelihood, y, matrix


# The loop on the host differs by who calls the denoiser: one kind of object is enough for it.
@pytest.mark.parametrize(
    "dtype, host",
    [(float, False), (complex, False), pytest.param(float, True, marks=pytest.mark.slow)],
)
def test_its_error_is_what_it_states_and_the_least_there_is(x64, dtype, host):
    """On random matrices; the least: of the posterior linearised about the truth."""
    parts = 2 if dtype is complex else 1
    ratios, optimal = [], []
    for seed in range(1 if host else 3):
        prior, x, likelihood, y, matrix = random_problem(dtype, seed)
        rng = np.random.default_rng(seed)
        start = x + 0.1 * rng.standard_normal(UNKNOWNS)
        denoiser = prior
        if host:
            denoiser = lambda v, sd, p=prior: np.asarray(p.denoise(jnp.asarray(v), sd))  # noqa: E731
        found = prgamp(
            likelihood, y, jax.random.key(0), start, denoiser, 0.1, iterations=25, damping=0.7
        )
        error = np.asarray(found.object) - x
        if parts == 2:
            # The one direction that the data do not see.
            error -= 1j * x * np.vdot(1j * x, error).real / np.vdot(x, x).real
        square = np.sum(np.abs(error) ** 2) / (parts * UNKNOWNS)
        phase = np.sign(matrix @ x)
        jacobian = np.conj(phase)[:, None] * matrix
        slopes = np.hstack([jacobian.real, -jacobian.imag]) if parts == 2 else jacobian.real
        precision = slopes.T @ slopes / NOISE**2 + np.eye(parts * UNKNOWNS) / 0.25**2
        variances = np.sort(1 / np.linalg.eigvalsh(precision))
        least = np.sum(variances[:-1] if parts == 2 else variances) / (parts * UNKNOWNS)
        ratios.append(square / found.sd**2)
        optimal.append(square / least)
    # A mean of n squares of normal errors has a relative sd of sqrt(2 / n); finite sizes and the
    # curvature of the likelihood take a few per cent more.
    slack = 4 * np.sqrt(2 / (len(ratios) * parts * UNKNOWNS)) + 0.05
    assert abs(np.mean(ratios) - 1) < slack, ratios
    assert abs(np.mean(optimal) - 1) < slack, optimal


@pytest.mark.slow
def test_a_picture_behind_coded_diffraction_is_recovered_to_its_noise(x64):
    """No random matrix, yet near one; with the Wiener filter of the field it was drawn from."""
    side = 32
    radius = np.hypot(*np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side)))
    prior = models.GaussianField(0.01 / (0.02 + radius) ** 2, 0.5)
    x = np.asarray(prior.sample(jax.random.key(1)))
    rng = np.random.default_rng(0)
    masks = np.exp(2j * np.pi * rng.random((4, side, side)))
    likelihood = models.IntensityLikelihood(
        models.CodedDiffraction(masks), models.Poisson(1_000_000), 1 / 1000
    )
    y = likelihood.simulate(jax.random.key(2), jnp.asarray(x))
    start = x + 0.1 * rng.standard_normal(x.shape)
    found = prgamp(likelihood, y, jax.random.key(0), start, prior, 0.1, damping=0.5)
    error = np.sqrt(np.mean((np.asarray(found.object) - x) ** 2))
    assert 0.8 < error / found.sd < 1.25
    # All 4 x 32^2 amplitudes fix the 32^2 unknowns to half of their noise or better.
    assert error < np.sqrt(1000 / 1e6) / 2


def test_both_recordings_of_a_real_object_count_once():
    """Moving light from k to -k changes nothing."""
    optics = models.Fourier((8, 8), oversampling=2)
    well = 2**22
    likelihood = models.IntensityLikelihood(optics, models.Poisson(well), 1 / 8)
    x = np.random.default_rng(0).random((8, 8))
    y = np.rint(np.asarray(likelihood.expected(jnp.asarray(x)), float) * well) / well
    share = np.random.default_rng(1).random(y.shape)
    share = (share + 1 - np.roll(np.flip(share), 1, axis=(0, 1))) / 2
    moved = np.rint(share * (y + np.roll(np.flip(y), 1, axis=(0, 1))) * well) / well
    assert np.abs(moved - y).max() > 0.01
    prior = models.GaussianField(np.full((8, 8), 0.08), 0.5)
    found = [
        prgamp(likelihood, d, jax.random.key(0), x, prior, 0.05, iterations=5).object
        for d in (y, moved)
    ]
    np.testing.assert_allclose(found[1], found[0], atol=1e-4)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"start_sd": 0.0}, "start_sd 0.0"),
        ({"damping": 0.0}, "damping 0.0"),
        ({"damping": 1.5}, "damping 1.5"),
        ({"iterations": 0}, "iterations 0"),
        ({"finest": -1.0}, "finest -1.0"),
        ({"start": np.zeros((4, 4))}, r"the object is \(8, 8\)"),
    ],
)
def test_what_it_cannot_use_is_refused(change, words):
    optics = models.Fourier((8, 8), oversampling=2)
    likelihood = models.IntensityLikelihood(optics, models.Gaussian(0.01))
    asked = {
        "y": np.ones((16, 16)), "key": jax.random.key(0), "start": np.ones((8, 8)),
        "denoiser": models.GaussianField(np.full((8, 8), 0.08), 0.5), "start_sd": 0.1, **change,
    }  # fmt: skip
    with pytest.raises(ValueError, match=words) as caught:
        prgamp(likelihood, **asked)
    assert "\n" not in str(caught.value)


def test_a_real_field_is_refused():
    likelihood = models.IntensityLikelihood(models.Identity((8, 8)), models.Gaussian(0.01))
    prior = models.GaussianField(np.full((8, 8), 0.08), 0.5)
    with pytest.raises(ValueError, match="the field is real"):
        prgamp(likelihood, np.ones((8, 8)), jax.random.key(0), np.ones((8, 8)), prior, 0.1)
