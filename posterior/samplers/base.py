"""The shape of a sampler: a pair of pure functions over a NamedTuple state."""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.annealing import component_sd
from ..models.realview import normal_like
from ..problem import Posterior

State = Any
Info = Any


class Sampler(eqx.Module):
    """Settings of a sampler; it holds no state of a run.

    `init(key, posterior) -> state` and `step(key, state) -> (state, info)` are pure, in the shape
    of BlackJAX. The state is a NamedTuple that holds everything a step needs, the posterior too.
    Fields named in `shared` are the same for every chain and are not batched. `independent`: draws
    of a chain are, whatever its start, so that there is no convergence to check.
    """

    shared: ClassVar[tuple[str, ...]] = ("posterior",)
    independent: ClassVar[bool] = False

    @abc.abstractmethod
    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> State:
        """State at `position`, or at a dispersed start of the sampler's own choice."""

    @abc.abstractmethod
    def step(self, key: jax.Array, state: State) -> tuple[State, Info]:
        """One step; `info` is a NamedTuple of scalars."""

    def position(self, state: State) -> jax.Array:
        """The object the state stands at."""
        return state.position

    def check(self, key: jax.Array, posterior: Posterior, start: jax.Array | None = None) -> None:
        """Refuse, before a run, a posterior or a start that this sampler would be wrong for."""

    def steps_per_draw(self) -> int:
        """Steps from one draw to the next: 1, unless a draw is the end of a longer path."""
        return 1

    def default_warmup(self) -> int:
        """Warm-up steps when none are asked for."""
        return 1000

    def adaptation(self) -> "Adaptation | None":
        """How warm-up tunes this sampler, or None if it has nothing to tune."""
        return None

    def tunes_itself(self) -> bool:
        """Whether warm-up is `own_warmup`, one chain at a time, and not an `adaptation`."""
        return False

    def own_warmup(self, key: jax.Array, state: State, steps: int) -> State:
        """One chain after a warm-up of the sampler's own making."""
        raise NotImplementedError(f"{type(self).__name__} has no warm-up of its own")

    def as_blackjax(self, posterior: Posterior) -> Any:
        """This sampler, bound to a posterior, as a `blackjax.SamplingAlgorithm`."""
        import blackjax

        def init(position: jax.Array, rng_key: jax.Array | None = None) -> State:
            key = jax.random.key(0) if rng_key is None else rng_key
            return self.init(key, posterior, position)

        return blackjax.base.SamplingAlgorithm(init, self.step)


class Adaptation(abc.ABC):
    """Tuning of all chains together during warm-up; it lives outside the sampler's state."""

    @abc.abstractmethod
    def steps(self, warmup: int) -> int:
        """Steps that a warm-up of the asked length takes."""

    @abc.abstractmethod
    def init(self, states: State) -> State:
        """State of the adaptation, from the batched states of the chains."""

    @abc.abstractmethod
    def step(
        self, index: jax.Array, warmup: int, keys: jax.Array, states: State, adapted: State
    ) -> tuple[State, State]:
        """Move every chain once and learn from it."""

    @abc.abstractmethod
    def finish(self, states: State, adapted: State) -> State:
        """The states with the settings to keep."""


class ChainInfo(NamedTuple):
    """Info of an unadjusted sampler: only the norm of the score, a sign of divergence."""

    score_norm: jax.Array


def chain_keys(key: jax.Array, chains: int) -> jax.Array:
    """A key for each chain (chains,): that of chain i depends on i alone."""
    return jax.vmap(lambda i: jax.random.fold_in(key, i))(jnp.arange(chains))


def fold_each(keys: jax.Array, index: jax.Array | int) -> jax.Array:
    """`index` folded into each of the keys (chains,)."""
    return jax.vmap(lambda k: jax.random.fold_in(k, index))(keys)


def chain_axes(state: State, shared: tuple[str, ...]) -> State:
    """in_axes/out_axes of a batched state for `jax.vmap`: 0, but None for shared fields."""
    return type(state)(*(None if name in shared else 0 for name in state._fields))


def vmap_init(sampler: Sampler, keys: jax.Array, posterior: Posterior, positions: Any) -> State:
    """States of many chains; `positions` is None or has a leading chain axis."""
    has_positions = positions is not None
    # The shared fields are found from one abstract state: vmap needs them named beforehand.
    example = eqx.filter_eval_shape(
        sampler.init, keys[0], posterior, positions[0] if has_positions else None
    )
    axes = chain_axes(example, sampler.shared)
    batched = jax.vmap(sampler.init, in_axes=(0, None, 0 if has_positions else None), out_axes=axes)
    return batched(keys, posterior, positions)


def vmap_step(sampler: Sampler, keys: jax.Array, states: State) -> tuple[State, Info]:
    """Step many chains at once."""
    axes = chain_axes(states, sampler.shared)
    return jax.vmap(sampler.step, in_axes=(0, axes), out_axes=(axes, 0))(keys, states)


def vmap_own_warmup(sampler: Sampler, keys: jax.Array, states: State, steps: int) -> State:
    """Many chains, each after its sampler's own warm-up."""
    axes = chain_axes(states, sampler.shared)
    own = jax.vmap(lambda k, s: sampler.own_warmup(k, s, steps), in_axes=(0, axes), out_axes=axes)
    return own(keys, states)


def positions(sampler: Sampler, states: State) -> jax.Array:
    """Where many chains stand: (chains, *shape)."""
    return jax.vmap(sampler.position, in_axes=(chain_axes(states, sampler.shared),))(states)


def langevin_step(
    key: jax.Array, x: jax.Array, score: jax.Array, step: jax.Array, temperature: float = 1.0
) -> jax.Array:
    """x + step score + sqrt(2 step temperature) n (eq:LD); n standard normal in the real view."""
    noise = normal_like(key, x)
    return x + (step * score + jnp.sqrt(2 * step * temperature) * noise).astype(x.dtype)


def noised(key: jax.Array, x: jax.Array, sigma: jax.Array) -> jax.Array:
    """x with an annealing error of level sigma added (eq:o_t)."""
    return x + (component_sd(sigma, jnp.iscomplexobj(x)) * normal_like(key, x)).astype(x.dtype)


class RunSampler(Sampler):
    """A sampler whose every draw is the end of a run of its own, begun at its origin or anywhere.

    A warm-up that is asked for is none: it would stop a draw half-way.
    """

    def default_warmup(self) -> int:
        """None: there is nothing to tune."""
        return 0

    def tunes_itself(self) -> bool:
        """True: see `own_warmup`."""
        return True

    def own_warmup(self, key: jax.Array, state: State, steps: int) -> State:
        """The state as it is."""
        return state

    def restarted(self, key: jax.Array, state: State) -> jax.Array:
        """Where a new run begins: the origin, or a dispersed start, at the broadest level.

        For states with the fields `origin`, `sigmas` (the broadest first) and `posterior`.
        """
        key_start, key_error = jax.random.split(key)
        start = state.posterior.start(key_start) if state.origin is None else state.origin
        return noised(key_error, start, state.sigmas[0])


class PopulationSampler(Sampler):
    """A sampler whose state is a whole population, drawn together and moved until it is done.

    `init(key, posterior, size)` makes the population; states have a boolean field `done`.
    """

    @abc.abstractmethod
    def population(self, state: State) -> jax.Array:
        """The objects: (size, *shape)."""

    def default_warmup(self) -> int:
        """None: a population is moved until it is done."""
        return 0

    def position(self, state: State) -> jax.Array:
        """The first object of the population."""
        return self.population(state)[0]


def vmap_population(
    sampler: PopulationSampler, keys: jax.Array, posterior: Posterior, size: int
) -> State:
    """States of many populations of `size` objects, at their beginning."""
    example = eqx.filter_eval_shape(sampler.init, keys[0], posterior, size)
    axes = chain_axes(example, sampler.shared)
    return jax.vmap(lambda k: sampler.init(k, posterior, size), out_axes=axes)(keys)


def populations(sampler: PopulationSampler, states: State) -> jax.Array:
    """The objects of many populations: (populations, size, *shape)."""
    return jax.vmap(sampler.population, in_axes=(chain_axes(states, sampler.shared),))(states)
