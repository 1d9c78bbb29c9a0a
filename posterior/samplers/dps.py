"""Diffusion posterior sampling: reverse diffusion, pulled towards the data through the denoiser."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.annealing import component_sd
from ..models.realview import normal_like, real_score
from ..problem import Posterior
from .base import RunSampler
from .checks import check_at_least, check_gaussian, check_levels

# Broadest level in units of the prior's scale: the pull must have time to choose the object.
_BROADEST = 5.0


class DPSState(NamedTuple):
    """Everything a step needs; `index` counts steps within the current draw."""

    position: jax.Array
    origin: jax.Array | None
    index: jax.Array
    sigmas: jax.Array
    posterior: Posterior


class DPSInfo(NamedTuple):
    """Statistics of one step; `residual` is the misfit of D(x~), root mean square, in noise sds."""

    sigma: jax.Array
    residual: jax.Array


class DPS(RunSampler):
    """Diffusion posterior sampling: each draw is the end of a run of its own.

    Chung, Kim, McCann, Klasky and Ye (2023), "Diffusion posterior sampling for general noisy
    inverse problems". From level s to level t, with D the denoiser at s and n standard normal,

        x~ <- D + (t/s)^2 (x~ - D) + t sqrt(1 - (t/s)^2) n - zeta (s - t) g,

    g the gradient, through the denoiser, of the norm of y - expected(D) weighted by 1/variance of
    y: the normalised step of the paper, also in its form for photon counts. Here g is put into the
    object's units (the likelihood's curvature divides it, so that it has about unit size a pixel)
    and the step follows the fall of the level, so that `zeta` has no units and neither size of the
    image nor number of levels changes it. `levels` geometric levels from `sigma_max` (None: 5 times
    the prior's scale) to `sigma_min` (None: 1 % of the noise, not below the finest level that the
    prior knows); the last step ends in D. Works for linear and intensity likelihoods, for real and
    complex objects (level sigma: sigma/2 per real component).

    An approximation that does not vanish, and is not calibrated: p(y | x~) is taken to be that of
    the one object D(x~), the normalised step forgets how large the noise is, and the noise of the
    reverse diffusion lacks what the denoiser leaves open. The mean comes out well where the data
    decide, the spread does not: denoising Gaussian pictures of sd 0.2, it was 1.2, 0.7 and 0.6
    times the posterior's at a noise of 0.05, 0.1 and 0.2, with means 0.3, 0.1 and 0.5 posterior
    sds off. Use it for pictures, and `SplitGibbs`, `AnnealedLangevin` or MALA for intervals.
    Quantisation and saturation are neglected.

    `init` raises ValueError for a prior with the signal-dependent perturbation.
    """

    levels: int = eqx.field(static=True, default=300)
    zeta: float = 1.5
    sigma_max: float | None = None
    sigma_min: float | None = None

    shared: ClassVar[tuple[str, ...]] = ("posterior", "index", "sigmas")

    def __check_init__(self):
        check_at_least(("levels", self.levels, 2))
        if not self.zeta > 0:
            raise ValueError(f"zeta {self.zeta}: it must be positive, 0.5 to 2 for most problems")
        check_levels(sigma_max=self.sigma_max, sigma_min=self.sigma_min)

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> DPSState:
        """State before the first level. Every draw starts anew from `position`, if given."""
        check_gaussian(self, posterior)
        broadest, sigma_min = posterior.annealing_range("convolved")
        sigma_max = _BROADEST * broadest if self.sigma_max is None else self.sigma_max
        sigma_min = sigma_min if self.sigma_min is None else self.sigma_min
        start = posterior.start(key) if position is None else position
        sigmas = jnp.append(jnp.geomspace(sigma_max, sigma_min, self.levels), 0.0)
        return DPSState(
            position=start,
            origin=position,
            index=jnp.zeros((), jnp.int32),
            sigmas=sigmas.astype(start.real.dtype),
            posterior=posterior,
        )

    def steps_per_draw(self) -> int:
        """All levels."""
        return self.levels

    def step(self, key: jax.Array, state: DPSState) -> tuple[DPSState, DPSInfo]:
        """From the level of `state.index` to the next, or from the last to the object."""
        key_start, key_noise = jax.random.split(key)
        x = jax.lax.cond(
            state.index == 0, lambda: self.restarted(key_start, state), lambda: state.position
        )
        sigma, following = state.sigmas[state.index], state.sigmas[state.index + 1]
        clean, pull, residual = _pull(state.posterior, x, sigma)
        s, t = (component_sd(level, jnp.iscomplexobj(x)) for level in (sigma, following))
        q = t / s
        moved = clean + q**2 * (x - clean) + t * jnp.sqrt(1 - q**2) * normal_like(key_noise, x)
        x = (moved + self.zeta * (s - t) * pull).astype(x.dtype)
        state = state._replace(position=x, index=(state.index + 1) % self.levels)
        return state, DPSInfo(sigma, residual)


def _pull(
    posterior: Posterior, x: jax.Array, sigma: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """D(x), the normalised gradient towards the data, and the misfit of D(x) in noise sds."""
    likelihood, y = posterior.likelihood, posterior.y
    camera = likelihood.camera
    # As in the likelihoods, a count's variance is held at one electron's below one electron.
    variance = camera.sigma0**2 * jnp.maximum(y.real, camera.sigma0**2) + camera.read_variance
    components = 2 if jnp.iscomplexobj(y) else 1

    def misfit(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        clean = posterior.prior.denoise(x, sigma)
        rest = y - likelihood.expected(clean)
        return jnp.sum((jnp.square(rest.real) + jnp.square(rest.imag)) / variance) / 2, clean

    (value, clean), gradient = jax.value_and_grad(misfit, has_aux=True)(x)
    residual = jnp.sqrt(2 * value / (components * y.size))
    curvature = likelihood.curvature(jnp.iscomplexobj(x), y, 0.0, "convolved")
    smallest = jnp.finfo(residual.dtype).eps
    pull = -real_score(gradient) / (jnp.sqrt(curvature) * jnp.maximum(residual, smallest))
    return clean, pull.astype(x.dtype), residual.astype(x.real.dtype)
