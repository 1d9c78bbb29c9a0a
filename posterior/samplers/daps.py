"""Decoupled annealing: an object that explains the recording is found at every level anew."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models.annealing import component_sd
from ..models.priors.base import Prior
from ..models.realview import normal_like
from ..problem import Posterior
from .base import RunSampler
from .checks import check_at_least, check_gaussian, check_levels
from .coupled import coupled_moves


class DAPSState(NamedTuple):
    """Everything a step needs: the object, before its annealing error of the level is added.

    `index` counts levels within the current draw.
    """

    position: jax.Array
    origin: jax.Array | None
    index: jax.Array
    sigmas: jax.Array
    posterior: Posterior


class DAPSInfo(NamedTuple):
    """Statistics of one level; acceptance is that of the moves under the likelihood."""

    sigma: jax.Array
    acceptance_rate: jax.Array


class DAPS(RunSampler):
    """Decoupled annealing posterior sampling: each draw is the end of a run of its own.

    Zhang, Chu, Berner, Meng, Anandkumar and Song (2024), arXiv 2407.01521. At each of `levels`
    geometric levels s, from `sigma_max` (None: the prior's scale) to `sigma_min` (None: 1 % of the
    noise, not below the finest level that the prior knows),

    - the object gets an annealing error of level s: x~ = x + s n, n standard normal;
    - the probability flow takes x~ back to a clean object x^, in `flow_steps` Euler steps;
    - x is drawn from p(y | x) N(x; x^, s^2), by `moves` MALA steps with the exact likelihood where
      the paper has Langevin steps without a test (coupled.py).

    The spread s of the object about x^ is the paper's choice too. A level s is s/2 per real
    component of complex objects.

    An approximation that does not vanish, and is not calibrated: given x~ the object is taken to be
    normal about x^, with a spread that the prior does not know of. Gaussian priors give a closed
    form of the draws: at a prior sd of 0.2 they are 2, 6 and 13 % wider than the posterior under
    white noise of 0.05, 0.1 and 0.2, and off by up to 0.3 sd (the tests). `init` raises ValueError
    for a prior with another perturbation.
    """

    levels: int = eqx.field(static=True, default=100)
    flow_steps: int = eqx.field(static=True, default=5)
    moves: int = eqx.field(static=True, default=20)
    step_size: float = 0.7
    sigma_max: float | None = None
    sigma_min: float | None = None

    shared: ClassVar[tuple[str, ...]] = ("posterior", "index", "sigmas")

    def __check_init__(self):
        check_at_least(
            ("levels", self.levels, 2),
            ("flow_steps", self.flow_steps, 1),
            ("moves", self.moves, 1),
        )
        if not 0 < self.step_size < 2:
            raise ValueError(f"step_size {self.step_size}: a fraction, stable between 0 and 2")
        check_levels(sigma_max=self.sigma_max, sigma_min=self.sigma_min)

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> DAPSState:
        """State before the first level. Every draw starts anew from `position`, if given."""
        check_gaussian(self, posterior)
        sigma_max, sigma_min = posterior.annealing_range("convolved")
        sigma_max = sigma_max if self.sigma_max is None else self.sigma_max
        sigma_min = sigma_min if self.sigma_min is None else self.sigma_min
        start = posterior.start(key) if position is None else position
        return DAPSState(
            position=start,
            origin=position,
            index=jnp.zeros((), jnp.int32),
            sigmas=jnp.geomspace(sigma_max, sigma_min, self.levels).astype(start.real.dtype),
            posterior=posterior,
        )

    def steps_per_draw(self) -> int:
        """All levels."""
        return self.levels

    def step(self, key: jax.Array, state: DAPSState) -> tuple[DAPSState, DAPSInfo]:
        """The object of the level of `state.index`, given that of the level before."""
        key_start, key_noise, key_moves = jax.random.split(key, 3)
        x = jax.lax.cond(
            state.index == 0, lambda: self.restarted(key_start, state), lambda: state.position
        )
        posterior, sigma = state.posterior, state.sigmas[state.index]
        noise = component_sd(sigma, jnp.iscomplexobj(x)) * normal_like(key_noise, x)
        clean = flow(posterior.prior, (x + noise).astype(x.dtype), sigma, self.flow_steps)
        begin = posterior.likelihood.feasible(clean)
        x, acceptance = coupled_moves(
            key_moves, posterior, begin, clean, sigma, self.moves, self.step_size
        )
        state = state._replace(position=x, index=(state.index + 1) % self.levels)
        return state, DAPSInfo(sigma, acceptance)


def flow(prior: Prior, x: jax.Array, sigma: jax.Array, steps: int) -> jax.Array:
    """The end of the probability flow from the annealed `x` at level `sigma`; shaped as `x`.

    dx/ds = (x - D(x, s))/s, in Euler steps between levels that fall geometrically to 1/`steps` of
    `sigma` and then to 0: the last step ends in D.
    """
    fractions = np.append(np.geomspace(1.0, 1 / steps, steps), 0.0)
    levels = (sigma * fractions).astype(sigma.dtype)

    def advance(x: jax.Array, args: tuple) -> tuple[jax.Array, None]:
        level, following = args
        clean = prior.denoise(x, level)
        return (clean + following / level * (x - clean)).astype(x.dtype), None

    return jax.lax.scan(advance, x, (levels[:-1], levels[1:]))[0]
