"""Half samples: their scatter is that of the estimate over other data."""

import jax
import numpy as np
import pytest

from posterior import models
from posterior.estimators import half_samples, maximum_likelihood

ROWS, UNKNOWNS, COUNT, BELIEVED = 400, 3, 150, 0.1


def likelihood_of(matrix):
    return models.LinearLikelihood(models.Matrix(matrix), models.Gaussian(BELIEVED))


@pytest.mark.parametrize("noise", [pytest.param(BELIEVED, marks=pytest.mark.slow), 3 * BELIEVED])
def test_answers_scatter_as_the_estimate_does_whatever_noise_was_believed(x64, noise):
    """In units of the true covariance of least squares, on average over its axes.

    To four sd: of a variance from so many draws, and of the residuals that it is made from, which
    count by their leverage.
    """
    rng = np.random.default_rng(round(100 * noise))
    matrix = rng.standard_normal((ROWS, UNKNOWNS))
    y = matrix @ np.ones(UNKNOWNS) + noise * rng.standard_normal(ROWS)
    likelihood = likelihood_of(matrix)
    best = maximum_likelihood(likelihood, y, tolerance=1e-12).object
    draws = half_samples(likelihood, y, jax.random.key(1), COUNT)
    spread = np.trace(np.cov(draws.T) @ matrix.T @ matrix) / UNKNOWNS / noise**2
    assert spread == pytest.approx(
        1, abs=4 * np.sqrt(2 / (UNKNOWNS * COUNT) + 2 * (UNKNOWNS + 2) / UNKNOWNS / ROWS)
    )
    assert np.all(np.abs(draws.mean(axis=0) - best) < 4 * draws.std(axis=0) / np.sqrt(COUNT))


def test_an_image_of_a_stack_is_taken_or_left_as_a_whole(x64):
    """Two images of different brightness: an answer is as bright as the one or the other."""
    optics = models.FourierPtychography((8, 8), np.zeros((2, 2), int), np.ones((4, 4)))
    likelihood = models.IntensityLikelihood(optics, models.Gaussian(0.01))
    levels = np.array([0.4, 0.6])
    y = levels[:, None, None] * np.ones((2, 4, 4))
    draws = half_samples(likelihood, y, jax.random.key(0), 12)
    light = np.asarray([likelihood.expected(o)[0] for o in draws])
    nearest = levels[np.abs(light.mean((1, 2))[:, None] - levels).argmin(axis=1)]
    np.testing.assert_allclose(light, nearest[:, None, None] * np.ones((1, 4, 4)), rtol=1e-4)
    assert set(nearest) == set(levels)
    again = half_samples(likelihood, y, jax.random.key(0), 12)
    np.testing.assert_array_equal(again, draws)


def test_what_a_half_leaves_free_does_not_scatter(x64):
    y = np.array([0.3, 0.7])
    draws = half_samples(likelihood_of(np.eye(2)), y, jax.random.key(0), 3)
    np.testing.assert_allclose(draws, np.broadcast_to(y, (3, 2)), atol=1e-9)


def test_what_has_no_halves_is_refused():
    with pytest.raises(ValueError, match="have no halves"):
        half_samples(likelihood_of(np.eye(1)), np.ones(1), jax.random.key(0), 2)
