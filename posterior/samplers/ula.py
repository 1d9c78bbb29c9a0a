"""Unadjusted Langevin: the exact score, no correction, a bias that is known for Gaussians."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..problem import Posterior
from .base import ChainInfo, Sampler, langevin_step


class ULAState(NamedTuple):
    """Everything a step needs."""

    position: jax.Array
    posterior: Posterior


class ULA(Sampler):
    """x + h score(x) + sqrt(2 h) n, without a Metropolis test (eq:LD).

    `step_size` h is in the squared units of the object. On a Gaussian of variance v the stationary
    variance is v/(1 - h/(2 v)); it diverges for h > 2 v. Roberts and Tweedie (1996).
    """

    step_size: float

    def __check_init__(self):
        if not self.step_size > 0:
            raise ValueError(f"step_size {self.step_size}: it must be positive")

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> ULAState:
        """State at `position`, or at a dispersed start."""
        return ULAState(posterior.start(key) if position is None else position, posterior)

    def step(self, key: jax.Array, state: ULAState) -> tuple[ULAState, ChainInfo]:
        """One Langevin step."""
        score = state.posterior.score(state.position)
        step_size = jnp.asarray(self.step_size, score.real.dtype)
        position = langevin_step(key, state.position, score, step_size)
        return state._replace(position=position), ChainInfo(jnp.linalg.norm(score))
