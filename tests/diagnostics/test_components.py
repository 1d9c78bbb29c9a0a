"""Components of a posterior that is known, and two draws that differ as it allows."""

import numpy as np
import pytest
import scipy.stats
from faults import GaussianCase
from matplotlib import pyplot

from posterior.diagnostics import contrast, plot_components, plot_contrast, principal_components

COVARIANCE = GaussianCase(size=12, rows=4).posterior()[1]


def gaussian(count, covariance=COVARIANCE, seed=0, repeats=1):
    """Exact draws (repeats, 2, count/2, pixels) of a Gaussian posterior of that covariance."""
    root = np.linalg.cholesky(covariance)
    n = np.random.default_rng(seed).standard_normal((repeats, 2, count // 2, len(root), 2))
    return n @ [np.sqrt(0.5), 1j * np.sqrt(0.5)] @ root.T if root.dtype == complex else (
        n[..., 0] @ root.T
    )  # fmt: skip


def complex_covariance():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((6, 6, 2)) @ [1, 1j]
    return root @ np.diag([4.0, 2.0, 1.0, 0.5, 0.25, 0.1]) @ root.conj().T / 6


@pytest.mark.parametrize("covariance", [COVARIANCE, complex_covariance()], ids=["real", "complex"])
def test_sd_and_patterns_are_those_of_a_known_posterior(covariance):
    """Means over repeated runs, beside their expectation to first order in 1/n (Anderson 1963)."""
    n, repeats = 600, 100
    variance, vectors = (a[..., ::-1] for a in np.linalg.eigh(covariance))
    runs = [principal_components(draws, 2) for draws in gaussian(n, covariance, 0, repeats)]
    for k in range(2):
        apart = variance[k] - np.delete(variance, k)
        other = np.delete(variance, k)
        found = np.array([run.sd[k] ** 2 for run in runs])
        expected = variance[k] * (1 + np.sum(other / apart) / n)
        assert abs(found.mean() - expected) < 4 * found.std() / np.sqrt(repeats)
        missed = np.array([1 - abs(vectors[:, k].conj() @ run.patterns[k]) ** 2 for run in runs])
        expected = variance[k] * np.sum(other / apart**2) / n
        assert abs(missed.mean() - expected) < 4 * missed.std() / np.sqrt(repeats)
    share = np.array([run.share for run in runs])
    # To the same order the total is unbiased; the share's own bias is that of the sd.
    assert np.all(share.sum(axis=1) < 1) and np.all(np.diff(share, axis=1) < 0)


@pytest.mark.parametrize("kind", [float, complex])
@pytest.mark.parametrize("count, pixels", [(40, (3, 5)), (10, (6, 7))])
def test_they_are_the_singular_vectors_of_the_centred_draws(kind, count, pixels):
    draws = np.random.default_rng(2).standard_normal((2, count // 2, *pixels, 2))
    draws = draws @ [1, 1j] if kind is complex else draws[..., 0]
    found = principal_components(draws, 3)
    flat = draws.reshape(count, -1)
    _, s, rows = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    np.testing.assert_allclose(found.sd, s[:3] / np.sqrt(count - 1), rtol=1e-9)
    np.testing.assert_allclose(found.share, s[:3] ** 2 / np.sum(s**2), rtol=1e-9)
    np.testing.assert_allclose(found.mean, draws.mean(axis=(0, 1)), rtol=1e-12)
    patterns = found.patterns.reshape(3, -1)
    np.testing.assert_allclose(np.abs(np.sum(patterns * rows[:3].conj(), axis=1)), 1, rtol=1e-9)
    np.testing.assert_allclose(patterns @ patterns.conj().T, np.eye(3), atol=1e-9)
    assert patterns.dtype == kind
    largest = np.argmax(np.abs(patterns), axis=1)
    assert np.all(patterns[range(3), largest].real > 0)
    scores = (flat - flat.mean(axis=0)) @ patterns.conj().T
    np.testing.assert_allclose(np.mean(scores**2, axis=0).imag, 0, atol=1e-9)
    assert np.all(np.mean(scores**2, axis=0).real > 0)


def test_few_draws_find_directions_that_are_not_there():
    """Pixels that are independent: the edge of Marchenko and Pastur, +- that of Tracy and Widom."""
    n, pixels = 100, 900
    draws = np.random.default_rng(3).standard_normal((1, n, 30, 30))
    edge = (1 + np.sqrt(pixels / n)) ** 2
    scale = (np.sqrt(n) + np.sqrt(pixels)) * (n**-0.5 + pixels**-0.5) ** (1 / 3) / n
    # The law of the largest has mean -1.21 and sd 1.27 in that scale (Johnstone 2001).
    found = (principal_components(draws, 1).sd[0] ** 2 - edge) / scale
    assert abs(found + 1.21) < 4 * 1.27


def two_places(seed=0, count=200):
    """Objects with a spot that comes and goes, in pixels that are uncertain by themselves."""
    rng = np.random.default_rng(seed)
    spot = np.zeros((16, 16))
    spot[3:6, 8:12] = 1.0
    height = rng.standard_normal((4, count // 4, 1, 1))
    noise = 0.2 * rng.standard_normal((4, count // 4, 16, 16))
    return 2 + height * spot + noise, height[..., 0, 0], spot > 0


def test_contrast_is_of_two_plausible_draws_and_shows_where():
    values, height, spot = two_places()
    found = contrast(values, level=0.8)
    n, end = height.size, scipy.stats.norm(0, 1).ppf(0.9)
    density = scipy.stats.norm.pdf(end)
    # The noise of the spot's mean moves a rank by as much density.
    ranks = scipy.stats.rankdata(height).reshape(height.shape) / n
    error = 4 * 0.2 / np.sqrt(spot.sum()) * density + 1 / n
    assert abs(ranks[found.first] - 0.1) < error and abs(ranks[found.second] - 0.9) < error
    sd = values.std(axis=(0, 1), ddof=1)
    expected = (values[found.second] - values[found.first]) / sd
    np.testing.assert_allclose(found.difference, expected, rtol=1e-9)
    error = np.sqrt(2 * 0.1 * 0.9 / n) / density
    assert abs(found.along[spot].mean() - 2 * end / np.sqrt(1 + 0.2**2)) < 4 * error
    # Elsewhere it is the noise of the pattern, to first order (Anderson 1963), in sd of a pixel.
    noise = 2 * end * np.sqrt(spot.sum()) * np.sqrt(1 / (n * spot.sum()))
    assert np.abs(found.along[~spot]).max() < 5 * noise
    along = np.sum((found.along * sd) ** 2)
    assert found.share == pytest.approx(along / np.sum((found.difference * sd) ** 2))


def test_a_pixel_that_stands_still_has_no_contrast():
    values = two_places()[0]
    values[..., 0, 0] = 0.1
    found = contrast(values)
    for picture in (found.difference, found.along):
        assert np.argwhere(np.isnan(picture)).tolist() == [[0, 0]]
    assert principal_components(values, 2).patterns[:, 0, 0].tolist() == [0, 0]


@pytest.mark.parametrize("turn, rows", [(1.0, 1), (np.exp(0.5j), 2)])
def test_the_pictures_show_every_panel(turn, rows):
    values = turn * two_places()[0]
    components = plot_components(principal_components(values, 3))
    pair = plot_contrast(values, contrast(values))
    for panels in (components, pair):
        panels[0, 0].figure.draw_without_rendering()
        assert panels.shape == (rows, 4) and all(axes.images for axes in panels.flat)
    titles = [axes.get_title() for axes in pair[0]]
    assert titles[:3] == ["a draw", "another draw", "difference"]
    assert pyplot.get_fignums() == []


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda x: x[0], "give .chains, draws, .shape., 2 or more"),
        (lambda x: x[:1, :1], "2 or more"),
        (lambda x: np.where(x > 2, np.nan, x), "of 40 draws are not finite: .* smaller step"),
        (lambda x: 0.1 + 0 * x, "the 40 draws do not vary.*: run them longer"),
        (lambda x: x[:1, :3], "4 components of draws that vary in 2 directions: ask for 2"),
    ],
)
def test_bad_draws_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        principal_components(change(gaussian(40)[0]), 4)


def test_bad_settings_are_refused():
    with pytest.raises(ValueError, match="count 0"):
        principal_components(gaussian(40)[0], 0)
    with pytest.raises(ValueError, match="level 1"):
        contrast(gaussian(40)[0], 1)
    with pytest.raises(ValueError, match="only pictures"):
        plot_components(principal_components(gaussian(40)[0], 2))
    values = two_places()[0]
    for other in (values[0], values[:, :3], values[..., 1:]):
        with pytest.raises(ValueError, match="give the draws .* that the contrast is of"):
            plot_contrast(other, contrast(values))
