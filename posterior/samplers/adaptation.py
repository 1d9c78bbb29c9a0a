"""Warm-up of a Metropolis sampler: step size by dual averaging, metric by windows.

All chains are pooled: one step size, one metric. The state of the sampler is only written to, so
that a tuned chain is an ordinary Markov chain (Hoffman and Gelman 2014; the windows are Stan's).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .base import Adaptation, Sampler, State, vmap_step
from .metric import Metric


class Spread(NamedTuple):
    """Running count, mean and sum of squares (Re and Im apart) of batches of a pytree of arrays."""

    count: jax.Array
    mean: Any
    squares: Any


class AdaptationState(NamedTuple):
    """Dual averaging of the log step size, and the spreads of the current window."""

    log_step: jax.Array
    log_step_mean: jax.Array
    error_mean: jax.Array
    centre: jax.Array
    count: jax.Array
    position: Spread
    score: Spread


class MetropolisAdaptation(Adaptation):
    """For samplers whose state has position, score, step_size and metric."""

    def __init__(self, sampler: Sampler, learn_metric: bool = True):
        self.sampler = sampler
        self.learn_metric = learn_metric

    def steps(self, warmup: int) -> int:
        """The asked length."""
        return warmup

    def init(self, states: State) -> AdaptationState:
        """Fresh dual averaging around the sampler's own step size, empty spreads."""
        position, score = _coordinates(states)
        return AdaptationState(
            *_restart(jnp.log(states.step_size)), empty_spread(position), empty_spread(score)
        )

    def step(
        self,
        index: jax.Array,
        warmup: int,
        keys: jax.Array,
        states: State,
        adapted: AdaptationState,
    ) -> tuple[State, AdaptationState]:
        """One step of all chains, then of the step size; a new metric at a window's end."""
        states, info = vmap_step(self.sampler, keys, states)
        adapted = _average(adapted, jnp.mean(info.acceptance_rate), self.sampler.target)
        states = states._replace(step_size=jnp.exp(adapted.log_step))
        if not self.learn_metric:
            return states, adapted
        position, score = _coordinates(states)
        adapted = adapted._replace(
            position=update_spread(adapted.position, position),
            score=update_spread(adapted.score, score),
        )
        at_end = jnp.asarray(_window_ends(warmup))[index]
        return jax.lax.cond(at_end, self._new_metric, lambda *a: a, states, adapted)

    def finish(self, states: State, adapted: AdaptationState) -> State:
        """The averaged step size."""
        return states._replace(step_size=jnp.exp(adapted.log_step_mean))

    def _new_metric(self, states: State, adapted: AdaptationState) -> tuple[State, AdaptationState]:
        metric = states.metric.learned(variance(adapted.position), variance(adapted.score))
        # The step size is in units of the metric: keep the length of a typical move.
        factor = _typical(states.metric) / _typical(metric)
        log_step = adapted.log_step + jnp.log(factor)
        states = states._replace(metric=metric, step_size=jnp.exp(log_step))
        return states, AdaptationState(
            *_restart(log_step),
            jax.tree.map(jnp.zeros_like, adapted.position),
            jax.tree.map(jnp.zeros_like, adapted.score),
        )


def empty_spread(batch: Any) -> Spread:
    """A spread of nothing, for batches like this pytree of arrays (chain axis first)."""
    zeros = jax.tree.map(lambda x: jnp.zeros_like(x[0]), batch)
    return Spread(jnp.zeros((), jax.tree.leaves(batch)[0].real.dtype), zeros, zeros)


def update_spread(spread: Spread, batch: Any) -> Spread:
    """Add a batch by Chan's pairwise formula; Re and Im apart."""
    n = jax.tree.leaves(batch)[0].shape[0]
    total = spread.count + n
    batch_mean = jax.tree.map(lambda x: x.mean(axis=0), batch)
    delta = jax.tree.map(jnp.subtract, batch_mean, spread.mean)
    mean = jax.tree.map(lambda m, d: m + d * (n / total), spread.mean, delta)
    squares = jax.tree.map(
        lambda s, x, m, d: s + _square(x - m).sum(axis=0) + _square(d) * (spread.count * n / total),
        spread.squares,
        batch,
        batch_mean,
        delta,
    )
    return Spread(total, mean, squares)


def variance(spread: Spread) -> Any:
    """Variance of Re and, in the imaginary part, of Im."""
    return jax.tree.map(lambda s: s / jnp.maximum(spread.count - 1, 1), spread.squares)


def _coordinates(states: State) -> tuple[Any, Any]:
    """Positions and scores of all chains in the coordinates of their metric."""
    metric = states.metric
    return (
        jax.vmap(metric.position_coordinates)(states.position),
        jax.vmap(metric.score_coordinates)(states.score),
    )


def _square(x: jax.Array) -> jax.Array:
    if jnp.iscomplexobj(x):
        return jax.lax.complex(jnp.square(x.real), jnp.square(x.imag))
    return jnp.square(x)


def _restart(log_step: jax.Array) -> tuple[jax.Array, ...]:
    """Dual averaging afresh around a step size; its fields in order."""
    zero = jnp.zeros_like(log_step)
    return log_step, log_step, zero, log_step + jnp.log(2.0), zero


def _average(adapted: AdaptationState, acceptance: jax.Array, target: float) -> AdaptationState:
    """Nesterov's dual averaging, with the constants of Hoffman and Gelman (2014)."""
    gamma, offset, kappa = 0.05, 10.0, 0.75
    count = adapted.count + 1
    weight = 1 / (count + offset)
    error = (1 - weight) * adapted.error_mean + weight * (target - acceptance)
    log_step = adapted.centre - jnp.sqrt(count) / gamma * error
    forget = count**-kappa
    mean = forget * log_step + (1 - forget) * adapted.log_step_mean
    return adapted._replace(log_step=log_step, log_step_mean=mean, error_mean=error, count=count)


def _typical(metric: Metric) -> jax.Array:
    """Geometric mean of the variances of a metric."""
    parts = metric.variance
    parts = jnp.stack([parts.real, parts.imag]) if jnp.iscomplexobj(parts) else parts
    return jnp.exp(jnp.mean(jnp.log(parts)))


def _window_ends(warmup: int) -> np.ndarray:
    """Where the metric is renewed: windows that double, none in the last fifth."""
    ends = np.zeros(max(warmup, 1), dtype=bool)
    begin, last = 0, warmup - warmup // 5
    width = max(10, warmup // 100)
    while begin + width < last:
        begin += width
        width *= 2
        # The last window takes what is left, rather than leave a short one.
        if begin + width > last:
            begin = last
        ends[begin - 1] = True
    return ends
