"""What is asked of regions, by hand."""

import numpy as np

from posterior.diagnostics.regions import (
    as_planes,
    block_means,
    bright_areas,
    image_means,
    within_grey_levels,
)


def test_blocks_are_averaged_and_a_rest_is_left_out():
    images = np.arange(2 * 5 * 7.0).reshape(2, 5, 7)
    found = block_means(images, 2)
    assert found.shape == (2, 2, 3)
    np.testing.assert_allclose(found[1, 1, 2], images[1, 2:4, 4:6].mean())
    np.testing.assert_allclose(block_means(np.ones((3, 2, 16, 24))), np.ones((3, 2, 2, 3)))


def test_means_and_areas_are_of_each_image():
    images = np.array([[[0.1, 0.9], [0.5, 0.6]], [[0.0, 0.2], [0.5, 0.5]]])
    np.testing.assert_allclose(image_means(images), [0.525, 0.3])
    np.testing.assert_allclose(bright_areas(images, 0.5), [0.5, 0.0])


def test_colour_becomes_planes():
    picture = np.arange(24.0).reshape(1, 2, 4, 3)
    np.testing.assert_array_equal(as_planes(picture)[0, 2], picture[0, ..., 2])


def test_values_are_spread_over_their_own_grey_level():
    """Steps of 0.1 and of 0.02, the brightest clipped off its step: by up to half a step each way,
    evenly; an image of one value, and one without steps, stay.
    """
    rng = np.random.default_rng(0)
    levels = rng.integers(0, 9, (2, 64, 64))
    images = levels * np.array([0.1, 0.02])[:, None, None]
    images[0, 0, 0] = 0.83
    moved = (within_grey_levels(images, rng) - images) / np.array([0.1, 0.02])[:, None, None]
    assert np.abs(moved).max() <= 0.5
    # Four standard errors of the mean and of the variance, 1/12, of a uniform number.
    count = moved.size
    assert abs(moved.mean()) < 4 / np.sqrt(12 * count)
    assert abs(moved.var() - 1 / 12) < 4 * np.sqrt((1 / 80 - 1 / 144) / count)
    flat = np.full((1, 8, 8), 0.3)
    np.testing.assert_array_equal(within_grey_levels(flat, rng), flat)
    smooth = rng.random((3, 64, 64))
    assert np.abs(within_grey_levels(smooth, rng) - smooth).max() < 1e-6


def test_images_keep_their_shape():
    images = np.random.default_rng(1).integers(0, 4, (2, 3, 8, 8)) / 4
    moved = within_grey_levels(images, np.random.default_rng(2))
    assert moved.shape == images.shape and np.abs(moved - images).max() <= 0.125
