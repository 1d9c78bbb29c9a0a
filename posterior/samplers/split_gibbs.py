"""Split Gibbs: the likelihood and the prior take turns, coupled through an auxiliary image."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.priors.base import Prior
from ..problem import Posterior
from .base import RunSampler
from .checks import check_at_least, check_gaussian, check_levels
from .coupled import coupled_moves
from .reverse import reverse_diffusion

# Finest coupling, as a fraction of the smallest measurement noise.
_FINEST_COUPLING = 0.3
# The last part of the iterations, all at the finest coupling.
_HELD = 0.25


class SplitGibbsState(NamedTuple):
    """Everything a step needs; `index` counts iterations within the current draw.

    `sigmas` are the couplings rho, which are annealing levels.
    """

    position: jax.Array
    auxiliary: jax.Array
    origin: jax.Array | None
    index: jax.Array
    sigmas: jax.Array
    posterior: Posterior


class SplitGibbsInfo(NamedTuple):
    """Statistics of one iteration; acceptance is that of the likelihood's moves."""

    rho: jax.Array
    acceptance_rate: jax.Array


class SplitGibbs(RunSampler):
    """Split Gibbs with a denoiser as the prior: each draw is the end of a run of its own.

    Vono, Dobigeon and Chainais (2019); Bouman and Buzzard (2023), "Generative plug and play"; Wu et
    al. (2024), PnP-DM. The object x and an auxiliary image u of the same shape have the joint
    density p(x) p(y | u) N(u; x, rho^2), and one step draws each given the other:

    - likelihood: u ~ p(y | u) N(u; x, rho^2), by `moves` MALA steps with the exact likelihood,
      `step_size` in units of the curvature of both. Under Identity optics each pixel has a
      Metropolis test of its own; under others the image has one, and the step shrinks as
      n^(-1/3) with its n real dimensions (Roberts and Rosenthal 1998).
    - prior: x ~ p(x) N(x; u, rho^2), which is denoising u: `prior_steps` steps of the reverse
      diffusion from level rho down (reverse.py).

    `iterations` a draw: rho falls geometrically from `rho_max` (None: the prior's scale) to
    `rho_min` (None: 0.3 of the smallest measurement noise, not below the finest level that the
    prior knows) and stays there for the last quarter. A level rho is rho/2 per real component of a
    complex object.

    Approximations. Draws are of the prior and of a likelihood broadened by rho_min: with Gaussian
    noise of sd s per real component, noise of variance s^2 + rho_min^2, an sd up to 4 % too wide at
    the default. So rho_min must be small against the noise in the darkest pixels too; it need not
    be finer still, for u moves by about rho an iteration, and no longer reaches its equilibrium.
    The reverse diffusion errs by less than 1 % of rho^2 at 8 steps on Gaussian priors. Optics that
    mix pixels make the likelihood's moves short: behind a dense matrix of six complex unknowns the
    means were 0.08 sd off with 80 iterations of 20 moves, and right (0.02) with 200. Odds between
    modes are those of the level at which the modes separate, as in `AnnealedLangevin`.

    `init` raises ValueError for a prior with the signal-dependent perturbation.
    """

    iterations: int = eqx.field(static=True, default=80)
    moves: int = eqx.field(static=True, default=10)
    prior_steps: int = eqx.field(static=True, default=8)
    step_size: float = 0.7
    rho_max: float | None = None
    rho_min: float | None = None

    shared: ClassVar[tuple[str, ...]] = ("posterior", "index", "sigmas")

    def __check_init__(self):
        check_at_least(
            ("iterations", self.iterations, 2),
            ("moves", self.moves, 1),
            ("prior_steps", self.prior_steps, 1),
        )
        if not 0 < self.step_size < 2:
            raise ValueError(f"step_size {self.step_size}: a fraction, stable between 0 and 2")
        check_levels(rho_max=self.rho_max, rho_min=self.rho_min)

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> SplitGibbsState:
        """State before the first iteration. Every draw starts anew from `position`, if given."""
        check_gaussian(self, posterior)
        start = posterior.start(key) if position is None else position
        return SplitGibbsState(
            position=start,
            auxiliary=posterior.likelihood.feasible(start),
            origin=position,
            index=jnp.zeros((), jnp.int32),
            sigmas=self._couplings(posterior).astype(start.real.dtype),
            posterior=posterior,
        )

    def steps_per_draw(self) -> int:
        """All iterations."""
        return self.iterations

    def step(
        self, key: jax.Array, state: SplitGibbsState
    ) -> tuple[SplitGibbsState, SplitGibbsInfo]:
        """One iteration: the auxiliary image given the object, then the object given it."""
        key_start, key_likelihood, key_prior = jax.random.split(key, 3)
        x, u = jax.lax.cond(
            state.index == 0,
            lambda: self._restart(key_start, state),
            lambda: (state.position, state.auxiliary),
        )
        rho, posterior = state.sigmas[state.index], state.posterior
        u, acceptance = coupled_moves(
            key_likelihood, posterior, u, x, rho, self.moves, self.step_size
        )
        x = self._object_given(key_prior, posterior.prior, u, rho)
        index = (state.index + 1) % self.iterations
        state = state._replace(position=x, auxiliary=u, index=index)
        return state, SplitGibbsInfo(rho, acceptance)

    def _couplings(self, posterior: Posterior) -> jax.Array:
        # The path "split" starts just under the smallest noise.
        noise, broadest = (posterior.annealing_range(p)[0] for p in ("split", "convolved"))
        finest = jnp.maximum(_FINEST_COUPLING * noise, posterior.prior.finest)
        rho_min = finest if self.rho_min is None else jnp.asarray(self.rho_min)
        rho_max = jnp.maximum(broadest, rho_min) if self.rho_max is None else self.rho_max
        falling = max(1, round((1 - _HELD) * self.iterations))
        held = jnp.full(self.iterations - falling, rho_min)
        return jnp.concatenate([jnp.geomspace(rho_max, rho_min, falling), held])

    def _restart(self, key: jax.Array, state: SplitGibbsState) -> tuple[jax.Array, jax.Array]:
        x = self.restarted(key, state)
        return x, state.posterior.likelihood.feasible(x)

    def _object_given(
        self, key: jax.Array, prior: Prior, u: jax.Array, rho: jax.Array
    ) -> jax.Array:
        """A draw of p(x) N(x; u, rho^2): reverse diffusion from u at level rho to level 0."""
        return reverse_diffusion(key, prior, u, rho, self.prior_steps)
