"""SNIPS: annealed Langevin in the singular vectors of a linear measurement."""

import math
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.annealing import component_sd
from ..models.camera import Gaussian
from ..models.likelihood import LinearLikelihood
from ..models.realview import normal_like
from ..problem import Posterior
from .base import RunSampler
from .checks import check_at_least, check_gaussian, check_levels

# Real dimensions of the largest object: its singular vectors are a matrix of that size squared.
_LARGEST = 4096
# A variance that passes through zero at one level is kept from it by this part of the noise.
_LEAST = 1e-3


class SNIPSState(NamedTuple):
    """Everything a step needs; `index` counts steps within the current draw.

    `gains` (n,): singular values, 0 for what the measurement does not see; `vectors` (n, n): the
    objects that belong to them, as rows, conjugate; `seen` (n,): the recording in their terms.
    """

    position: jax.Array
    origin: jax.Array | None
    index: jax.Array
    sigmas: jax.Array
    gains: jax.Array
    vectors: jax.Array
    seen: jax.Array
    posterior: Posterior


class SNIPSInfo(NamedTuple):
    """Statistics of one step."""

    sigma: jax.Array
    score_norm: jax.Array


class SNIPS(RunSampler):
    """Annealed Langevin for y = H x + Gaussian noise; each draw is the end of a run of its own.

    Kawar, Vaksman and Elad (2021), "SNIPS: solving noisy inverse problems stochastically". In the
    singular vectors of H, of gain g each, the annealing error of level s and the noise sigma_0 of
    the recording are made of one another (per real component: s/2 for complex objects):

    - g s <= sigma_0: the error is a part of the noise, and the score is the prior's and
      g (y - g x~)/(sigma_0^2 - g^2 s^2);
    - g s > sigma_0: the noise is a part of the error, and the score is that of the recording alone,
      (y/g - x~)/(s^2 - sigma_0^2/g^2);
    - g = 0: the prior's.

    `levels` geometric levels from `sigma_max` (None: the prior's scale) to `sigma_min` (None: 1 %
    of the level whose error is the noise, not below the finest that the prior knows), `steps`
    Langevin steps at each, of `step_size` times the variance that both leave of a component.

    Exact as its levels and steps grow and its step falls, once every g s is below the noise; before
    that the prior's correlations with what is seen well are neglected. `init` raises ValueError
    for other likelihoods and cameras, for objects above 4096 real dimensions, and for a prior with
    another perturbation.
    """

    levels: int = eqx.field(static=True, default=200)
    steps: int = eqx.field(static=True, default=5)
    step_size: float = 0.2
    sigma_max: float | None = None
    sigma_min: float | None = None

    shared: ClassVar[tuple[str, ...]] = (
        "posterior", "index", "sigmas", "gains", "vectors", "seen",
    )  # fmt: skip

    def __check_init__(self):
        check_at_least(("levels", self.levels, 2), ("steps", self.steps, 1))
        if not 0 < self.step_size < 2:
            raise ValueError(f"step_size {self.step_size}: a fraction, stable between 0 and 2")
        check_levels(sigma_max=self.sigma_max, sigma_min=self.sigma_min)

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> SNIPSState:
        """State before the first level. Every draw starts anew from `position`, if given."""
        _check_linear(posterior)
        check_gaussian(self, posterior)
        sigma_max, sigma_min = posterior.annealing_range("convolved")
        sigma_max = sigma_max if self.sigma_max is None else self.sigma_max
        sigma_min = sigma_min if self.sigma_min is None else self.sigma_min
        start = posterior.start(key) if position is None else position
        gains, vectors, seen = _in_singular_vectors(posterior)
        return SNIPSState(
            position=start,
            origin=position,
            index=jnp.zeros((), jnp.int32),
            sigmas=jnp.geomspace(sigma_max, sigma_min, self.levels).astype(start.real.dtype),
            gains=gains,
            vectors=vectors,
            seen=seen,
            posterior=posterior,
        )

    def steps_per_draw(self) -> int:
        """All levels."""
        return self.levels * self.steps

    def step(self, key: jax.Array, state: SNIPSState) -> tuple[SNIPSState, SNIPSInfo]:
        """One Langevin step at the level of `state.index`."""
        key_start, key_step = jax.random.split(key)
        position = jax.lax.cond(
            state.index == 0, lambda: self.restarted(key_start, state), lambda: state.position
        )
        posterior, sigma = state.posterior, state.sigmas[state.index // self.steps]
        level = component_sd(sigma, jnp.iscomplexobj(position)) ** 2
        noise, gains = jnp.square(posterior.likelihood.camera.sigma), state.gains
        x = state.vectors @ position.ravel()
        prior = state.vectors @ posterior.prior.score(position, sigma).ravel()

        difference = noise - jnp.square(gains) * level
        rest = jnp.maximum(jnp.abs(difference), _LEAST * noise)
        data = gains * (state.seen - gains * x) / rest
        score = jnp.where(difference < 0, 0, prior) + data
        alone = rest / jnp.where(gains > 0, jnp.square(gains), 1)
        joined = 1 / (1 / level + jnp.square(gains) / rest)
        h = self.step_size * jnp.where(difference < 0, alone, joined)

        x = x + (h * score + jnp.sqrt(2 * h) * normal_like(key_step, x)).astype(x.dtype)
        moved = (state.vectors.conj().T @ x).reshape(position.shape).astype(position.dtype)
        index = (state.index + 1) % self.steps_per_draw()
        return state._replace(position=moved, index=index), SNIPSInfo(sigma, jnp.linalg.norm(score))


def _in_singular_vectors(posterior: Posterior) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Gains (n,), vectors (n, n) and the recording (n,) in terms of them."""
    size, optics = math.prod(posterior.shape), posterior.likelihood.optics
    basis = jnp.eye(size, dtype=posterior.dtype).reshape(size, *posterior.shape)
    matrix = jax.vmap(optics)(basis).reshape(size, -1).T
    u, gains, vectors = jnp.linalg.svd(matrix, full_matrices=True)
    count = len(gains)
    seen = u[:, :count].conj().T @ jnp.asarray(posterior.y).ravel()
    # What rounding leaves of a gain of nothing must not be divided by.
    lost = gains < gains[0] * max(matrix.shape) * jnp.finfo(gains.dtype).eps
    unseen = (0, size - count)
    return jnp.pad(jnp.where(lost, 0, gains), unseen), vectors, jnp.pad(seen, unseen)


def _check_linear(posterior: Posterior) -> None:
    likelihood = posterior.likelihood
    camera = likelihood.camera
    if not (isinstance(likelihood, LinearLikelihood) and isinstance(camera, Gaussian)):
        raise ValueError(
            f"{type(likelihood).__name__} with a {type(camera).__name__} camera: SNIPS is for "
            "linear measurements under Gaussian noise, use SplitGibbs or AnnealedLangevin"
        )
    if jnp.iscomplexobj(posterior.y) != posterior.prior.complex_valued:
        raise ValueError("SNIPS needs object and recording both real, or both complex")
    size = math.prod(posterior.shape) * (2 if posterior.prior.complex_valued else 1)
    if size > _LARGEST:
        raise ValueError(
            f"an object of {size} real dimensions: SNIPS keeps all singular vectors, {_LARGEST} at "
            "most, use SplitGibbs or AnnealedLangevin"
        )
