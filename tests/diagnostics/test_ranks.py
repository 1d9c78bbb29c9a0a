"""Ranks of truths among draws, ties and autocorrelation included."""

import numpy as np
import pytest
import scipy.stats

from posterior.diagnostics.ranks import randomised_ranks, thinned
from posterior.diagnostics.uniformity import uniformity


def test_ranks_are_those_of_a_plain_loop():
    rng = np.random.default_rng(0)
    truths, draws = rng.standard_normal((5, 2)), rng.standard_normal((5, 9, 2))
    u = randomised_ranks(truths, draws, rng)
    for i in range(5):
        for q in range(2):
            k = sum(draws[i, j, q] < truths[i, q] for j in range(9))
            assert k / 10 <= u[i, q] <= (k + 1) / 10


@pytest.mark.parametrize("kind", ["continuous", "with ties", "all equal"])
def test_ranks_among_three_draws_are_uniform(kind):
    rng = np.random.default_rng(1)
    values = rng.standard_normal((4000, 4))
    values = {"continuous": values, "with ties": np.round(values), "all equal": 0 * values}[kind]
    u = randomised_ranks(values[:, 0], values[:, 1:], rng)
    assert uniformity(u) > 0.01
    # A discrete rank, without its random part, is rejected though the draws are exact.
    k = (values[:, 1:] < values[:, :1]).sum(axis=1)
    assert uniformity(k / 3) < 1e-6


def autoregressive(rng, runs, draws, memory=0.95):
    x = rng.standard_normal((runs, draws))
    for t in range(1, draws):
        x[:, t] = memory * x[:, t - 1] + np.sqrt(1 - memory**2) * x[:, t]
    return x


def test_slow_chains_must_be_thinned():
    """An exact chain that moves slowly: its ranks pile up at the ends until it is thinned."""
    rng = np.random.default_rng(2)
    draws = autoregressive(rng, 1500, 200)
    truths = rng.standard_normal(1500)
    assert uniformity(randomised_ranks(truths, draws, rng)) < 1e-6
    kept = thinned(draws[:, None, :, None])
    assert kept.shape == (1500, 1, 200, 1)
    assert uniformity(randomised_ranks(truths, draws, rng, kept[:, 0, :, 0])) > 0.01


def test_thinned_draws_of_an_exact_chain_give_as_many_false_alarms_as_stated():
    """400 calibrations of 100 runs each; unthinned, three times as many."""
    rng = np.random.default_rng(0)
    draws, truths = autoregressive(rng, 40_000, 200, 0.9), rng.standard_normal(40_000)
    kept = thinned(draws[:, None, :, None])[:, 0, :, 0]
    least, most = scipy.stats.binom(400, 0.05).interval(0.99)

    def alarms(ranks):
        return sum(uniformity(u) < 0.05 for u in ranks.reshape(400, 100))

    assert least <= alarms(randomised_ranks(truths, draws, rng, kept)) <= most
    assert alarms(randomised_ranks(truths, draws, rng)) > 2 * most


def test_chains_that_stand_still_count_as_one_draw():
    values = np.random.default_rng(3).standard_normal((2, 1, 40, 1))
    values[0] = 0.3
    kept = thinned(values)
    assert kept[0].sum() == 1 and kept[1].sum() > 1
    assert thinned(values[:1]).sum() == 1


@pytest.mark.parametrize(
    "truths, draws, message",
    [
        (np.zeros(3), np.zeros((3, 0)), "0 draws of each truth"),
        (np.zeros((3, 0)), np.zeros((3, 5, 0)), "for truths of"),
        (np.zeros(3), np.zeros((4, 5)), r"draws of shape \(4, 5\) for truths of \(3,\)"),
        (np.zeros(3), np.zeros((3, 5, 2)), "for truths of"),
        (np.zeros(3) + 1j, np.zeros((3, 5)), "complex"),
        (np.zeros(3), np.full((3, 5), np.nan), "15 of 15 values of the draws"),
        (np.array([0, np.inf, 0]), np.zeros((3, 5)), "1 of 3 values of the truths"),
    ],
)
def test_bad_ranks_are_refused(truths, draws, message):
    with pytest.raises(ValueError, match=message):
        randomised_ranks(truths, draws, np.random.default_rng(0))


def test_what_cannot_be_thinned_or_kept_is_refused():
    with pytest.raises(ValueError, match="give .n, chains, draws"):
        thinned(np.zeros((3, 5)))
    rng, truths, draws = np.random.default_rng(0), np.zeros(3), np.zeros((3, 5))
    with pytest.raises(ValueError, match=r"kept of shape \(5,\)"):
        randomised_ranks(truths, draws, rng, np.ones(5, bool))
    with pytest.raises(ValueError, match="no draw is left"):
        randomised_ranks(truths, draws, rng, np.zeros((3, 5), bool))
