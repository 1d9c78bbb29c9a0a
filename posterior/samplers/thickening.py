"""Thickening: a recording of counts, exposed on and on until it is a picture."""

import math
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.camera import Poisson
from ..models.likelihood import LinearLikelihood
from ..models.optics import Identity
from ..models.thinning import lengthened, poisson_between
from ..problem import Posterior
from .base import RunSampler
from .checks import check_at_least, check_levels

# Shares of the recording's level, of which a posterior loses the square in variance: no level is
# finer than the one, and a prior must know levels as fine as the other.
_FINEST, _COARSEST = 0.05, 1 / 3
# Below this level counts outgrow what float32 tells apart.
_LONGEST = 2.0**-12
# The share of hidden counts that a step of their chain draws anew.
_RENEWED = 0.25


class ThickeningState(NamedTuple):
    """Everything a step needs; `index` counts levels within the current draw.

    `position` is E[object | counts], and `counts` are the electrons at the level of `index`.
    """

    position: jax.Array
    counts: jax.Array
    index: jax.Array
    sigmas: jax.Array
    posterior: Posterior


class ThickeningInfo(NamedTuple):
    """Statistics of one step."""

    sigma: jax.Array
    electrons: jax.Array


class Thickening(RunSampler):
    """Denoising of photon counts by the prior's denoiser of counts; each draw a run of its own.

    The recording is thickened to ever longer exposures (models/thinning.py): at the level sigma,
    an exposure of 1/sigma^2 electrons, further electrons are counted at the rate of what the prior
    expects to see, E[object | counts]. `levels` geometric levels from the recording's own,
    1/full_well^(1/2), to `sigma_min` (None: a twentieth of it, or the finest level that the prior
    knows); the draw is E[object | counts] at the last. Costs one evaluation a level.

    Exact as levels grow, for pictures recorded by a Poisson camera and a prior with the poisson
    perturbation: no step multiplies the errors of a network, no likelihood is approximated. Two
    approximations remain. The draw lacks the variance left at the last level, at most its square
    over the recording's: `init` refuses a prior with which that is above a ninth. Counts that the
    recording does not tell apart (a saturated pixel, an ADC with fewer codes than electrons) are
    drawn first, by a chain of `renewals` evaluations and one more; it is too short for light far
    above the full well, which comes out too dark.

    Every draw begins at the recording: a start that is given is not used. `init` raises ValueError
    for other optics, cameras and priors.
    """

    levels: int = eqx.field(static=True, default=48)
    sigma_min: float | None = None
    renewals: int = eqx.field(static=True, default=30)

    shared: ClassVar[tuple[str, ...]] = ("posterior", "index", "sigmas")
    independent: ClassVar[bool] = True

    def __check_init__(self):
        check_at_least(("levels", self.levels, 2), ("renewals", self.renewals, 0))
        check_levels(sigma_max=None, sigma_min=self.sigma_min)

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> ThickeningState:
        """State before the first level."""
        _check_counts(posterior)
        dtype = posterior.dtype
        broadest = posterior.likelihood.camera.sigma0
        finest = _finest(posterior) if self.sigma_min is None else self.sigma_min
        finest = jnp.minimum(finest, broadest)
        return ThickeningState(
            position=posterior.y.astype(dtype),
            counts=jnp.zeros(posterior.shape, dtype),
            index=jnp.zeros((), jnp.int32),
            sigmas=jnp.geomspace(broadest, finest, self.levels).astype(dtype),
            posterior=posterior,
        )

    def steps_per_draw(self) -> int:
        """All levels."""
        return self.levels

    def step(
        self, key: jax.Array, state: ThickeningState
    ) -> tuple[ThickeningState, ThickeningInfo]:
        """Look at the counts of `state.index`'s level, and expose them to the next."""
        key_first, key_more = jax.random.split(key)
        index, sigmas = state.index, state.sigmas
        counts = jax.lax.cond(
            index == 0,
            lambda: recorded_counts(key_first, state.posterior, self.renewals),
            lambda: state.counts,
        )
        denoise, before = state.posterior.prior.denoise, state.position
        counts, light = lengthened(key_more, denoise, counts, before, sigmas, index)
        state = state._replace(position=light, counts=counts, index=(index + 1) % self.levels)
        return state, ThickeningInfo(sigmas[index], jnp.sum(counts))


def _finest(posterior: Posterior) -> float:
    """The last level; refuses a prior that knows none much finer than the recording's."""
    broadest, prior = posterior.likelihood.camera.sigma0, posterior.prior
    finest = max(_FINEST * broadest, prior.finest, _LONGEST)
    if finest > _COARSEST * broadest:
        raise ValueError(
            f"full well {posterior.likelihood.camera.full_well}: the levels end at {finest:.3g}, "
            f"and draws would lack {100 * (finest / broadest) ** 2:.0f} % of their variance; "
            f"thickening is for full wells up to {math.floor((_COARSEST / finest) ** 2)} here, use "
            "AnnealedLangevin with a prior of the gaussian perturbation"
        )
    return finest


def recorded_counts(key: jax.Array, posterior: Posterior, renewals: int) -> jax.Array:
    """The electrons of a recording, shaped as it; drawn where it leaves several numbers possible.

    By a Markov chain of `renewals` times thinning and thickening again, which leaves counts of the
    prior as they are distributed; a pixel that would leave what was recorded stays as it is.
    """
    camera, denoise = posterior.likelihood.camera, posterior.prior.denoise
    low, high = camera.electrons_between(posterior.y)
    kept = 1 - _RENEWED
    shorter = camera.sigma0 / kept**0.5

    def renew(counts: jax.Array, key: jax.Array) -> tuple[jax.Array, None]:
        key_thin, key_more = jax.random.split(key)
        thinned = jax.random.binomial(key_thin, counts, kept).astype(counts.dtype)
        rate = _RENEWED * camera.full_well * denoise(thinned * shorter**2, shorter)
        renewed = thinned + jax.random.poisson(key_more, jnp.maximum(rate, 0.0))
        return jnp.where((renewed >= low) & (renewed <= high), renewed, counts), None

    def drawn() -> jax.Array:
        light = denoise(low * camera.sigma0**2, camera.sigma0)
        keys = jax.random.split(key, renewals + 1)
        guess = poisson_between(keys[0], camera.full_well * light, low, high)
        return jax.lax.scan(renew, guess, keys[1:])[0]

    return jax.lax.cond(jnp.any(high > low), drawn, lambda: low)


def _check_counts(posterior: Posterior) -> None:
    likelihood, prior = posterior.likelihood, posterior.prior
    if prior.perturbation != "poisson":
        raise ValueError(
            f"the prior has the {prior.perturbation!r} perturbation: Thickening needs a denoiser "
            "of counts, one with the 'poisson' perturbation; AnnealedLangevin takes this one"
        )
    if not isinstance(likelihood, LinearLikelihood) or not isinstance(likelihood.optics, Identity):
        raise ValueError(
            f"{type(likelihood).__name__} with {type(likelihood.optics).__name__} optics: "
            "Thickening denoises the picture itself (LinearLikelihood with Identity), "
            "use AnnealedLangevin with a prior of the gaussian perturbation"
        )
    if not isinstance(likelihood.camera, Poisson):
        raise ValueError(
            f"camera {type(likelihood.camera).__name__}: Thickening needs counts (Poisson), "
            "use AnnealedLangevin with a prior of the gaussian perturbation"
        )
