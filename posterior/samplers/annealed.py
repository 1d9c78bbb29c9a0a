"""Annealed Langevin dynamics, Algorithm 1 of the paper, on either path."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.realview import normal_like
from ..problem import Posterior
from .adaptation import AdaptationState, MetropolisAdaptation
from .base import Adaptation, RunSampler, State, vmap_step
from .checks import check_at_least, check_gaussian, check_levels
from .mala import MALA, MALAState
from .metric import Metric
from .reverse import reverse_levels, reverse_step


class AnnealedState(NamedTuple):
    """Everything a step needs; `index` counts steps within the current draw.

    `noise` is the standard normal noise of the last step, half of which the next one takes again.
    """

    position: jax.Array
    noise: jax.Array
    origin: jax.Array | None
    polish: MALAState | None
    index: jax.Array
    sigmas: jax.Array
    step_size: jax.Array
    metric: Metric | None
    posterior: Posterior


class AnnealedInfo(NamedTuple):
    """Statistics of one step; acceptance is NaN where there is no Metropolis test."""

    sigma: jax.Array
    score_norm: jax.Array
    acceptance_rate: jax.Array


class AnnealedLangevin(RunSampler):
    """Annealed Langevin (Algorithm 1, alg:two): each draw is the end of a run of its own.

    `levels` geometric noise levels, `steps` Langevin steps at each. The step at level t is
    alpha_t = step_size * v_t, with v_t the level's variance held under the likelihood's own:
    1/v_t = 1/s_t^2 + curvature (`Posterior.annealing_variance`); where the level is the smaller it
    is the paper's alpha_t = eps sigma_t^2/sigma_T^2.

    The noise of a step is the mean of two, one of them shared with the step before (Leimkuhler and
    Matthews 2013): plain Langevin steps leave a Gaussian of variance v with v/(1 - alpha/(2 v)),
    these leave it with v, whatever the step. `published=True` takes the plain ones.

    `path`: "convolved" (the default) anneals from the prior's scale down and needs no start;
    "split" is the paper's, from just under the measurement noise, and cannot travel: give
    `sample(..., start=)` an estimate. `published=True` is the printed form of the score (complex
    objects, "split"): too wide, for comparison. `polish` > 0 adds that many MALA steps on the exact
    posterior, tuned in warm-up, to each draw. `sigma_max`, `sigma_min` override the levels' range.

    `descent` > 0 ends the levels where the data are about as fine, and draws the object given the
    annealed one in that many steps of reverse diffusion, by the prior alone. For score networks:
    a Langevin step at level sigma multiplies their errors by 1/sigma^2 beside the data, so that at
    the finest levels the errors of many pixels outweigh the data, and longer runs are worse. The
    price is a likelihood broadened by the last level. Gaussian perturbation only.

    Widths of a mode are right to a few per cent; the odds between modes that lie far apart are
    not guaranteed. They freeze at the level where the modes separate, whose likelihood takes the
    annealing error to be independent of the object; modes that the data cannot tell apart (twins,
    shifts, phases) keep the odds of the prior. `polish` cannot move them: check with TemperedSMC.

    For the signal-dependent perturbation steps are taken in the root sqrt(x), reflected at zero:
    there the error has one variance at every brightness, and the object stays positive.
    """

    levels: int = eqx.field(static=True, default=500)
    steps: int = eqx.field(static=True, default=10)
    step_size: float = 0.6
    path: str | None = eqx.field(static=True, default=None)
    published: bool = eqx.field(static=True, default=False)
    polish: int = eqx.field(static=True, default=0)
    descent: int = eqx.field(static=True, default=0)
    sigma_max: float | None = None
    sigma_min: float | None = None

    shared: ClassVar[tuple[str, ...]] = ("posterior", "index", "sigmas", "step_size", "metric")

    def __post_init__(self):
        if self.path is None:
            self.path = "split" if self.published else "convolved"

    def __check_init__(self):
        check_at_least(
            ("levels", self.levels, 2),
            ("steps", self.steps, 1),
            ("polish", self.polish, 0),
            ("descent", self.descent, 0),
        )
        if self.polish and self.descent:
            raise ValueError(
                f"polish {self.polish} and descent {self.descent}: one way to end a draw, not both"
            )
        check_levels(sigma_max=self.sigma_max, sigma_min=self.sigma_min)
        if not 0 < self.step_size < 2:
            raise ValueError(f"step_size {self.step_size}: a fraction, stable between 0 and 2")
        if self.path not in ("split", "convolved"):
            raise ValueError(f"unknown path {self.path!r}: use 'split' or 'convolved'")
        if self.published and self.path != "split":
            raise ValueError("published=True is the paper's form, on path='split' only")

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> AnnealedState:
        """State before the first level. Every draw starts anew from `position`, if given."""
        if self.descent:
            check_gaussian(self, posterior)
        sigmas = jnp.geomspace(*self._range(posterior), self.levels)
        start = posterior.start(key) if position is None else position
        sigmas = sigmas.astype(start.real.dtype)
        polish = MALA().init(key, posterior, start) if self.polish else None
        return AnnealedState(
            position=start,
            noise=jnp.zeros_like(start),
            origin=position,
            # The posterior, step size and metric of the polish are the shared fields below.
            polish=polish and _without_shared(polish),
            index=jnp.zeros((), jnp.int32),
            sigmas=sigmas,
            step_size=polish.step_size if polish else jnp.zeros((), sigmas.dtype),
            metric=polish.metric if polish else None,
            posterior=posterior,
        )

    def _range(self, posterior: Posterior) -> tuple[jax.Array | float, jax.Array | float]:
        """Broadest and finest level; a prior without a scale is not asked for what is given."""
        if self.sigma_max is not None and self.sigma_min is not None:
            return self.sigma_max, self.sigma_min
        broadest, finest = posterior.annealing_range(self.path)
        return (
            broadest if self.sigma_max is None else self.sigma_max,
            finest if self.sigma_min is None else self.sigma_min,
        )

    def steps_per_draw(self) -> int:
        """All levels, and the polish or the descent."""
        return self.levels * self.steps + self.polish + self.descent

    def step(self, key: jax.Array, state: AnnealedState) -> tuple[AnnealedState, AnnealedInfo]:
        """One Langevin step at the level of `state.index`, or one of the polish or the descent."""
        index = state.index
        ending = self._polish_step if self.polish else self._descent_step
        if self.polish or self.descent:
            annealing = index < self.levels * self.steps
            state, info = jax.lax.cond(annealing, self._annealing_step, ending, key, state)
        else:
            state, info = self._annealing_step(key, state)
        return state._replace(index=(index + 1) % self.steps_per_draw()), info

    def default_warmup(self) -> int:
        """Steps that tune the polish, after a pilot run; none without a polish."""
        return 500 if self.polish else 0

    def tunes_itself(self) -> bool:
        """True without a polish, which alone is tuned."""
        return not self.polish

    def adaptation(self) -> Adaptation | None:
        """Tunes the polish; nothing to tune without one."""
        return _PolishAdaptation(self) if self.polish else None

    def _annealing_step(
        self, key: jax.Array, state: AnnealedState
    ) -> tuple[AnnealedState, AnnealedInfo]:
        key_start, key_noise, key_step = jax.random.split(key, 3)
        x, noise = jax.lax.cond(
            state.index == 0,
            lambda: (self.restarted(key_start, state), normal_like(key_noise, state.position)),
            lambda: (state.position, state.noise),
        )
        sigma = state.sigmas[jnp.minimum(state.index // self.steps, self.levels - 1)]
        posterior = state.posterior
        if posterior.positive:
            # Where the score is still finite: it grows like 1/x^2.
            x = jnp.maximum(x, jnp.finfo(x.dtype).eps ** 2)
        score = posterior.annealed_score(x, sigma, self.path, self.published)
        step = self.step_size * posterior.annealing_variance(sigma, self.path)
        fresh = normal_like(key_step, x)
        shaken = jnp.sqrt(2 * step) * (fresh if self.published else (noise + fresh) / 2)
        if posterior.positive:
            root = jnp.sqrt(x)
            root = root + _drift_of_root(root, score, step, self.path) + shaken
            x, fresh = jnp.square(root), jnp.where(root < 0, -fresh, fresh)
        else:
            x = x + (step * score + shaken).astype(x.dtype)
        info = AnnealedInfo(sigma, jnp.linalg.norm(score), jnp.full((), jnp.nan, sigma.dtype))
        return state._replace(position=x, noise=fresh), info

    def restarted(self, key: jax.Array, state: AnnealedState) -> jax.Array:
        """As of every run, but for "signal" the start itself, which is as broad as a level."""
        if state.posterior.positive:
            return state.posterior.start(key) if state.origin is None else state.origin
        return super().restarted(key, state)

    def _descent_step(
        self, key: jax.Array, state: AnnealedState
    ) -> tuple[AnnealedState, AnnealedInfo]:
        prior = state.posterior.prior
        levels = reverse_levels(prior, state.sigmas[-1], self.descent)
        index = state.index - self.levels * self.steps
        x = reverse_step(key, prior, state.position, levels[index], levels[index + 1])
        nan = jnp.full((), jnp.nan, levels.dtype)
        return state._replace(position=x), AnnealedInfo(levels[index + 1], nan, nan)

    def _polish_step(
        self, key: jax.Array, state: AnnealedState
    ) -> tuple[AnnealedState, AnnealedInfo]:
        first = state.index == self.levels * self.steps
        posterior = state.posterior
        mala = state.polish._replace(
            posterior=posterior, step_size=state.step_size, metric=state.metric
        )

        def begin() -> MALAState:
            log_prob, score = posterior.log_prob_and_score(state.position)
            return mala._replace(position=state.position, log_prob=log_prob, score=score)

        mala = jax.lax.cond(first, begin, lambda: mala)
        mala, info = MALA().step(key, mala)
        state = state._replace(position=mala.position, polish=_without_shared(mala))
        return state, AnnealedInfo(
            jnp.zeros_like(state.sigmas[0]), jnp.linalg.norm(mala.score), info.acceptance_rate
        )


def _drift_of_root(root: jax.Array, score: jax.Array, step: jax.Array, path: str) -> jax.Array:
    """Step times the score of u = sqrt(x), whose density is 2 u p(u^2).

    Near zero it grows like c/u ("convolved": counts, and the prior) or c/u^3 ("split": a normal
    likelihood whose variance is that of the light), and a plain step of it overshoots without
    bound. Followed exactly, c/u^p carries a pixel from zero to ((p + 1) step c)^(1/(p + 1)) and no
    further; that bounds it.
    """
    drift = step * (2 * root * score + 1 / root)
    power = {"convolved": 1, "split": 3}[path]
    from_zero = ((power + 1) * jnp.maximum(drift / root, 0.0)) ** (1 / (power + 1)) * root
    return jnp.where(from_zero > (power + 1) ** (1 / power) * root, from_zero, drift)


def _without_shared(state: MALAState) -> MALAState:
    return state._replace(posterior=None, step_size=None, metric=None)


class _PolishAdaptation(Adaptation):
    """One annealed run of every chain, then the warm-up of MALA from where they end."""

    def __init__(self, sampler: AnnealedLangevin):
        self.sampler = sampler
        self.mala = MALA()
        self.inner = MetropolisAdaptation(self.mala)

    def steps(self, warmup: int) -> int:
        return self._pilot_steps() + warmup

    def init(self, states: AnnealedState) -> AdaptationState:
        return self.inner.init(self._mala_states(states))

    def step(
        self,
        index: jax.Array,
        warmup: int,
        keys: jax.Array,
        states: AnnealedState,
        adapted: AdaptationState,
    ) -> tuple[AnnealedState, AdaptationState]:
        def anneal(states: State, adapted: State) -> tuple[State, State]:
            # The pilot stops where the polish would begin.
            return vmap_step(self.sampler, keys, states)[0], adapted

        def tune(states: State, adapted: State) -> tuple[State, State]:
            mala = self._mala_states(states)
            first = index == self._pilot_steps()
            mala = jax.lax.cond(first, lambda: self._evaluated(mala), lambda: mala)
            mala, adapted = self.inner.step(
                index - self._pilot_steps(), warmup, keys, mala, adapted
            )
            return self._written(states, mala), adapted

        return jax.lax.cond(index < self._pilot_steps(), anneal, tune, states, adapted)

    def finish(self, states: AnnealedState, adapted: AdaptationState) -> AnnealedState:
        mala = self.inner.finish(self._mala_states(states), adapted)
        return self._written(states, mala)._replace(index=jnp.zeros_like(states.index))

    def _pilot_steps(self) -> int:
        return self.sampler.levels * self.sampler.steps

    def _mala_states(self, states: AnnealedState) -> MALAState:
        return states.polish._replace(
            position=states.position,
            posterior=states.posterior,
            step_size=states.step_size,
            metric=states.metric,
        )

    def _evaluated(self, mala: MALAState) -> MALAState:
        log_prob, score = jax.vmap(mala.posterior.log_prob_and_score)(mala.position)
        return mala._replace(log_prob=log_prob, score=score)

    def _written(self, states: AnnealedState, mala: MALAState) -> AnnealedState:
        return states._replace(
            position=mala.position,
            polish=_without_shared(mala),
            step_size=mala.step_size,
            metric=mala.metric,
        )
