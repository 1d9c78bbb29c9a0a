"""A run as one pure function makes the draws of `sample`, also of many posteriors at once."""

import blackjax
import jax
import numpy as np
import pytest

import posterior as ps
from known import linear_gaussian
from posterior import samplers
from posterior.whole_run import whole_run

RUN = {"chains": 2, "draws": 6, "warmup": 40, "thin": 2}


def slow(*arguments):
    return pytest.param(*arguments, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    "sampler, settings",
    [
        (samplers.MALA(), RUN),
        (samplers.ULA(0.01), RUN),
        (samplers.AnnealedLangevin(levels=6, steps=2), RUN | {"warmup": 0}),
        slow(samplers.BlackJAX(blackjax.nuts), RUN | {"draws": 3}),
        slow(samplers.TemperedSMC(moves=1, leapfrog=2), {"chains": 2, "draws": 20}),
    ],
    ids=["MALA", "ULA", "AnnealedLangevin", "NUTS", "TemperedSMC"],
)
def test_its_draws_are_those_of_sample(x64, sampler, settings):
    posterior, *_ = linear_gaussian(4, 3, float)
    key = jax.random.key(7)
    expected = ps.sample(posterior, sampler, key, progress=False, **settings).values
    found = jax.jit(lambda p: whole_run(sampler, p, key, **settings))(posterior)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10)


def test_many_posteriors_at_once_and_only_what_is_asked_of_them(x64):
    posterior, *_ = linear_gaussian(4, 3, float)
    problem = ps.Problem(posterior.likelihood, posterior.prior)
    key, scales = jax.random.key(7), np.array([0.5, 1.0])

    def norms(scale):
        given = problem.condition(scale * posterior.y)
        return whole_run(samplers.MALA(), given, key, **RUN, record=lambda x: (x**2).sum())

    found = jax.jit(jax.vmap(norms))(scales)
    for norm, scale in zip(found, scales):
        given = problem.condition(scale * posterior.y)
        run = ps.sample(given, samplers.MALA(), key, progress=False, **RUN)
        np.testing.assert_allclose(norm, (run.values**2).sum(axis=-1), rtol=1e-8)


def test_emcee_is_refused():
    posterior, *_ = linear_gaussian(4, 3, float)
    with pytest.raises(ValueError, match="cannot be compiled"):
        whole_run(samplers.Ensemble(), posterior, jax.random.key(0))
