"""Plug-and-play ADMM ends where the gradient of its loss vanishes, with any denoiser."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior import models
from posterior.diagnostics import align
from posterior.estimators import plug_and_play_admm

SIDE = 8
POWER = 0.1 / (0.1 + np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE), np.fft.fftfreq(SIDE))))
FOURIER = models.Fourier((SIDE, SIDE), oversampling=2)


def recorded(optics=FOURIER, dtype=float, full_well=100, irradiance=0.1):
    """A prior, an object near 0.5, its likelihood and recording."""
    prior = models.GaussianField(POWER, 0.5, dtype=dtype)
    rows, columns = np.mgrid[:SIDE, :SIDE] / SIDE
    x = 0.5 + 0.3 * np.sin(2 * np.pi * rows) * np.cos(3 * columns)
    x = x * np.exp(0.5j * rows) if dtype is complex else x
    likelihood = models.IntensityLikelihood(optics, models.Poisson(full_well), irradiance)
    return prior, x, likelihood, likelihood.simulate(jax.random.key(0), jnp.asarray(x))


def blur():
    """H^H H is not a multiple of one: ADMM is linearised."""
    kernel = np.outer([1, 2, 1], [1, 3, 1]) / 20
    return models.Blur((SIDE, SIDE), kernel)


# Amplitude noise of `recorded`, and a level whose penalty is 1 / 0.3^2: large enough to converge.
NOISE = np.sqrt(1 / 100 / 4 / 0.1)
LEVEL = 0.3 * NOISE


def relative_force(minus_log, o, x):
    """Gradient at `o` over that at the truth."""
    slopes = jax.grad(minus_log)
    return jnp.linalg.norm(slopes(o)) / jnp.linalg.norm(slopes(jnp.asarray(x)))


@pytest.mark.parametrize("weight", [1.0, 3.0])
@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("optics", [FOURIER, blur()], ids=["fourier", "linearised"])
def test_it_ends_at_the_maximum_of_a_gaussian_posterior(x64, dtype, optics, weight):
    """Of a Gaussian prior, which the weight raises to a power: its denoiser is a proximal map."""
    prior, x, likelihood, y = recorded(optics, dtype)
    level = 3 * LEVEL if dtype is complex else LEVEL
    settings = {"weight": weight, "iterations": 12_000}
    found = plug_and_play_admm(likelihood, y, x, prior, [level], **settings)

    def minus_log_posterior(o):
        misfit = jnp.sqrt(y / 0.1) - jnp.abs(optics(o))
        return (misfit**2).sum() / (2 * NOISE**2) - weight * prior.log_prob(o)

    assert relative_force(minus_log_posterior, found.object, x) < 1e-3
    assert minus_log_posterior(found.object) < minus_log_posterior(jnp.asarray(x))
    assert found.gap < 1e-6


def test_the_level_is_one_of_speed_alone_for_a_gaussian_prior(x64):
    """At weight 1 every level has the same end, and several in turn too: the dual is rescaled."""
    prior, x, likelihood, y = recorded()
    ends = [
        plug_and_play_admm(likelihood, y, x, prior, levels, iterations=8000).object
        for levels in ([LEVEL], [0.8 * LEVEL], [LEVEL, 0.9 * LEVEL])
    ]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-6)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-6)


def test_without_noise_and_with_nothing_denoised_it_recovers_the_object(x64):
    """From nearby; a function on the host is called with every level in turn."""
    rng = np.random.default_rng(0)
    x = rng.random((SIDE, SIDE))
    likelihood = models.IntensityLikelihood(FOURIER, models.Gaussian(1e-2))
    y = likelihood.expected(jnp.asarray(x))
    levels = []

    def nothing(v, level):
        assert isinstance(v, np.ndarray) and isinstance(level, float)
        levels.append(level)
        return v

    start = x + 0.05 * rng.standard_normal(x.shape)
    found = plug_and_play_admm(likelihood, y, start, nothing, [0.004, 0.003], iterations=150)
    assert levels == [0.004] * 150 + [0.003] * 150
    aligned = align(np.asarray(found.object), x, FOURIER.symmetries)
    assert np.abs(aligned - x).max() < 1e-3 < np.abs(start - x).max()
    assert found.gap < 1e-4


def test_a_function_and_a_prior_that_do_the_same_end_at_the_same(x64):
    prior, x, likelihood, y = recorded()
    wiener = lambda v, level: np.asarray(prior.denoise(jnp.asarray(v), level))  # noqa: E731
    settings = {"levels": [0.3, 0.2], "iterations": 7}
    compiled = plug_and_play_admm(likelihood, y, x, prior, **settings)
    called = plug_and_play_admm(likelihood, y, x, wiener, **settings)
    np.testing.assert_allclose(called.object, compiled.object, atol=1e-12)
    np.testing.assert_allclose(called.gap, compiled.gap, rtol=1e-9)


def test_a_new_recording_is_not_compiled_anew(caplog):
    prior, x, likelihood, y = recorded()
    settings = {"levels": [0.3], "iterations": 3}
    found = plug_and_play_admm(likelihood, y, x, prior, **settings)
    assert found.object.dtype == jnp.float32
    with jax.log_compiles():
        plug_and_play_admm(likelihood, np.asarray(y)[::-1], x, prior, **settings)
    compiled = [r.getMessage() for r in caplog.records if "Finished XLA" in r.getMessage()]
    assert not [message for message in compiled if "_scanned" in message]


@pytest.mark.parametrize(
    "change, words",
    [
        ({"start": np.zeros((4, 4))}, r"the object is \(8, 8\)"),
        ({"start": np.full((8, 8), np.nan)}, "not finite"),
        ({"start": np.zeros((8, 8), complex)}, "give a start of its kind"),
        ({"y": np.zeros((8, 8))}, r"these optics record \(16, 16\)"),
        ({"levels": []}, "1 or more"),
        ({"levels": [-1.0]}, "level -1.0"),
        ({"weight": 0.0}, "weight 0.0"),
        ({"iterations": 0}, "iterations 0"),
        ({"denoiser": 3}, "denoiser 3"),
        ({"denoiser": lambda v, level: v[0]}, "must keep the shape"),
        ({"denoiser": lambda v, level: v * np.nan}, "not finite"),
    ],
)
def test_what_it_cannot_use_is_refused(change, words):
    prior, x, likelihood, y = recorded()
    asked = {"y": y, "start": x, "denoiser": prior, "levels": [0.3], "iterations": 2, **change}
    with pytest.raises(ValueError, match=words) as caught:
        plug_and_play_admm(likelihood, **asked)
    assert "\n" not in str(caught.value)


def test_other_likelihoods_are_refused():
    prior, x, _, _ = recorded()
    linear = models.LinearLikelihood(models.Identity((SIDE, SIDE)), models.Gaussian(0.1))
    with pytest.raises(ValueError, match="is for intensities"):
        plug_and_play_admm(linear, x, x, prior, [0.1])
