"""Where chains start behind a Fourier transform: each in the deepest valley it finds for itself."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .estimators import hio
from .models.optics import CONJUGATE_FLIP, Fourier, Optics
from .problem import Posterior
from .samplers import AnnealedLangevin
from .sampling import sample

# Candidates of each chain, those of them that have heirs, and how often they are chosen anew.
_CANDIDATES, _PARENTS, _GENERATIONS = 16, 2, 3
_TRIES = 4  # random phases a candidate
_HIO_ITERATIONS = 500


def annealed(
    posterior: Posterior,
    scout: AnnealedLangevin,
    key: jax.Array,
    chains: int,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Ends (chains, *shape) of one annealing run a chain, from `start`, noised, or from nowhere."""
    settings = {"draws": 1, "warmup": 0, "progress": False}
    found = sample(posterior, scout, key, chains=chains, start=start, **settings)
    return found.values[:, 0]


def has_magnitudes(optics: Optics) -> bool:
    """Whether `from_magnitudes` serves: a Fourier transform of an object that something bounds."""
    if not isinstance(optics, Fourier):
        return False
    return optics.in_shape != optics.out_shape or optics.support is not None


def from_magnitudes(
    posterior: Posterior, scout: AnnealedLangevin, key: jax.Array, chains: int
) -> np.ndarray:
    """Starts (chains, *shape) for phase retrieval; `scout` is the annealing between the choices.

    The paper's start, a noised solution of hybrid input-output, for several candidates a chain;
    annealing brings each to the valley beside it. Valleys differ by thousands of nats, far more
    than draws within one: the best candidates are noised and annealed again, as many as before. The
    chains share nothing, so that R-hat still tells whether they found the same valley.

    Real objects are taken to be nonnegative. Raises ValueError as `hio` does.
    """
    key_hio, *keys = jax.random.split(key, 1 + _GENERATIONS)
    pool = np.stack([_candidates(posterior, jax.random.fold_in(key_hio, i)) for i in range(chains)])
    shape = pool.shape
    for generation in keys:
        flat = pool.reshape(-1, *posterior.shape)
        pool = annealed(posterior, scout, generation, len(flat), flat).reshape(shape)
        pool = np.stack([_heirs(posterior, candidates) for candidates in pool])
    return _untwinned(pool[:, 0], posterior.likelihood.optics)


def _candidates(posterior: Posterior, key: jax.Array) -> np.ndarray:
    found = hio(
        posterior.likelihood,
        posterior.y,
        key,
        kind="complex" if posterior.prior.complex_valued else "nonnegative",
        starts=_TRIES * _CANDIDATES,
        iterations=_HIO_ITERATIONS,
        keep=_CANDIDATES,
    )
    return np.asarray(found.objects)


def _heirs(posterior: Posterior, candidates: np.ndarray) -> np.ndarray:
    """The best few in turn, the very best first, as many as there were candidates."""
    order = jnp.argsort(-_log_probs(posterior, candidates))
    return candidates[np.resize(order[:_PARENTS], len(candidates))]


@eqx.filter_jit
def _log_probs(posterior: Posterior, objects: np.ndarray) -> jax.Array:
    return jax.vmap(posterior.log_prob)(objects)


def _untwinned(objects: np.ndarray, optics: Optics) -> np.ndarray:
    """Each flipped if that brings it nearer to the first: a metric is pooled over the chains."""
    if CONJUGATE_FLIP not in optics.symmetries:
        return objects
    first = objects[0]
    twins = np.conj(np.flip(objects, axis=tuple(range(1, objects.ndim))))
    as_is, flipped = (np.abs(np.tensordot(o, first.conj(), first.ndim)) for o in (objects, twins))
    nearer = (flipped > as_is).reshape(-1, *(1,) * first.ndim)
    return np.where(nearer, twins, objects)
