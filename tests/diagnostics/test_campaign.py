"""Simulations in batches: the same whatever the batch, and after an interruption."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from faults import GaussianCase

from posterior.diagnostics import campaign
from posterior.diagnostics.campaign import Settings, simulate
from posterior.diagnostics.ranks import randomised_ranks
from posterior.sampling import NonFiniteError

CASE = GaussianCase(size=6, rows=4)
ASKED = {
    "norm": lambda x, y: jnp.sum(x**2),
    "fit": lambda x, y: jnp.sum((CASE.matrix @ x - y) ** 2),
}


def simulated(count, *, batch=4, key=0, sampler=None, asked=ASKED, **settings):
    sampler = CASE.drawer(count=5) if sampler is None else sampler
    key = jax.random.key(key)
    return simulate(
        CASE.problem, sampler, key, count, asked, batch=batch, progress=False, **settings
    )


def test_truths_and_draws_are_those_of_the_simulation_with_that_number():
    found = simulated(6)
    assert found.names == ("norm", "fit")
    assert found.truths.shape == (6, 2) and found.draws.shape == (6, 1, 5, 2)
    key_joint, key_run = jax.random.split(jax.random.fold_in(jax.random.key(0), 5))
    x, y = CASE.problem.simulate(key_joint)
    np.testing.assert_allclose(found.truths[5], [f(x, y) for f in ASKED.values()], rtol=1e-4)
    draws = CASE.drawer(count=5)(key_run, CASE.problem.condition(y))[0]
    expected = [[f(x, y) for f in ASKED.values()] for x in draws]
    np.testing.assert_allclose(found.draws[5, 0], expected, rtol=1e-4)


def test_neither_batch_nor_number_change_a_simulation():
    few, many = simulated(3, batch=2), simulated(9, batch=4)
    np.testing.assert_allclose(few.truths, many.truths[:3], rtol=1e-4)
    np.testing.assert_allclose(few.draws, many.draws[:3], rtol=1e-4)


def test_a_killed_campaign_goes_on_and_repeats_nothing(tmp_path, monkeypatch):
    whole, ran = simulated(10), []
    compiled = campaign._batch

    def dying(*args):
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(1)
        return compiled(*args)

    dying.lower = compiled.lower
    monkeypatch.setattr(campaign, "_batch", dying)
    with pytest.raises(KeyboardInterrupt):
        simulated(10, folder=tmp_path / "c")

    def counting(*args):
        ran.append(1)
        return compiled(*args)

    counting.lower = compiled.lower
    monkeypatch.setattr(campaign, "_batch", counting)
    resumed = simulated(10, folder=tmp_path / "c")
    assert len(ran) == 3
    np.testing.assert_array_equal(resumed.truths, whole.truths)
    np.testing.assert_array_equal(resumed.draws, whole.draws)
    # A finished one is read, and may grow.
    assert len(simulated(7, folder=tmp_path / "c").truths) == 7 and len(ran) == 3
    assert len(simulated(13, folder=tmp_path / "c").truths) == 13 and len(ran) == 4


def test_the_folder_of_another_campaign_is_refused(tmp_path):
    """Another key, number of draws, function of the same name, or quantity of the same name."""
    simulated(4, folder=tmp_path / "c")
    with pytest.raises(ValueError, match="another run"):
        simulated(4, sampler=CASE.drawer(temperature=0.2, count=5), folder=tmp_path / "c")
    other = {"norm": lambda x, y: jnp.sum(2.5 * x**2), "fit": ASKED["fit"]}
    with pytest.raises(ValueError, match="another run"):
        simulated(4, asked=other, folder=tmp_path / "c")
    with pytest.raises(ValueError, match="another run"):
        simulated(4, key=1, folder=tmp_path / "c")
    with pytest.raises(ValueError, match="another run"):
        simulated(4, batch=2, folder=tmp_path / "c")


def test_a_draw_that_the_prior_excludes_ranks_last():
    def asked(x, y):
        return jnp.where(x[0] > 0, -jnp.inf, x[0])

    found = simulate(
        CASE.problem, CASE.drawer(count=5), jax.random.key(0), 4, {"f": asked}, progress=False
    )
    truths = found.truths[np.arange(4), 0]
    u = randomised_ranks(truths, found.draws[:, 0, :, 0], np.random.default_rng(0))
    excluded = found.draws[:, 0, :, 0] < -1e30
    below = (excluded | (found.draws[:, 0, :, 0] < truths[:, None])).sum(axis=1)
    assert excluded.any() and np.all(u[truths > -1e30] >= (below / 6)[truths > -1e30])


def test_a_run_that_diverges_is_named():
    def diverging(key, posterior):
        return jnp.full((1, 5, 6), jnp.nan)

    with pytest.raises(NonFiniteError, match="simulation 0: norm of a draw is NaN"):
        simulated(4, sampler=diverging)


def test_simulations_that_were_not_asked_for_decide_nothing():
    """Of a batch of four the fourth diverges: three are three, and four are refused."""
    fourth = jax.random.split(jax.random.fold_in(jax.random.key(0), 3))[1]

    def once(key, posterior):
        lost = jnp.all(jax.random.key_data(key) == jax.random.key_data(fourth))
        return jnp.where(lost, jnp.nan, CASE.drawer(count=5)(key, posterior))

    assert len(simulated(3, sampler=once).truths) == 3
    with pytest.raises(NonFiniteError, match="simulation 3"):
        simulated(4, sampler=once)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"asked": {"vector": lambda x, y: x}}, "vector is no real number"),
        ({"asked": {"field": lambda x, y: 1j * x[0]}}, "field is no real number"),
        ({"asked": {"odd": lambda x, y: jnp.log(-jnp.sum(x**2))}}, "of the object itself is NaN"),
        ({"asked": {}}, "no quantities"),
        ({"sampler": lambda key, p: jnp.zeros((5, 6))}, r"draws of shape \(5, 6\): give"),
        ({"settings": Settings(thin=0)}, "thin 0: give a whole number, 1 or more"),
        ({"settings": Settings(draws=20.5)}, "draws 20.5: give a whole number"),
        ({"settings": Settings(warmup=-5)}, "warmup -5: give a whole number, 0 or more"),
    ],
)
def test_what_cannot_be_ranked_is_refused_at_once(change, message):
    with pytest.raises(ValueError, match=message):
        simulated(4, **change)


@pytest.mark.parametrize("settings", [{"count": 0}, {"count": 2.5}, {"count": 4, "batch": 0}])
def test_bad_numbers_are_refused(settings):
    with pytest.raises(ValueError, match="give a whole number, 1 or more"):
        simulated(**settings)
