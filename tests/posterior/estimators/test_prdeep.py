"""prDeep ends where an independent gradient of its loss vanishes, and at what is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from posterior import estimators, models

SIDE = 8
POWER = 0.1 / (0.1 + np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE), np.fft.fftfreq(SIDE))))


def recorded(optics, dtype=float, full_well=400, irradiance=1.0):
    """A picture of 0.5 on average; a complex one has phases too."""
    prior = models.GaussianField(POWER, 0.5, dtype=dtype)
    rows, columns = np.mgrid[:SIDE, :SIDE] / SIDE
    x = 0.5 + 0.3 * np.sin(2 * np.pi * rows) * np.cos(2 * np.pi * columns)
    x = x * np.exp(0.5j * rows) if dtype is complex else x
    likelihood = models.IntensityLikelihood(optics, models.Poisson(full_well), irradiance)
    y = likelihood.simulate(jax.random.key(0), jnp.asarray(x))
    return ps.Problem(likelihood, prior).condition(y), x


def test_of_amplitudes_of_the_picture_itself_it_is_a_wiener_filter(x64):
    """No transform and no sign to find: (1 + weight (1 - D)) o = a + the prior's mean."""
    post, x = recorded(models.Identity((SIDE, SIDE)))
    found = estimators.prdeep(post, x, levels=[0.3, 0.1], weight=0.7, iterations=400)
    shrink = POWER / (POWER + 0.1**2)
    amplitude = np.sqrt(np.asarray(post.y))
    spectrum = np.fft.fft2(amplitude - 0.5) / (1 + 0.7 * (1 - shrink))
    np.testing.assert_allclose(found.object, 0.5 + np.fft.ifft2(spectrum).real, atol=1e-9)
    assert found.imbalance < 1e-8


@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("irradiance", [1.0, 0.25])
def test_it_ends_where_the_gradient_of_its_loss_vanishes(x64, dtype, irradiance):
    """The denoiser of a Gaussian field is linear and symmetric, so that the loss is a function."""
    optics = models.Fourier((SIDE, SIDE), oversampling=2)
    post, x = recorded(optics, dtype, 4000, irradiance)
    level = 0.1
    found = estimators.prdeep(post, x, levels=[level], iterations=20_000)
    # The default: noise of an amplitude, sigma_0 / 2 before the irradiance, over the level's.
    weight = 1 / 4000 / 4 / irradiance / (level / 2 if dtype is complex else level) ** 2
    centre = jnp.full((SIDE, SIDE), 0.5)

    def loss(o):
        misfit = jnp.sqrt(post.y / irradiance) - jnp.abs(optics(o))
        off = o - centre
        kept = post.prior.denoise(o, level) - centre
        return (misfit**2).sum() / 2 + weight * jnp.vdot(off, off - kept).real / 2

    force = jax.grad(loss)(found.object)
    assert jnp.linalg.norm(force) < 1e-4 * jnp.linalg.norm(jax.grad(loss)(jnp.asarray(x)))
    regular = weight * (found.object - post.prior.denoise(found.object, level))
    left = jnp.linalg.norm(force) / jnp.linalg.norm(regular)
    np.testing.assert_allclose(found.imbalance, left, rtol=1e-3, atol=1e-9)
    assert loss(found.object) < loss(jnp.asarray(x))


def test_it_says_how_far_it_is_from_an_end():
    post, x = recorded(models.Fourier((SIDE, SIDE), oversampling=2))
    hurried = estimators.prdeep(post, jnp.full((SIDE, SIDE), 0.5), iterations=1)
    settled = estimators.prdeep(post, x, iterations=1000)
    assert settled.imbalance < 0.05 < 1 < hurried.imbalance
    assert settled.object.dtype == post.dtype == jnp.float32


@pytest.mark.parametrize(
    "change, words",
    [
        ({"start": np.zeros((4, 4))}, r"the object is \(8, 8\)"),
        ({"start": np.zeros((8, 8), complex)}, "complex start"),
        ({"start": np.full((8, 8), np.nan)}, "not finite"),
        ({"levels": []}, "1 or more"),
        ({"levels": [0.0]}, "level 0.0"),
        ({"weight": -1.0}, "weight -1.0"),
        ({"iterations": 0}, "iterations 0"),
    ],
)
def test_what_it_cannot_start_from_is_refused(change, words):
    post, x = recorded(models.Fourier((SIDE, SIDE), oversampling=2))
    with pytest.raises(ValueError, match=words):
        estimators.prdeep(post, **{"start": x, **change})


def test_a_picture_itself_is_for_red():
    likelihood = models.LinearLikelihood(models.Identity((SIDE, SIDE)), models.Poisson(100))
    post = ps.Problem(likelihood, models.GaussianField(POWER, 0.5)).condition(
        np.full((SIDE, SIDE), 0.5)
    )
    with pytest.raises(ValueError, match="use red"):
        estimators.prdeep(post, np.zeros((SIDE, SIDE)))
