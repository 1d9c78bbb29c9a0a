"""emcee's affine-invariant ensemble: an exact check in few dimensions, on the host."""

import os
from typing import NamedTuple

import emcee
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models.realview import from_real, real_size, to_real
from ..problem import Posterior
from .base import Sampler

_MOST_DIMENSIONS = 40


class EnsembleState(NamedTuple):
    """All walkers in the real view."""

    walkers: np.ndarray
    log_prob: np.ndarray
    posterior: Posterior


class EnsembleInfo(NamedTuple):
    """Statistics of one move of the ensemble."""

    acceptance_rate: float


class Ensemble(Sampler):
    """emcee (Foreman-Mackey et al. 2013), vectorised, with a jitted batched log-density.

    `walkers` defaults to four times the real dimensions, 32 at least. Each chain of `sample` is an
    ensemble of its own, whose walkers are flattened into draws. Refuses more than 40 real
    dimensions. It never crosses between separate modes: their weights stay those of its start, so
    use it on unimodal posteriors, best below 20 dimensions.
    """

    walkers: int | None = eqx.field(static=True, default=None)

    def size(self, posterior: Posterior) -> int:
        """Number of walkers; raises ValueError where emcee should not be used."""
        dimensions = real_size(posterior.shape, posterior.dtype)
        if dimensions > _MOST_DIMENSIONS:
            raise ValueError(
                f"Ensemble in {dimensions} real dimensions: emcee is for {_MOST_DIMENSIONS} at "
                "most; use samplers.MALA(), or samplers.TemperedSMC() for several modes"
            )
        if self.walkers is None:
            return max(4 * dimensions, 32)
        if self.walkers < 2 * dimensions or self.walkers % 2:
            raise ValueError(
                f"walkers {self.walkers}: emcee needs an even number, "
                f"at least {2 * dimensions} in {dimensions} dimensions"
            )
        return self.walkers

    def check(self, key: jax.Array, posterior: Posterior, start: jax.Array | None = None) -> None:
        """Refuse what `size` refuses."""
        self.size(posterior)

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> EnsembleState:
        """Walkers at dispersed starts, or in a small ball about `position`."""
        keys = jax.random.split(key, self.size(posterior))
        if position is None:
            walkers = jax.vmap(lambda k: to_real(posterior.start(k)))(keys)
        else:
            scale = 0.01 * posterior.prior.scale
            centre = to_real(position)
            noise = jax.vmap(lambda k: jax.random.normal(k, centre.shape, centre.dtype))(keys)
            walkers = centre + scale * noise
        log_prob = _batched_log_prob(posterior, walkers)
        return EnsembleState(np.asarray(walkers, float), np.asarray(log_prob, float), posterior)

    def step(self, key: jax.Array, state: EnsembleState) -> tuple[EnsembleState, EnsembleInfo]:
        """One stretch move of every walker."""
        sampler = self._emcee(state.posterior, None)
        start = emcee.State(state.walkers, log_prob=state.log_prob, random_state=_random_state(key))
        (end,) = sampler.sample(start, iterations=1)
        rate = float(np.mean(sampler.acceptance_fraction))
        return EnsembleState(end.coords, end.log_prob, state.posterior), EnsembleInfo(rate)

    def run(
        self,
        key: jax.Array,
        posterior: Posterior,
        iterations: int,
        position: jax.Array | None = None,
        checkpoint: str | os.PathLike | None = None,
        progress: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Walkers (iterations, walkers, *shape) as objects, and acceptance (walkers,).

        With `checkpoint` every iteration is on disk in emcee's HDF5 backend, and a second call
        goes on from there, bit-identically.
        """
        backend = None if checkpoint is None else emcee.backends.HDFBackend(os.fspath(checkpoint))
        sampler = self._emcee(posterior, backend)
        key_init, key_moves = jax.random.split(key)
        if backend is not None and backend.initialized and backend.iteration:
            start = backend.get_last_sample()
        else:
            state = self.init(key_init, posterior, position)
            start = emcee.State(
                state.walkers, log_prob=state.log_prob, random_state=_random_state(key_moves)
            )
        missing = iterations - (backend.iteration if backend is not None else 0)
        if missing > 0:
            sampler.run_mcmc(start, missing, progress=progress)
        chain = jnp.asarray(sampler.get_chain()[:iterations])
        convert = jax.vmap(jax.vmap(lambda v: from_real(v, posterior.shape, posterior.dtype)))
        return np.asarray(convert(chain)), sampler.acceptance_fraction

    def _emcee(self, posterior: Posterior, backend: object) -> emcee.EnsembleSampler:
        dimensions = real_size(posterior.shape, posterior.dtype)
        dtype = jax.dtypes.canonicalize_dtype(float)

        def log_prob(walkers: np.ndarray) -> np.ndarray:
            values = np.asarray(_batched_log_prob(posterior, jnp.asarray(walkers, dtype)), float)
            # emcee stops at NaN; a density that is undefined is no place to go.
            return np.where(np.isnan(values), -np.inf, values)

        return emcee.EnsembleSampler(
            self.size(posterior), dimensions, log_prob, vectorize=True, backend=backend
        )


@eqx.filter_jit
def _batched_log_prob(posterior: Posterior, walkers: jax.Array) -> jax.Array:
    return jax.vmap(lambda v: posterior.log_prob(from_real(v, posterior.shape, posterior.dtype)))(
        walkers
    )


def _random_state(key: jax.Array) -> tuple:
    """A numpy random state that is a function of the key alone."""
    seed = np.asarray(jax.random.bits(key, (8,), jnp.uint32))
    return np.random.RandomState(seed).get_state()
