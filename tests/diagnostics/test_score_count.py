"""Score evaluations: the numbers that samplers must need, and no change of what they draw."""

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior import Problem, samplers
from posterior.diagnostics.score_count import score_evaluations
from posterior.models import GaussianField
from posterior.models.gallery import field_deblurring, linear_gaussian
from posterior.whole_run import whole_run

KNOWN = linear_gaussian(size=4, rows=3)
PROBLEM = Problem(KNOWN.likelihood, KNOWN.prior)
POSTERIOR = PROBLEM.condition(PROBLEM.simulate(jax.random.key(0))[1])
CHAINS, DRAWS, WARMUP, THIN = 3, 4, 10, 2
STEPS = WARMUP + DRAWS * THIN


def run(sampler, **settings):
    lengths = {"chains": CHAINS, "draws": DRAWS, "warmup": WARMUP, "thin": THIN} | settings
    return lambda posterior: whole_run(sampler, posterior, jax.random.key(1), **lengths)


RUNS = {"warmup": 0, "thin": 1}


@pytest.mark.parametrize(
    "sampler, settings, expected",
    [
        (samplers.ULA(0.01), {}, STEPS),
        (samplers.MALA(), {}, STEPS + 1),
        pytest.param(
            samplers.AnnealedLangevin(levels=6, steps=2),
            RUNS,
            DRAWS * 6 * 2,
            marks=pytest.mark.slow,
        ),
        # The polish evaluates where it begins, in `init` and in every draw.
        pytest.param(
            samplers.AnnealedLangevin(levels=6, steps=2, polish=4),
            RUNS,
            1 + DRAWS * (6 * 2 + 1 + 4),
            marks=pytest.mark.slow,
        ),
        # Each iteration looks twice at every level of its reverse diffusion.
        pytest.param(
            samplers.SplitGibbs(iterations=3, moves=2, prior_steps=5),
            RUNS,
            DRAWS * 3 * 5 * 2,
            marks=pytest.mark.slow,
        ),
        pytest.param(samplers.DPS(levels=7), RUNS, DRAWS * 7, marks=pytest.mark.slow),
        # A leapfrog path shares its first gradient with the end of the last one.
        pytest.param(
            samplers.BlackJAX(blackjax.hmc, num_integration_steps=5),
            {"warmup": 0},
            1 + DRAWS * THIN * 5,
            marks=pytest.mark.slow,
        ),
    ],
    ids=["ula", "mala", "annealed", "annealed and polished", "split-gibbs", "dps", "hmc"],
)
def test_known_counts_of_a_chain(sampler, settings, expected):
    assert score_evaluations(run(sampler, **settings), POSTERIOR) == CHAINS * expected


def test_nuts_needs_as_many_as_its_trees_have_leaves():
    leaves = []

    def alone(posterior):
        nuts = blackjax.nuts(posterior.log_prob, 0.5, jnp.ones(4))
        state = nuts.init(jnp.zeros(4))

        def step(state, key):
            state, info = nuts.step(key, state)
            return state, info.num_integration_steps

        _, steps = jax.lax.scan(step, state, jax.random.split(jax.random.key(0), 5))
        jax.debug.callback(lambda steps: leaves.append(int(steps.sum())), steps)
        return steps

    assert score_evaluations(alone, POSTERIOR) == 1 + leaves[0]


@pytest.mark.parametrize(
    "ask, expected",
    [
        (lambda p, x: p.prior.log_prob(x), 0),
        (lambda p, x: jax.value_and_grad(p.log_prob)(x), 1),
        (lambda p, x: p.log_prob_and_score(x), 1),
        (lambda p, x: p.annealed_score(x, 0.1), 1),
        (lambda p, x: jax.grad(lambda x: jnp.sum(p.prior.denoise(x, 0.1)))(x), 1),
        (lambda p, x: jax.vmap(p.score)(jnp.stack([x] * 7)), 7),
        (lambda p, x: jax.lax.map(p.score, jnp.stack([x] * 7)), 7),
        (lambda p, x: KNOWN.exact(jax.random.key(0), p.y, 5), 0),
    ],
)
def test_what_is_an_evaluation(ask, expected):
    assert score_evaluations(lambda p: ask(p, p.prior.mean), POSTERIOR) == expected


def test_counting_changes_neither_values_nor_the_kind_of_the_prior():
    known = field_deblurring(side=16)
    posterior = Problem(known.likelihood, known.prior).condition(jnp.full((16, 16), 0.5))
    found = []

    def score(posterior):
        assert isinstance(posterior.prior, GaussianField)
        value = posterior.score(jnp.ones((16, 16)))
        jax.debug.callback(lambda value: found.append(np.asarray(value)), value)
        return value

    assert score_evaluations(score, posterior) == 1
    assert type(posterior.prior) is GaussianField
    np.testing.assert_allclose(found[0], posterior.score(jnp.ones((16, 16))), rtol=1e-4)
