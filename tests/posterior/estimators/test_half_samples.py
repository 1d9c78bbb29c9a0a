"""Half samples: their scatter is that of the estimate over other data."""

import jax
import numpy as np
import pytest

from posterior import models
from posterior.estimators import half_samples

ROWS, UNKNOWNS, COUNT, BELIEVED = 400, 10, 150, 0.1


def likelihood_of(matrix):
    return models.LinearLikelihood(models.Matrix(matrix), models.Gaussian(BELIEVED))


def regression(rng, noise):
    matrix = rng.standard_normal((ROWS, UNKNOWNS))
    return matrix, matrix @ np.ones(UNKNOWNS) + noise * rng.standard_normal(ROWS)


def halves_by_least_squares(rng, matrix, y, count):
    chosen = (rng.permutation(ROWS)[: ROWS // 2] for _ in range(count))
    return np.stack([np.linalg.lstsq(matrix[rows], y[rows])[0] for rows in chosen])


def scatter(matrix, draws):
    """Covariance of draws in that of least squares for noise of 1, on average over its axes."""
    return np.trace(np.cov(draws.T) @ matrix.T @ matrix) / UNKNOWNS


@pytest.mark.slow
def test_answers_scatter_as_those_of_random_halves_do(x64):
    """Beside least squares of halves chosen by NumPy, to four sd: 7 % of an sd."""
    rng = np.random.default_rng(0)
    matrix, y = regression(rng, 3 * BELIEVED)
    draws = half_samples(likelihood_of(matrix), y, jax.random.key(1), COUNT)
    others = halves_by_least_squares(rng, matrix, y, 2000)
    error = 4 * np.sqrt(2 / UNKNOWNS * (1 / COUNT + 1 / len(others)))
    assert scatter(matrix, draws) == pytest.approx(scatter(matrix, others), rel=error)
    z = (draws.mean(axis=0) - others.mean(axis=0)) / draws.std(axis=0) * np.sqrt(COUNT)
    assert np.abs(z).max() < 4


def test_halves_scatter_as_the_estimate_does_over_other_data():
    """As the docstring states; the error is over so many data, and 2 % at most."""
    rng = np.random.default_rng(1)
    data = [regression(rng, BELIEVED) for _ in range(100)]
    found = [scatter(m, halves_by_least_squares(rng, m, y, 100)) for m, y in data]
    found = np.array(found) / BELIEVED**2
    error = found.std(ddof=1) / np.sqrt(len(found))
    expected = (ROWS / 2) / (ROWS / 2 - UNKNOWNS - 1)
    assert error < 0.02 and abs(found.mean() - expected) < 4 * error


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
