"""What the losses of averages weigh, and that they do not move what minimises them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from networks import fresh
from posterior.models.priors.denoiser import Statistics
from posterior.models.priors.losses import (
    CoarseErrors,
    block_errors,
    count_loss,
    denoising_loss,
    equally_bright_errors,
)
from posterior.models.priors.training import Recipe, coarse_errors, start_training


def test_an_even_error_counts_for_every_average():
    """3 in each of 8 x 8 pixels: 4 x 9 of squares of 2, 16 x 9 of 4, 64 x 9 of the patch; 16 x 9
    and 64 x 9 of so many that are equally bright.
    """
    error = jnp.full((8, 8, 2), 3.0)
    np.testing.assert_allclose(block_errors(error), (4 + 16 + 64) * 9, rtol=1e-6)
    np.testing.assert_allclose(equally_bright_errors(error, error), (16 + 64) * 9, rtol=1e-6)
    clean = jnp.ones((8, 8, 2))
    found = denoising_loss(clean + error, clean, "gaussian", CoarseErrors(0.1, 0.01))
    np.testing.assert_allclose(found, 9 + 0.1 * 84 * 9 + 0.01 * 80 * 9, rtol=1e-6)


def test_an_error_that_averages_out_counts_for_pixels_alone():
    rows, columns = np.indices((8, 8))
    checkers = jnp.asarray((-1.0) ** (rows + columns))[..., None]
    np.testing.assert_allclose(block_errors(checkers), 0, atol=1e-6)


def test_an_error_of_what_is_equally_bright_counts_where_squares_see_nothing():
    """Bright and dark pixels alternate, the bright too bright by 1 and the dark too dark."""
    rows, columns = np.indices((8, 8))
    error = jnp.asarray((-1.0) ** (rows + columns))[..., None]
    shade = 0.5 + 0.1 * error
    np.testing.assert_allclose(block_errors(error), 0, atol=1e-6)
    np.testing.assert_allclose(equally_bright_errors(error, shade), 16, rtol=1e-6)
    even = jnp.asarray((-1.0) ** rows)[..., None]
    assert equally_bright_errors(error, even) < 1e-6


@pytest.mark.parametrize(
    "shape, averages", [((48, 48), 5), ((64, 64), 6), ((6, 10), 2), ((5, 5), 1)]
)
def test_independent_errors_count_once_for_each_average(shape, averages):
    """Squares of 2, 4, 8 and 16 pixels and the patch, 48 = 3 x 16, and so on; within 4 errors."""
    noise = jax.random.normal(jax.random.key(0), (4000, *shape, 1))
    found = jax.vmap(block_errors)(noise)
    assert abs(found.mean() - averages) < 4 * found.std() / np.sqrt(len(found))


@pytest.mark.parametrize("shape, lengths", [((48, 48), 2), ((64, 64), 2), ((8, 6), 1), ((5, 5), 0)])
def test_independent_errors_count_once_for_each_length(shape, lengths):
    """16 and 64 of the 2304 pixels of 48 x 48, and so on, whatever is bright."""
    keys = jax.random.split(jax.random.key(2))
    noise, shade = (jax.random.normal(key, (4000, *shape, 1)) for key in keys)
    found = jax.vmap(equally_bright_errors)(noise, shade)
    assert abs(found.mean() - lengths) <= 4 * found.std() / np.sqrt(len(found))


def test_the_mean_given_the_input_minimises_them(x64):
    """Of four equally likely pictures behind one input: no gradient at their mean, and less there
    than anywhere near.
    """
    keys = jax.random.split(jax.random.key(1), 3)
    clean = jax.random.gamma(keys[0], 2.0, (4, 8, 8, 1))
    z = jax.random.gamma(keys[1], 2.0, (8, 8, 1))

    weights = CoarseErrors(0.3, 0.2)

    def of_counts(d):
        return jnp.mean(jax.vmap(lambda x: count_loss(d, x, z, 0.3, 0.2, weights))(clean))

    def of_noise(d):
        return jnp.mean(jax.vmap(lambda x: denoising_loss(d, x, "gaussian", weights))(clean))

    mean, aside = clean.mean(axis=0), 0.1 * jax.random.normal(keys[2], (8, 8, 1))
    for loss in (of_counts, of_noise):
        np.testing.assert_allclose(jax.grad(loss)(mean), 0, atol=1e-12)
        assert loss(mean + aside) > loss(mean)


@pytest.mark.parametrize("perturbation", ["gaussian", "poisson"])
def test_coarse_errors_count_in_units_of_the_noise_at_every_level(perturbation):
    denoiser = fresh(Statistics(0.5, 0.28, 0.01, 2.0, perturbation, lowest=0.0))
    for sigma in (0.01, 0.3, 2.0):
        found = coarse_errors(denoiser, Recipe(averages=0.004, areas=0.016), sigma)
        assert found[:2] == (0.004, 0.016)
        units = denoiser.loss_weight(sigma) * found.share * denoiser.channel_sd(sigma) ** 2
        np.testing.assert_allclose(units, 1, rtol=1e-5)


def test_coarse_errors_weigh_what_their_share_says():
    """3 in each pixel, at half of the weights of the test above."""
    clean, error = jnp.ones((8, 8, 2)), jnp.full((8, 8, 2), 3.0)
    found = denoising_loss(clean + error, clean, "gaussian", CoarseErrors(0.1, 0.01, 0.5))
    np.testing.assert_allclose(found, 9 + 0.05 * 84 * 9 + 0.005 * 80 * 9, rtol=1e-6)


def test_of_the_signal_dependent_error_averages_are_left_out():
    """The harmonic mean of two pictures, 1 and 3, is 1.5 in each pixel, whatever their averages."""
    clean = jnp.stack([jnp.full((4, 4, 1), 1.0), jnp.full((4, 4, 1), 3.0)])

    weights = CoarseErrors(0.5, 0.5)

    def loss(d):
        return jnp.mean(jax.vmap(lambda x: denoising_loss(d, x, "signal", weights))(clean))

    np.testing.assert_allclose(jax.grad(loss)(jnp.full((4, 4, 1), 1.5)), 0, atol=1e-6)


def test_a_training_by_the_signal_dependent_error_refuses_them():
    """From Python too, where they would be left out without a word."""
    statistics = Statistics(0.5, 0.28, 0.01, 2.0, "signal", lowest=0.05)
    with pytest.raises(ValueError, match="averages 0.004: of the signal-dependent error"):
        start_training(fresh(statistics), Recipe(averages=0.004))
    with pytest.raises(ValueError, match="areas 0.016: of the signal-dependent error"):
        start_training(fresh(statistics), Recipe(areas=0.016))
    start_training(fresh(statistics), Recipe())


@pytest.mark.parametrize("name", ["averages", "areas"])
@pytest.mark.parametrize("weight", [-0.1, 2.0, float("nan")])
def test_a_weight_out_of_range_is_refused(name, weight):
    with pytest.raises(ValueError, match=f"{name} {weight}: give a weight from 0 to 1"):
        Recipe(**{name: weight})
