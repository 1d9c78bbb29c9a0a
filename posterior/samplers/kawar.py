"""Stochastic denoising: annealed Langevin on the posterior under white Gaussian noise."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.annealing import component_sd
from ..models.likelihood import LinearLikelihood
from ..models.optics import Identity
from ..problem import Posterior
from .base import RunSampler, langevin_step
from .checks import check_at_least, check_gaussian, check_levels


class KawarState(NamedTuple):
    """Everything a step needs; `index` counts steps within the current draw.

    `noise_level` is the level that the recording has, and `sigmas` the levels below it.
    """

    position: jax.Array
    origin: jax.Array | None
    index: jax.Array
    sigmas: jax.Array
    noise_level: jax.Array
    posterior: Posterior


class KawarInfo(NamedTuple):
    """Statistics of one step."""

    sigma: jax.Array
    score_norm: jax.Array


class Kawar(RunSampler):
    """The stochastic denoiser: each draw is the end of a run of its own, from the recording on.

    Kawar, Vaksman and Elad (2021), "Stochastic image denoising by sampling from the posterior
    distribution". The recording y is the object at the level sigma_y of its noise; `levels`
    geometric levels lead from just under it to `sigma_min` (None: 1 % of it, not below the finest
    level that the prior knows), with `steps` Langevin steps at each along the score

        prior score at sigma_t + (y - x)/(s_y^2 - s_t^2),

    s = sigma per real component (sigma/2 for complex objects). The step is
    step_size s_t^2 (1 - s_t^2/s_y^2): the published one, proportional to sigma_t^2, held under
    the likelihood's own variance, without which the levels next to sigma_y diverge.

    Approximations. The noise is taken to be white, Gaussian and of one variance: the mean sd that
    the camera gives to the recording (or `sigma_y`, a level). That is so for a Gaussian camera;
    photon noise grows with the signal, and intervals come out too wide in the dark and too narrow
    in the light, and a run to the equilibrium, as by default, follows that all the way: on faces at
    sigma_0 = 0.1 it ends 3.8 dB below the shorter steps of NCSNv2 ("Kawar, published" of `posterior
    study denoising`). With a Gaussian camera exact as levels grow:
    on Gaussian posteriors the mean was within 0.03 sd and the variance within 2 % at the defaults,
    0.1 sd and 10 % with 50 levels.

    `init` raises ValueError for other optics or likelihoods (`SplitGibbs` and `AnnealedLangevin`
    take them), and for a prior with the signal-dependent perturbation.
    """

    levels: int = eqx.field(static=True, default=300)
    steps: int = eqx.field(static=True, default=5)
    step_size: float = 0.4
    sigma_y: float | None = None
    sigma_min: float | None = None

    shared: ClassVar[tuple[str, ...]] = ("posterior", "index", "sigmas", "noise_level")

    def __check_init__(self):
        check_at_least(("levels", self.levels, 2), ("steps", self.steps, 1))
        if not 0 < self.step_size < 2:
            raise ValueError(f"step_size {self.step_size}: a fraction, stable between 0 and 2")
        check_levels(sigma_y=self.sigma_y, sigma_min=self.sigma_min)

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> KawarState:
        """State before the first level. Draws start from `position`, noised, or from the data."""
        likelihood = posterior.likelihood
        if not (
            isinstance(likelihood, LinearLikelihood) and isinstance(likelihood.optics, Identity)
        ):
            raise ValueError(
                f"{type(likelihood).__name__} with {type(likelihood.optics).__name__} optics: "
                "Kawar denoises the picture itself (LinearLikelihood with Identity), "
                "use SplitGibbs or AnnealedLangevin"
            )
        check_gaussian(self, posterior)
        dtype = posterior.dtype
        start = posterior.y.astype(dtype) if position is None else position
        sigma_y = self._noise_level(posterior)
        finest = jnp.maximum(0.01 * sigma_y, posterior.prior.finest)
        sigma_max = 0.99 * sigma_y
        sigma_min = jnp.minimum(finest if self.sigma_min is None else self.sigma_min, sigma_max)
        sigmas = jnp.geomspace(sigma_max, sigma_min, self.levels)
        return KawarState(
            position=start,
            origin=position,
            index=jnp.zeros((), jnp.int32),
            sigmas=sigmas.astype(start.real.dtype),
            noise_level=jnp.asarray(sigma_y, start.real.dtype),
            posterior=posterior,
        )

    def steps_per_draw(self) -> int:
        """All levels."""
        return self.levels * self.steps

    def step(self, key: jax.Array, state: KawarState) -> tuple[KawarState, KawarInfo]:
        """One Langevin step at the level of `state.index`."""
        key_start, key_step = jax.random.split(key)
        x = jax.lax.cond(
            state.index == 0, lambda: self.restarted(key_start, state), lambda: state.position
        )
        posterior, sigma = state.posterior, state.sigmas[state.index // self.steps]
        complex_object = jnp.iscomplexobj(x)
        level = component_sd(sigma, complex_object) ** 2
        rest = component_sd(state.noise_level, complex_object) ** 2 - level
        score = posterior.prior.score(x, sigma) + (posterior.y - x) / rest
        step = self.step_size / (1 / level + 1 / rest)
        x = langevin_step(key_step, x, score, step)
        state = state._replace(position=x, index=(state.index + 1) % self.steps_per_draw())
        return state, KawarInfo(sigma, jnp.linalg.norm(score))

    def _noise_level(self, posterior: Posterior) -> jax.Array:
        """Level whose error is as large as the noise: its mean sd, twice it for complex objects."""
        if self.sigma_y is not None:
            return jnp.asarray(self.sigma_y)
        complex_object = posterior.prior.complex_valued
        variance, _ = posterior.likelihood.noise(complex_object, posterior.y)
        return jnp.mean(jnp.sqrt(variance)) * (2 if complex_object else 1)

    def restarted(self, key: jax.Array, state: KawarState) -> jax.Array:
        """The recording itself, which is at its level, or the origin at the broadest."""
        if state.origin is None:
            return state.posterior.y.astype(state.position.dtype)
        return super().restarted(key, state)
