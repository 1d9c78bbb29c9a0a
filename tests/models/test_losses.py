"""What the losses of averages weigh, and that they do not move what minimises them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from networks import fresh
from posterior.models.priors.denoiser import Statistics
from posterior.models.priors.perturbation import count_loss, denoising_loss, squared_error
from posterior.models.priors.training import Recipe, start_training


def test_an_even_error_counts_for_every_average():
    """3 in each of 4 x 4 pixels: 9 of pixels, 4 x 9 of squares of 2, 16 x 9 of the patch."""
    error = jnp.full((4, 4, 2), 3.0)
    np.testing.assert_allclose(squared_error(error), 9)
    np.testing.assert_allclose(squared_error(error, 0.1), 9 + 0.1 * (4 * 9 + 16 * 9), rtol=1e-6)


def test_an_error_that_averages_out_counts_for_pixels_alone():
    rows, columns = np.indices((8, 8))
    checkers = jnp.asarray((-1.0) ** (rows + columns))[..., None]
    np.testing.assert_allclose(squared_error(checkers, 0.5), 1, atol=1e-6)


@pytest.mark.parametrize(
    "shape, averages", [((48, 48), 5), ((64, 64), 6), ((6, 10), 2), ((5, 5), 1)]
)
def test_independent_errors_count_once_for_each_average(shape, averages):
    """Squares of 2, 4, 8 and 16 pixels and the patch, 48 = 3 x 16, and so on; within 4 errors."""
    noise = jax.random.normal(jax.random.key(0), (4000, *shape, 1))
    found = jax.vmap(lambda error: squared_error(error, 1.0) - squared_error(error))(noise)
    assert abs(found.mean() - averages) < 4 * found.std() / np.sqrt(len(found))


def test_the_mean_given_the_input_minimises_them(x64):
    """Of four equally likely pictures behind one input: no gradient at their mean, and less there
    than anywhere near.
    """
    keys = jax.random.split(jax.random.key(1), 3)
    clean = jax.random.gamma(keys[0], 2.0, (4, 8, 8, 1))
    z = jax.random.gamma(keys[1], 2.0, (8, 8, 1))

    def of_counts(d):
        return jnp.mean(jax.vmap(lambda x: count_loss(d, x, z, 0.3, 0.2, 0.3))(clean))

    def of_noise(d):
        return jnp.mean(jax.vmap(lambda x: denoising_loss(d, x, "gaussian", 0.3))(clean))

    mean, aside = clean.mean(axis=0), 0.1 * jax.random.normal(keys[2], (8, 8, 1))
    for loss in (of_counts, of_noise):
        np.testing.assert_allclose(jax.grad(loss)(mean), 0, atol=1e-12)
        assert loss(mean + aside) > loss(mean)


def test_of_the_signal_dependent_error_averages_are_left_out():
    """The harmonic mean of two pictures, 1 and 3, is 1.5 in each pixel, whatever their averages."""
    clean = jnp.stack([jnp.full((4, 4, 1), 1.0), jnp.full((4, 4, 1), 3.0)])

    def loss(d):
        return jnp.mean(jax.vmap(lambda x: denoising_loss(d, x, "signal", 0.5))(clean))

    np.testing.assert_allclose(jax.grad(loss)(jnp.full((4, 4, 1), 1.5)), 0, atol=1e-6)


def test_a_training_by_the_signal_dependent_error_refuses_them():
    """From Python too, where they would be left out without a word."""
    statistics = Statistics(0.5, 0.28, 0.01, 2.0, "signal", lowest=0.05)
    with pytest.raises(ValueError, match="averages 0.004: of the signal-dependent error"):
        start_training(fresh(statistics), Recipe(averages=0.004))
    start_training(fresh(statistics), Recipe())


@pytest.mark.parametrize("averages", [-0.1, 2.0, float("nan")])
def test_a_weight_out_of_range_is_refused(averages):
    with pytest.raises(ValueError, match="averages"):
        Recipe(averages=averages)
