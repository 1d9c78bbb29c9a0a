"""What is asked of regions, by hand."""

import numpy as np

from posterior.diagnostics.regions import as_planes, block_means, bright_areas, image_means


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
