"""What a run is worth: independent draws by closed forms, and populations of one family."""

import json

import numpy as np
import pytest

from posterior import samplers
from posterior.diagnostics.beside_exact import (
    Beside,
    _read,
    _write,
    effective_draws,
    ratio_of_means,
)

RNG = np.random.default_rng(0)


def test_draws_that_are_runs_and_those_of_a_function_count_each():
    values = np.zeros((3, 20, 1, 2))
    assert effective_draws(samplers.DPS(), values) == 20
    assert effective_draws(lambda key, posterior: None, np.zeros((3, 2, 7, 2))) == 14


def test_autoregressive_chains_count_as_their_correlation_says():
    correlation, draws = 0.8, 2000
    noise = RNG.standard_normal((8, 4, draws, 3)) * np.sqrt(1 - correlation**2)
    values = np.empty_like(noise)
    values[:, :, 0] = RNG.standard_normal((8, 4, 3))
    for i in range(1, draws):
        values[:, :, i] = correlation * values[:, :, i - 1] + noise[:, :, i]
    expected = 4 * draws * (1 - correlation) / (1 + correlation)
    # Over 16 seeds the ratio was 1.00, sd 0.02.
    assert effective_draws(samplers.MALA(), values) == pytest.approx(expected, rel=0.1)


def test_chains_that_never_move_are_worth_one_draw():
    assert effective_draws(samplers.MALA(), np.ones((3, 4, 10, 2))) == 1


def test_particles_that_share_ancestors_count_once():
    """Fifty particles of ten ancestors each: worth their ancestors."""
    ancestors = RNG.standard_normal((200, 4, 10, 3))
    values = np.repeat(ancestors, 5, axis=2)
    # Over 16 seeds the ratio was 0.98, sd 0.03.
    found = effective_draws(samplers.TemperedSMC(), values)
    assert found == pytest.approx(4 * 10, rel=0.15)
    # Of one population it cannot be told.
    assert effective_draws(samplers.TemperedSMC(), values[:, :1]) is None


def test_the_error_of_a_ratio_is_how_far_it_comes_out_from_sample_to_sample():
    """8 pairs whose members resemble each other, as distances from one exact set do."""
    common, *own = RNG.standard_normal((3, 4000, 8))
    below = 1 + 0.2 * common + 0.1 * own[0]
    above = 1.3 + 0.26 * common + 0.15 * own[1]
    found = np.array([ratio_of_means(a, b) for a, b in zip(above, below)])
    sd = np.hypot(0.15, 1.3 * 0.1) / np.sqrt(8)
    # What they have in common cancels; the mean square of the stated error is the variance.
    assert found[:, 0].std() == pytest.approx(sd, rel=0.05)
    assert np.sqrt(np.mean(found[:, 1] ** 2)) == pytest.approx(sd, rel=0.05)
    # Pairs of one ratio have no error.
    assert ratio_of_means(2 * below[0], below[0]) == (pytest.approx(2), pytest.approx(0, abs=1e-12))


def test_figures_without_the_error_of_their_distance_are_computed_anew(tmp_path):
    _write(tmp_path / "f.json", "guard", Beside(distance=1.0, distance_error=0.1))
    assert _read(tmp_path / "f.json", "guard").distance_error == 0.1
    kept = json.loads((tmp_path / "f.json").read_text())
    del kept["figures"]["distance_error"]
    (tmp_path / "f.json").write_text(json.dumps(kept))
    assert _read(tmp_path / "f.json", "guard") is None
