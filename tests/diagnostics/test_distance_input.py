"""What distances refuse, each in a sentence, and what they take as it is."""

import numpy as np
import pytest

from posterior.diagnostics import beside_floor, noise_floor, sliced_wasserstein, two_sample_p

RNG = np.random.default_rng(0)
DRAWS, REFERENCE = RNG.standard_normal((10, 3)), RNG.standard_normal((40, 3))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda g: sliced_wasserstein(DRAWS, DRAWS, g, 0), "projections 0: give a whole number"),
        (lambda g: sliced_wasserstein(DRAWS, DRAWS, g, 2.5), "projections 2.5"),
        (lambda g: noise_floor(np.ones((40, 3)), 10, g), "all 40 draws of the reference are the"),
        (lambda g: beside_floor(DRAWS, np.ones((40, 3)), g), "the same, .*: give exact draws"),
        (lambda g: noise_floor(REFERENCE, 0, g), "sets of 0 draws: give a whole number"),
        (lambda g: noise_floor(REFERENCE, 2.5, g), "sets of 2.5 draws"),
        (
            lambda g: sliced_wasserstein(np.where(DRAWS > 1, np.inf, DRAWS), REFERENCE, g),
            "of 10 draws are not finite: .* smaller step",
        ),
    ],
)
def test_what_cannot_be_compared_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call(np.random.default_rng(0))


def test_lists_are_draws_too():
    def found(draws, reference):
        rng = np.random.default_rng(0)
        return beside_floor(draws, reference, rng, permutations=19), two_sample_p(
            draws, reference, rng, permutations=19
        )

    assert found(DRAWS.tolist(), REFERENCE.tolist()) == found(DRAWS, REFERENCE)
