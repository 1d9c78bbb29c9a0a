"""R-hat, ESS and Monte-Carlo error of whole maps, beside arviz-stats pixel by pixel."""

import numpy as np
import pytest
import scipy.stats
from arviz_stats.base import array_stats

from posterior.diagnostics import convergence, ess, mcse, nested_rhat, rhat

AXES = {"chain_axis": 0, "draw_axis": 1}
SIZES = [(1, 4), (1, 5), (2, 6), (2, 7), (3, 50), (4, 301)]


def autoregressive(chains, draws, pixels=40):
    """(chains, draws, pixels), from alternating to hardly moving; one pixel in whole numbers."""
    rng = np.random.default_rng(draws)
    x = rng.standard_normal((chains, draws, pixels))
    for t in range(1, draws):
        x[:, t] += np.linspace(-0.99, 0.99, pixels) * x[:, t - 1]
    x[:, :, 5] = np.round(2 * x[:, :, 5])
    return x


@pytest.mark.parametrize("chains, draws", SIZES)
@pytest.mark.parametrize("method", ["bulk", "tail", "mean", "sd"])
def test_ess_is_that_of_arviz(chains, draws, method):
    x = autoregressive(chains, draws)
    settings = {"prob": (0.05, 0.95)} if method == "tail" else {}
    expected = array_stats.ess(x, **AXES, method=method, **settings)
    np.testing.assert_allclose(ess(x, method), expected, rtol=1e-11)


@pytest.mark.parametrize("chains, draws", SIZES[2:])
def test_rhat_and_error_are_those_of_arviz(chains, draws):
    x = autoregressive(chains, draws) + 0.3 * np.arange(chains)[:, None, None]
    np.testing.assert_allclose(rhat(x), array_stats.rhat(x, **AXES), rtol=1e-11)
    for method in ("mean", "sd"):
        expected = array_stats.mcse(x, **AXES, method=method)
        np.testing.assert_allclose(mcse(x, method), expected, rtol=1e-11)


def test_a_picture_is_done_in_parts(monkeypatch):
    x = autoregressive(2, 50, 60).reshape(2, 50, 6, 10)
    whole = ess(x), rhat(x), mcse(x)
    monkeypatch.setattr(convergence, "_PART", 100 * 7)
    for part, all_at_once in zip((ess(x), rhat(x), mcse(x)), whole):
        assert part.shape == (6, 10)
        np.testing.assert_array_equal(part, all_at_once)


def test_a_pixel_that_does_not_vary_has_no_number():
    x = autoregressive(2, 50)
    x[:, :, 3] = 0.1
    for found in (ess(x), rhat(x), mcse(x)):
        assert np.flatnonzero(np.isnan(found)).tolist() == [3]


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda x: x[:1], "one chain"),
        (lambda x: x[:, :3], "4 draws or more"),
        (lambda x: x + 1j, "complex draws"),
        (lambda x: np.where(x > 2, np.nan, x), "of 4000 values of the draws are not finite"),
        (lambda x: 0 * x, "do not vary"),
    ],
)
def test_bad_draws_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        rhat(change(autoregressive(2, 50)))


def test_the_sd_of_two_values_as_often_each_has_no_error():
    """Their squares are all the same: rounding must not take the root of less than nothing."""
    x = 0.1 + np.random.default_rng(0).permuted(np.tile([-0.3, 0.3], (2, 25, 40)), axis=1)
    x = np.concatenate([x, 0.2 - x], axis=1).reshape(2, -1, 40)
    assert np.all(mcse(x, "sd") < 1e-8)


def test_unknown_methods_are_refused():
    for statistic in (ess, mcse):
        with pytest.raises(ValueError, match="unknown method 'median'"):
            statistic(autoregressive(2, 50), "median")


def test_chains_that_stand_still_in_different_places_never_agree():
    x = np.broadcast_to(np.arange(2.0)[:, None, None], (2, 50, 3))
    assert np.all(np.isinf(rhat(x)))


@pytest.mark.parametrize(
    "chains, draws, superchains", [(4, 4, 2), (6, 7, 3), (12, 50, 3), (3, 50, 3), (8, 301, 4)]
)
def test_nested_rhat_is_that_of_arviz(chains, draws, superchains):
    group = np.repeat(np.arange(superchains), chains // superchains)
    x = autoregressive(chains, draws) + 0.3 * group[:, None, None]
    expected = array_stats.rhat_nested(x, group, **AXES)
    np.testing.assert_allclose(nested_rhat(x, superchains), expected, rtol=1e-11)


@pytest.mark.parametrize("draws", [1, 2, 3])
def test_nested_rhat_of_chains_too_short_to_split(draws):
    """One pixel at a time, as it is written in the paper."""
    x = autoregressive(12, draws)
    for pixel, found in zip(x.transpose(2, 0, 1), nested_rhat(x, 3)):
        ratios = []
        for values in (pixel, np.abs(pixel - np.median(pixel))):
            ranks = scipy.stats.rankdata(values.ravel()).reshape(values.shape)
            groups = scipy.stats.norm.ppf((ranks - 0.375) / (ranks.size + 0.25)).reshape(3, 4, -1)
            between = np.var(groups.mean(axis=(1, 2)), ddof=1)
            within = np.mean(np.var(groups.mean(axis=2), axis=1, ddof=1))
            if draws > 1:
                within += np.mean(np.var(groups, axis=2, ddof=1))
            ratios.append(np.sqrt(1 + between / within))
        assert found == pytest.approx(max(ratios), rel=1e-11)


def test_nested_rhat_of_independent_draws_is_near_one():
    """Of one draw a chain it is the F statistic of the normal scores: bulk, or tail if larger."""
    superchains, size = 8, 64
    x = np.random.default_rng(0).standard_normal((superchains * size, 1, 400))
    variance_ratio = size * (nested_rhat(x, superchains) ** 2 - 1)
    null = scipy.stats.f(superchains - 1, superchains * (size - 1))
    assert scipy.stats.kstest(variance_ratio, lambda v: null.cdf(v) ** 2).pvalue > 0.001


def test_superchains_that_stay_where_they_began_are_told():
    """Ordinary R-hat needs long chains to see it: single draws hold no variance within."""
    start = np.repeat([-2.0, -1.0, 1.0, 2.0], 16)[:, None, None]
    x = start + 0.5 * np.random.default_rng(0).standard_normal((64, 1, 20))
    assert np.all(nested_rhat(x, 4) > 2)
    assert np.all(np.isinf(nested_rhat(np.broadcast_to(start, (64, 1, 3)), 4)))


@pytest.mark.parametrize(
    "chains, draws, superchains, message",
    [
        (12, 10, 5, "12 chains in 5 superchains: give as many"),
        (12, 10, 1, "1 superchains: R-hat compares them"),
        (12, 10, 2.5, "2.5 superchains"),
        (12, 1, 12, "one chain of one draw"),
        (12, 0, 4, "1 draws or more"),
    ],
)
def test_bad_superchains_are_refused(chains, draws, superchains, message):
    with pytest.raises(ValueError, match=message):
        nested_rhat(np.ones((chains, draws, 3)), superchains)
