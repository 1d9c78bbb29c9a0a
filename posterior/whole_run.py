"""A whole run as one pure function: to be compiled, and batched over posteriors, by others."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .problem import Posterior
from .samplers import Ensemble
from .samplers.base import (
    PopulationSampler,
    Sampler,
    chain_keys,
    fold_each,
    populations,
    positions,
    vmap_init,
    vmap_own_warmup,
    vmap_population,
    vmap_step,
)
from .samplers.checks import check_run


def whole_run(
    sampler: Sampler,
    posterior: Posterior,
    key: jax.Array,
    *,
    chains: int = 1,
    draws: int = 100,
    warmup: int | None = None,
    thin: int = 1,
    record: Callable[[jax.Array], Any] = lambda x: x,
) -> Any:
    """`record` of every draw, in leaves (chains, draws, ...): the draws that `sample` makes.

    As `sample`, without progress, checkpoints, checks, or a start of one's own; traceable, so that
    `jax.vmap` runs it on many posteriors at once. Chains that diverge give NaN. `record`: a
    function of one object; what it returns is all that is held.
    Raises ValueError for lengths that are no whole numbers, and for `Ensemble`, which is not
    written in JAX.
    """
    check_run(chains, draws, thin, warmup)
    if isinstance(sampler, Ensemble):
        raise ValueError("Ensemble (emcee) cannot be compiled: take another sampler, or `sample`")
    warmup = sampler.default_warmup() if warmup is None else warmup
    keys = chain_keys(key, chains)
    if isinstance(sampler, PopulationSampler):
        return _population(sampler, posterior, keys, draws, record)
    states = _warmed(sampler, posterior, keys, warmup)
    per_draw = sampler.steps_per_draw() * thin

    def one_draw(states: Any, index: jax.Array) -> tuple[Any, Any]:
        first = index * per_draw

        def move(i: jax.Array, states: Any) -> Any:
            return vmap_step(sampler, fold_each(fold_each(keys, 2), first + i), states)[0]

        states = jax.lax.fori_loop(0, per_draw, move, states)
        return states, jax.vmap(record)(positions(sampler, states))

    _, found = jax.lax.scan(one_draw, states, jnp.arange(draws))
    return jax.tree.map(lambda a: jnp.swapaxes(a, 0, 1), found)


def _warmed(sampler: Sampler, posterior: Posterior, keys: jax.Array, warmup: int) -> Any:
    """States of the chains after their warm-up."""
    states = vmap_init(sampler, fold_each(keys, 0), posterior, None)
    keys = fold_each(keys, 1)
    if not warmup:
        return states
    if sampler.tunes_itself():
        return vmap_own_warmup(sampler, keys, states, warmup)
    adaptation = sampler.adaptation()
    if adaptation is None:
        return jax.lax.fori_loop(
            0, warmup, lambda i, s: vmap_step(sampler, fold_each(keys, i), s)[0], states
        )

    def tune(i: jax.Array, carry: tuple) -> tuple:
        return adaptation.step(i, warmup, fold_each(keys, i), *carry)

    carry = (states, adaptation.init(states))
    return adaptation.finish(*jax.lax.fori_loop(0, adaptation.steps(warmup), tune, carry))


def _population(
    sampler: PopulationSampler, posterior: Posterior, keys: jax.Array, size: int, record: Callable
) -> Any:
    states = vmap_population(sampler, fold_each(keys, 0), posterior, size)

    def move(carry: tuple) -> tuple:
        step, states = carry
        return step + 1, vmap_step(sampler, fold_each(fold_each(keys, 1), step), states)[0]

    _, states = jax.lax.while_loop(lambda carry: ~jnp.all(carry[1].done), move, (0, states))
    return jax.vmap(jax.vmap(record))(populations(sampler, states))
