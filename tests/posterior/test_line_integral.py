"""MALA for a score without a density: its moves are those by a density, if the score has one."""

import warnings
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from networks import network_denoiser
from posterior import models, samplers
from posterior.models.priors import EnergyPrior, ScorePrior
from posterior.models.priors.conservative import loop_check


def denoising(prior):
    likelihood = models.LinearLikelihood(models.Identity(prior.shape), models.Gaussian(0.1))
    return ps.Problem(likelihood, prior).condition(np.full(prior.shape, 0.3))


def moves(post, sampler, steps=40):
    """Positions and acceptance of a chain of its own making, (steps, *shape) and (steps,)."""

    def one(state, key):
        state, info = sampler.step(key, state)
        return state, (state.position, info.acceptance_rate)

    state = sampler.init(jax.random.key(0), post, jnp.full(post.shape, 0.3))
    keys = jax.random.split(jax.random.key(1), steps)
    return jax.jit(lambda s: jax.lax.scan(one, s, keys)[1])(state)


@pytest.mark.slow
def test_an_energys_score_gives_the_moves_of_its_density(x64):
    post = denoising(EnergyPrior(network_denoiser(), (4, 4)))
    exact, acceptance = moves(post, samplers.MALA(3e-3, "none"))
    assert 0.2 < acceptance.mean() < 0.95
    found, integrated = moves(post, samplers.MALA(3e-3, "none", nodes=8))
    np.testing.assert_allclose(integrated, acceptance, atol=1e-6)
    np.testing.assert_allclose(found, exact, atol=1e-9)


class Swirl(models.GaussianPrior):
    """Two pixels whose score turns about the mean beside pointing at it: no gradient."""

    turn: float = 0.0
    finest: ClassVar[float] = 0.1

    def score(self, x, sigma=0.0):
        across = jnp.stack([-x[1], x[0]])
        return super().score(x, sigma) + self.turn * across


def swirling(nats):
    """A prior whose score integrates to so much round the triangles of the check.

    Its sides are 0.3 of the finest level; the integral is the turn times twice the area, of
    variance 2 side^4.
    """
    prior = Swirl(0.3, 0.04, (2,))
    side = 0.3 * Swirl.finest
    object.__setattr__(prior, "turn", nats / (side**2 * np.sqrt(2)))
    return prior


def test_the_integral_round_a_loop_is_the_turn_times_twice_its_area(x64):
    """Of 20000 triangles, whose integrals have the kurtosis 6: to four sd, 3 %."""
    found = loop_check(swirling(0.3), jax.random.key(4), Swirl.finest, loops=20_000)
    assert found.loop == pytest.approx(0.3, rel=4 * np.sqrt(5 / 20_000) / 2)


def test_a_score_that_turns_is_refused_or_warned_of_by_how_much(x64):
    settings = {"draws": 2, "warmup": 2, "chains": 1, "progress": False}
    key = jax.random.key(2)
    sampler = samplers.MALA(1e-12, "none", nodes=2)
    with pytest.raises(ValueError, match="nats round a loop"):
        ps.sample(denoising(swirling(10.0)), sampler, key, **settings)
    with pytest.warns(UserWarning, match="nats round a loop"):
        ps.sample(denoising(swirling(0.3)), sampler, key, **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ps.sample(denoising(swirling(0.01)), sampler, key, **settings)


def test_a_score_alone_names_the_way_and_nodes_are_counted():
    post = denoising(ScorePrior(network_denoiser("float32"), (4, 4)))
    with pytest.raises(ValueError, match="MALA with nodes=4"):
        ps.sample(post, samplers.MALA(), jax.random.key(0), progress=False)
    with pytest.raises(ValueError, match="nodes 0: give 1 or more"):
        samplers.MALA(nodes=0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nuclei", "natural", "cells", "complex-cells"])
def test_the_shipped_scores_are_near_enough_to_gradients(name):
    """Of 64 x 64 pixels, at the finest level, which is where MALA runs: below what it refuses.

    Beside the integral along a side, which a Metropolis test needs. Larger pictures have larger
    loops.
    """
    prior = ScorePrior.load(name, (64, 64))
    found = loop_check(prior, jax.random.key(0), prior.finest)
    print(f"{name}: {found.loop:.2g} nats round a loop, {found.leg:.2g} along a side")
    assert found.loop < min(0.5, 0.1 * found.leg)
