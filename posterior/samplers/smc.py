"""Tempered sequential Monte Carlo, from the prior to the posterior: finds far modes by itself.

An energy network has a density but no exact draws, and a start of other draws would bias all that
follows: there the particles come from a normal distribution as broad as the pictures
(`Prior.tempering_base`), whose density is tempered away as the prior comes in.
"""

from typing import Any, ClassVar, NamedTuple

import blackjax
import blackjax.smc.resampling
import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.realview import from_real, to_real
from ..problem import Posterior
from .base import PopulationSampler


class TemperedState(NamedTuple):
    """The particles in the real view with their weights, and the tuned leapfrog step."""

    inner: Any
    step_size: jax.Array
    acceptance: jax.Array
    done: jax.Array
    posterior: Posterior


class TemperedInfo(NamedTuple):
    """Statistics of one tempering step."""

    temperature: jax.Array
    acceptance_rate: jax.Array
    step_size: jax.Array


class TemperedSMC(PopulationSampler):
    """Adaptive tempered SMC on BlackJAX's: particles of the prior, moved to the posterior.

    Each step raises the power of what is added to the prior (of the prior too, where it is an
    energy network's) so far that the effective sample size stays at
    `target_ess` of the particles, resamples them and moves them by `moves` HMC steps of `leapfrog`
    steps each; mass matrix and step size follow the particles. A last resampling and move at power
    one leaves equally weighted draws (Del Moral, Doucet and Jasra 2006). Each chain is an SMC run
    of its own and its particles are its draws: correlated through their ancestors, without order.

    Exact as the particles of a chain grow: of 24 normal unknowns the variance is 3 % too large with
    200 of them (1 % with 30 moves), and within 0.2 % with 1000.
    """

    moves: int = eqx.field(static=True, default=8)
    leapfrog: int = eqx.field(static=True, default=8)
    target_ess: float = eqx.field(static=True, default=0.8)

    shared: ClassVar[tuple[str, ...]] = ("posterior",)

    def __check_init__(self):
        if self.moves < 1 or self.leapfrog < 1:
            raise ValueError(f"moves {self.moves}, leapfrog {self.leapfrog}: give 1 or more")
        if not 0 < self.target_ess < 1:
            raise ValueError(f"target_ess {self.target_ess}: a fraction between 0 and 1")

    def init(self, key: jax.Array, posterior: Posterior, size: int = 1000) -> TemperedState:
        """`size` particles of the prior, or of its `tempering_base`, at power zero.

        Raises ValueError for an energy of the signal-dependent error.
        """
        keys, base = jax.random.split(key, size), posterior.prior.tempering_base()
        particles = jax.vmap(lambda k: to_real(base.sample(k)))(keys)
        dtype = particles.dtype
        inner = blackjax.smc.tempered.TemperedSMCState(
            particles, jnp.full(size, 1 / size, dtype), jnp.zeros((), dtype)
        )
        # HMC keeps its acceptance in n dimensions with a step that shrinks as n^(-1/4).
        step_size = jnp.asarray(particles.shape[1] ** -0.25, dtype)
        zero = jnp.zeros((), dtype)
        return TemperedState(inner, step_size, zero, jnp.zeros((), bool), posterior)

    def step(self, key: jax.Array, state: TemperedState) -> tuple[TemperedState, TemperedInfo]:
        """One rise of the power; a finished population stays as it is."""
        finishing = state.inner.tempering_param >= 1
        inner, info = self._kernel(state).step(key, state.inner)
        acceptance = jnp.mean(info.update_info.acceptance_rate)
        # HMC's optimum is 0.65 to 0.9; the step follows over the temperatures.
        step_size = state.step_size * jnp.exp(0.7 * (acceptance - 0.8))
        posterior, state = state.posterior, state._replace(posterior=None)
        moved = TemperedState(inner, step_size, acceptance, finishing, None)
        state = jax.tree.map(lambda new, old: jnp.where(state.done, old, new), moved, state)
        state = state._replace(posterior=posterior)
        info = TemperedInfo(state.inner.tempering_param, state.acceptance, state.step_size)
        return state, info

    def population(self, state: TemperedState) -> jax.Array:
        """The particles as objects, equally weighted once the state is done."""
        shape, dtype = state.posterior.shape, state.posterior.dtype
        return jax.vmap(lambda v: from_real(v, shape, dtype))(state.inner.particles)

    def _kernel(self, state: TemperedState) -> Any:
        posterior = state.posterior

        base = posterior.prior.tempering_base()

        def as_object(v: jax.Array) -> jax.Array:
            return from_real(v, posterior.shape, posterior.dtype)

        def log_base(v: jax.Array) -> jax.Array:
            return base.log_prob(as_object(v))

        def log_added(v: jax.Array) -> jax.Array:
            if base is posterior.prior:
                return posterior.log_likelihood(as_object(v))
            return posterior.log_prob(as_object(v)) - log_base(v)

        weights = state.inner.weights[:, None]
        mean = jnp.sum(weights * state.inner.particles, axis=0)
        spread = jnp.sum(weights * (state.inner.particles - mean) ** 2, axis=0)
        parameters = {
            "step_size": state.step_size[None],
            "inverse_mass_matrix": jnp.maximum(spread, jnp.finfo(spread.dtype).tiny)[None],
        }
        hmc = blackjax.hmc.build_kernel()
        return blackjax.adaptive_tempered_smc(
            log_base,
            log_added,
            lambda *args, **kwargs: hmc(*args, num_integration_steps=self.leapfrog, **kwargs),
            blackjax.hmc.init,
            parameters,
            blackjax.smc.resampling.systematic,
            self.target_ess,
            num_mcmc_steps=self.moves,
        )
