"""The spread of draws, by chains and by draws; one draw has none."""

import numpy as np
import pytest

from posterior.draws import Draws


def draws_of(values):
    mean = values.mean(axis=1)
    variance = values.var(axis=1, ddof=min(1, values.shape[1] - 1))
    stats = {"acceptance_rate": np.ones(values.shape[:2])}
    return Draws.build(values, mean, variance, stats, np.zeros(3), {})


@pytest.mark.parametrize("chains, count", [(1, 2), (2, 1), (3, 5)])
def test_sd_is_over_chains_and_draws(chains, count):
    values = np.random.default_rng(0).standard_normal((chains, count, 4))
    np.testing.assert_allclose(draws_of(values).sd, values.std(axis=(0, 1)), rtol=1e-12)


def test_one_draw_has_no_spread():
    one = draws_of(np.ones((1, 1, 4)))
    for ask in (lambda: one.sd, lambda: one.variance):
        with pytest.raises(ValueError, match="one draw has no spread: sample two or more"):
            ask()
