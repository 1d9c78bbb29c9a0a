"""Histograms of the ranks of chains: the band holds exact ones, and lets no others through."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats
from matplotlib.figure import Figure

from posterior.diagnostics import plot_chains
from posterior.diagnostics.chain_plot import _histograms

RNG = np.random.default_rng(0)
CHAINS, REPEATS = 4, 100


def chains(memory=0.0, draws=400):
    """Normal draws, of which neighbours have the correlation `memory`."""
    noise = RNG.standard_normal((CHAINS, draws + 100))
    return scipy.signal.lfilter([1], [1, -memory], noise, axis=1)[:, 100:]


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_the_band_holds_all_bars_as_often_as_stated(memory):
    """Or oftener: counts are whole, and the bars are corrected for their number."""
    drawn = sum(_histograms(chains(memory), 0.95).outside.any() for _ in range(REPEATS))
    assert drawn <= scipy.stats.binom(REPEATS, 0.05).ppf(0.995)


def test_a_shifted_chain_and_a_narrow_one_stand_out_in_their_own_rows():
    values = chains()
    values[1] += 1.0
    outside = _histograms(values, 0.95).outside
    assert outside[1, 0] and outside[1, -1]
    values = chains()
    values[2] *= 0.3
    found = _histograms(values, 0.95)
    assert found.outside[2, [0, -1]].all() and np.argmax(found.heights[2]) in range(2, 18)


def test_every_chain_has_a_row_and_every_bar_its_place():
    axes = Figure().add_subplot()
    assert plot_chains(chains(), axes) is axes
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert [label.split("\n")[0] for label in labels] == [f"chain {i}" for i in range(1, 5)]
    assert len(axes.containers) == CHAINS
    found = _histograms(chains(), 0.95)
    # What all chains have in a bin is what is expected of them.
    together = (found.heights * found.sizes[:, None]).sum(axis=0) / found.sizes.sum()
    np.testing.assert_allclose(together, 1)


def test_a_chain_that_stands_still_is_one_draw():
    values = chains()
    values[0] = 0.3
    assert plot_chains(values).get_yticklabels()[0].get_text() == "chain 1\nn = 1"


def test_what_has_no_ranks_is_refused():
    values = chains()
    for wrong, message in (
        (values + 1j, "complex values"),
        (values[:1], r"values of shape \(1, 400\)"),
        (values[:, :7], r"values of shape \(4, 7\)"),
        (values * np.nan, "1600 of 1600 values of the draws are not finite"),
    ):
        with pytest.raises(ValueError, match=message):
            plot_chains(wrong)
    with pytest.raises(ValueError, match="level 1: it must lie"):
        plot_chains(values, level=1)
