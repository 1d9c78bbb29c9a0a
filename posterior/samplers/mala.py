"""Metropolis-adjusted Langevin: exact for any posterior with a log-density."""

import warnings
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.priors.conservative import line_integral, require_gradient
from ..models.realview import normal_like
from ..problem import Posterior
from .adaptation import MetropolisAdaptation
from .base import Adaptation, Sampler
from .checks import check_at_least
from .metric import METRICS, Metric

# Nats that a Metropolis test is wrong by.
_REFUSED, _DOUBTED = 1.0, 0.1


class MALAState(NamedTuple):
    """Everything a step needs; `step_size` and `metric` are set by warm-up.

    `log_prob`: of the posterior, or of the likelihood alone where the prior is integrated.
    """

    position: jax.Array
    log_prob: jax.Array
    score: jax.Array
    step_size: jax.Array
    metric: Metric
    posterior: Posterior


class MALAInfo(NamedTuple):
    """Statistics of one step."""

    acceptance_rate: jax.Array
    log_prob: jax.Array


class MALA(Sampler):
    """Langevin proposals with a Metropolis test (Roberts and Tweedie 1996).

    Proposal x + h M score + sqrt(2 h) R n, M = R R^T. `step_size` h is in units of the metric M;
    warm-up adapts it to an acceptance of `target` (0.574, optimal in many dimensions: Roberts and
    Rosenthal 1998) and learns M, of the kind `preconditioner`: "diagonal", "fourier", "none", or
    "auto": Fourier-diagonal for pictures of 256 pixels or more, diagonal otherwise.

    `nodes` is for a prior that has a score and no density: its part of the Metropolis ratio is then
    the integral of the score along the proposed move, by Gauss-Legendre with so many nodes. Exact
    if the score is a gradient; `sample` measures how far it is from one first, and refuses, or
    warns (`check`).
    """

    step_size: float = 0.1
    preconditioner: str = eqx.field(static=True, default="auto")
    target: float = eqx.field(static=True, default=0.574)
    nodes: int | None = eqx.field(static=True, default=None)

    shared: ClassVar[tuple[str, ...]] = ("posterior", "step_size", "metric")

    def __check_init__(self):
        if not self.step_size > 0:
            raise ValueError(f"step_size {self.step_size}: it must be positive")
        if self.preconditioner not in (*METRICS, "none", "auto"):
            raise ValueError(
                f"unknown preconditioner {self.preconditioner!r}: "
                "use 'auto', 'diagonal', 'fourier' or 'none'"
            )
        if not 0 < self.target < 1:
            raise ValueError(f"target acceptance {self.target}: it must lie between 0 and 1")
        if self.nodes is not None:
            check_at_least(("nodes", self.nodes, 1))

    def check(self, key: jax.Array, posterior: Posterior, start: jax.Array | None = None) -> None:
        """Measure, where `nodes` are given, how far the prior's score is from a gradient.

        Of a learnt prior; any other's score is the gradient of its density. Round triangles of 0.3
        of its finest level in every pixel, about a move where the prior is narrowest, at `start` or
        at draws of the prior: raises ValueError where the integral is more than 1 nat, warns
        (UserWarning) from 0.1. It grows with the number of pixels.
        """
        prior = posterior.prior
        if self.nodes is None or not prior.finest > 0:
            return
        found = require_gradient(prior, key, prior.finest, _REFUSED, start=start)
        if found.loop > _DOUBTED:
            warnings.warn(
                f"the prior's score integrates to {found.loop:.2g} nats round a loop (to "
                f"{found.leg:.2g} along a side): it is no gradient, and the Metropolis test is as "
                "wrong; an EnergyPrior has none of this",
                stacklevel=3,
            )

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> MALAState:
        """State at `position`, or at a dispersed start, with the identity metric."""
        position = posterior.start(key) if position is None else position
        log_prob, score = self._value_and_score(posterior, position)
        step_size = jnp.asarray(self.step_size, log_prob.dtype)
        metric = self._metric_kind(position).identity(position)
        return MALAState(position, log_prob, score, step_size, metric, posterior)

    def step(self, key: jax.Array, state: MALAState) -> tuple[MALAState, MALAInfo]:
        """One proposal, accepted or not."""
        key_noise, key_accept = jax.random.split(key)
        h, metric = state.step_size, state.metric
        noise = normal_like(key_noise, state.position)
        move = h * metric.root_adjoint(state.score) + jnp.sqrt(2 * h) * noise
        position = state.position + metric.root(move)
        log_prob, score = self._value_and_score(state.posterior, position)
        # In units of M the way back needs the noise -(noise + sqrt(h/2) R^T (s + s')).
        noise_back = noise + jnp.sqrt(h / 2) * metric.root_adjoint(state.score + score)
        log_ratio = log_prob - state.log_prob + 0.5 * (_norm2(noise) - _norm2(noise_back))
        if self.nodes is not None:
            prior = state.posterior.prior
            log_ratio += line_integral(prior, state.position, position, 0.0, self.nodes)
        # A NaN ratio (a proposal where the density is undefined) is a rejection.
        acceptance = jnp.where(jnp.isnan(log_ratio), 0.0, jnp.exp(jnp.minimum(log_ratio, 0.0)))
        accepted = jax.random.uniform(key_accept, dtype=acceptance.dtype) < acceptance
        chosen = jax.tree.map(
            lambda new, old: jnp.where(accepted, new, old),
            (position, log_prob, score),
            (state.position, state.log_prob, state.score),
        )
        state = state._replace(position=chosen[0], log_prob=chosen[1], score=chosen[2])
        return state, MALAInfo(acceptance, state.log_prob)

    def adaptation(self) -> Adaptation:
        """Step size and metric, pooled over the chains."""
        return MetropolisAdaptation(self, learn_metric=self.preconditioner != "none")

    def _value_and_score(self, posterior: Posterior, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        if self.nodes is None:
            return posterior.log_prob_and_score(x)
        value, score = posterior.likelihood.log_prob_and_score(x, posterior.y)
        return value, score + posterior.prior.score(x)

    def _metric_kind(self, x: jax.Array) -> type[Metric]:
        name = self.preconditioner
        if name == "auto":
            name = "fourier" if x.ndim >= 2 and x.size >= 256 else "diagonal"
        return METRICS["diagonal" if name == "none" else name]


def _norm2(x: jax.Array) -> jax.Array:
    return jnp.sum(jnp.square(x.real)) + (
        jnp.sum(jnp.square(x.imag)) if jnp.iscomplexobj(x) else 0.0
    )
