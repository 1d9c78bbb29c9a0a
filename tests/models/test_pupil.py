"""Pupils off the grid: Zernike's polynomials, discs moved by fractions, and what moving does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior.models import FourierPtychography
from posterior.models.pupil import NOLL_FIRST, pupils, wavefront

TERMS = 19


def unit(term):
    return np.eye(TERMS)[term - NOLL_FIRST]


def test_aberrations_are_orthonormal_over_the_disc(x64):
    """On a grid of 801 points a diameter, whose rim is 0.1 % of the disc."""
    axis = np.linspace(-1, 1, 801)
    row, column = np.meshgrid(axis, axis, indexing="ij")
    inside = row**2 + column**2 <= 1
    terms = [wavefront(row[inside], column[inside], one) for one in np.eye(TERMS)]
    gram = np.asarray(jnp.stack(terms) @ jnp.stack(terms).T) / inside.sum()
    np.testing.assert_allclose(gram, np.eye(TERMS), atol=2e-3)


@pytest.mark.parametrize(
    "term, written_out",
    [
        (4, lambda r, t: 3**0.5 * (2 * r**2 - 1)),
        (5, lambda r, t: 6**0.5 * r**2 * np.sin(2 * t)),
        (6, lambda r, t: 6**0.5 * r**2 * np.cos(2 * t)),
        (7, lambda r, t: 8**0.5 * (3 * r**3 - 2 * r) * np.sin(t)),
        (8, lambda r, t: 8**0.5 * (3 * r**3 - 2 * r) * np.cos(t)),
        (9, lambda r, t: 8**0.5 * r**3 * np.sin(3 * t)),
        (10, lambda r, t: 8**0.5 * r**3 * np.cos(3 * t)),
        (11, lambda r, t: 5**0.5 * (6 * r**4 - 6 * r**2 + 1)),
        (22, lambda r, t: 7**0.5 * (20 * r**6 - 30 * r**4 + 12 * r**2 - 1)),
    ],
)
def test_aberrations_are_nolls(x64, term, written_out):
    """As his Table I writes them, angles from the columns to the rows."""
    r, t = np.random.default_rng(0).random((2, 50)) * [[1], [2 * np.pi]]
    found = wavefront(r * np.sin(t), r * np.cos(t), unit(term))
    np.testing.assert_allclose(found, written_out(r, t), atol=1e-12)


def test_a_pupil_is_a_disc_about_its_offset(x64):
    offset, radii = np.array([0.3, -0.4]), (5.0, 6.0)
    (pupil,) = pupils((16, 20), radii, offset[None], 0.2 * unit(4))
    row, column = np.indices((16, 20))
    row, column = (row - 8 - offset[0]) / 5, (column - 10 - offset[1]) / 6
    radius = np.hypot(row, column)
    assert np.all(np.abs(pupil[radius < 0.5]) > 0.99) and not np.any(pupil[radius > 1.7])
    # A logistic edge of scale s, in radii, holds 1 + pi^2 s^2 / 3 of the disc; cut at 0.1 %.
    scale = 0.5 / 5.5
    area = np.pi * 30 * (1 + np.pi**2 * scale**2 / 3)
    assert np.sum(np.abs(pupil)) == pytest.approx(area, rel=1e-3 * 1.7**2)
    inside = radius < 1
    phase = 0.2 * 3**0.5 * (2 * radius**2 - 1)
    np.testing.assert_allclose(np.angle(pupil[inside]), phase[inside], atol=1e-9)


def test_pupils_have_gradients_everywhere(x64):
    def power(offset, aberration):
        pupil = pupils((8, 8), (3.0, 3.0), offset, aberration)
        return jnp.sum(jnp.abs(pupil) ** 4) + jnp.sum(pupil.imag)

    gradients = jax.grad(power, argnums=(0, 1))(jnp.zeros((2, 2)), jnp.zeros(8))
    assert all(np.isfinite(g).all() for g in gradients)


def test_a_moved_pupil_is_an_led_between_samples(x64):
    """Beside a twice as large object, two periods a side, where half a sample is a whole one."""
    rng = np.random.default_rng(1)
    o = rng.standard_normal((12, 12)) + 1j * rng.standard_normal((12, 12))

    def smooth(shape, offset, fineness):
        k = np.stack(np.indices(shape), -1) - np.array(shape) // 2 - np.asarray(offset)
        k = k / fineness
        return np.where(np.hypot(*np.moveaxis(k, -1, 0)) < 1.4, np.exp(-0.3 * k[..., 0] ** 2), 0)

    # 1.5 and -2.5 samples: one and a half, and two and a half.
    once = FourierPtychography((12, 12), [[1, -2]], smooth((6, 6), (0.5, -0.5), 1)[None])
    twice = FourierPtychography((24, 24), [[3, -5]], smooth((12, 12), (0, 0), 2))
    light = np.abs(np.asarray(once(o))) ** 2
    larger = np.abs(np.asarray(twice(np.tile(o, (2, 2))))) ** 2
    np.testing.assert_allclose(np.tile(light, (1, 2, 2)), larger, atol=1e-12)
