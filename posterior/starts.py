"""Where chains start behind a Fourier transform: each in the deepest valley it finds for itself."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import track

from .estimators import half_samples, hio, maximum_likelihood, plug_and_play_admm
from .models.optics import CONJUGATE_FLIP, Fourier, FourierPtychography, Optics
from .models.priors.learned import LearnedPrior, ScorePrior
from .problem import Posterior
from .samplers import AnnealedLangevin
from .sampling import sample

# Candidates of each chain, and how often they are chosen anew; a network's steps cost more, and its
# valleys are found one out of another.
_FIELD_SEARCH, _LEARNED_SEARCH = (16, 3), (8, 5)
_PARENTS = 2  # candidates that have heirs
_HIO_STARTS, _HIO_ITERATIONS = 64, 500
_ADMM_CANDIDATES, _ADMM_LEVELS, _ADMM_ITERATIONS = 8, 6, 40


def annealed(
    posterior: Posterior,
    scout: AnnealedLangevin,
    key: jax.Array,
    chains: int,
    start: np.ndarray | None = None,
    progress: bool = False,
) -> np.ndarray:
    """Ends (chains, *shape) of one annealing run a chain, from `start`, noised, or from nowhere."""
    settings = {"draws": 1, "warmup": 0, "progress": progress}
    found = sample(posterior, scout, key, chains=chains, start=start, **settings)
    return found.values[:, 0]


def has_magnitudes(optics: Optics) -> bool:
    """Whether `from_magnitudes` serves: a Fourier transform of an object that something bounds."""
    if not isinstance(optics, Fourier):
        return False
    return optics.in_shape != optics.out_shape or optics.support is not None


def from_magnitudes(
    posterior: Posterior,
    scout: AnnealedLangevin,
    key: jax.Array,
    chains: int,
    progress: bool = False,
) -> np.ndarray:
    """Starts (chains, *shape) for phase retrieval; `scout` is the annealing between the choices.

    The paper's start, a noised solution of hybrid input-output, for several candidates a chain;
    annealing brings each to the valley beside it. Valleys differ by thousands of nats, far more
    than draws within one: the best candidates are noised and annealed again, as many as before. The
    chains share nothing, so that R-hat still tells whether they found the same valley.

    Candidates are ranked by the posterior, or by the likelihood alone if the prior has no density.
    Real objects are taken to be nonnegative. Raises ValueError as `hio` does.
    """
    learned = isinstance(posterior.prior, LearnedPrior)
    candidates, generations = _LEARNED_SEARCH if learned else _FIELD_SEARCH
    key_hio, *keys = jax.random.split(key, 1 + generations)
    keys_hio = [jax.random.fold_in(key_hio, i) for i in range(chains)]
    pool = np.stack([_solutions(posterior, k, candidates) for k in keys_hio])
    shape = pool.shape
    for generation in keys:
        flat = pool.reshape(-1, *posterior.shape)
        pool = annealed(posterior, scout, generation, len(flat), flat, progress).reshape(shape)
        pool = np.stack([_heirs(posterior, of_a_chain) for of_a_chain in pool])
    return _untwinned(pool[:, 0], posterior.likelihood.optics)


def by_admm(
    posterior: Posterior,
    key: jax.Array,
    chains: int,
    progress: bool = False,
    scout: LearnedPrior | None = None,
) -> np.ndarray:
    """Starts (chains, *shape) for phase retrieval, for annealing that begins near the noise.

    Of each chain the best of 8 solutions of hybrid input-output, after plug-and-play ADMM with the
    prior's denoiser, from its own scale down to half of the noise; ranked as `from_magnitudes`
    does. Under the natural prior it ends in deeper valleys than that search, in less than half of
    its time: on three pictures of 64x64 draws from there explain the recording by 1200 to 8100 nats
    more. At the broad levels where annealing begins, its own noise leads astray what the denoiser
    mends.

    `scout`: another prior whose denoiser searches. The sharper network need not be the better
    searcher: of three solutions for Boat at alpha 4 ADMM brings the best to 25.5 dB under
    `natural-large`, which denoises better at every level, and to 29.0 dB under `natural`.
    Real objects are taken to be nonnegative, and the optics are a Fourier transform. Raises
    ValueError as `hio` and `plug_and_play_admm` do.
    """
    levels = np.geomspace(
        float(posterior.annealing_range("convolved")[0]), float(posterior.data_level()) / 2,
        _ADMM_LEVELS,
    )  # fmt: skip
    found = []
    for i in track(range(chains), "starts by ADMM", disable=not progress):
        candidates = _solutions(posterior, jax.random.fold_in(key, i), _ADMM_CANDIDATES)
        ends = [
            plug_and_play_admm(
                posterior.likelihood, posterior.y, o, scout or posterior.prior, levels,
                iterations=_ADMM_ITERATIONS,
            ).object
            for o in candidates
        ]  # fmt: skip
        found.append(_heirs(posterior, np.stack(ends))[0])
    return _untwinned(np.stack(found), posterior.likelihood.optics)


def for_ptychography(
    posterior: Posterior,
    key: jax.Array,
    chains: int,
    progress: bool = False,
    measured: bool = False,
) -> np.ndarray | None:
    """Starts (chains, *shape) for a learned prior; None unless it is ptychography.

    The object of highest likelihood, with the prior's global phase. The slowest phases of an object
    hardly move while a chain is annealed; where the model is right the noise of the first level
    is as wide as they are uncertain. Of a `measured` stack it is not, so that each chain starts
    from a random half of the images (`half_samples`).
    """
    likelihood, y = posterior.likelihood, posterior.y
    if not isinstance(likelihood.optics, FourierPtychography):
        return None
    if measured:
        return _turned(half_samples(likelihood, y, key, chains, progress=progress), posterior.prior)
    found = np.asarray(maximum_likelihood(likelihood, y).object)
    return np.repeat(_turned(found[None], posterior.prior), chains, axis=0)


def _turned(objects: np.ndarray, prior: LearnedPrior) -> np.ndarray:
    """Each (n, *shape) by the global phase that brings it nearest to the prior's mean picture.

    That is what the network makes of a picture at the broadest level, where nothing is left of it.
    """
    broadest = jnp.asarray(prior.statistics.sigma_max, objects.real.dtype)
    mean = np.asarray(prior.denoise(jnp.zeros_like(objects[0]), broadest))
    turns = np.exp(1j * np.angle([np.vdot(o, mean) for o in objects]))
    return (objects * turns.reshape(-1, *(1,) * mean.ndim)).astype(objects.dtype)


def _solutions(posterior: Posterior, key: jax.Array, keep: int) -> np.ndarray:
    """The `keep` best solutions of hybrid input-output."""
    kind = "complex" if posterior.prior.complex_valued else "nonnegative"
    settings = {"starts": max(_HIO_STARTS, keep), "iterations": _HIO_ITERATIONS, "keep": keep}
    found = hio(posterior.likelihood, posterior.y, key, kind=kind, **settings)
    return np.asarray(found.objects)


def _heirs(posterior: Posterior, candidates: np.ndarray) -> np.ndarray:
    """The best few in turn, the very best first, as many as there were candidates."""
    order = jnp.argsort(-_log_probs(posterior, candidates))
    return candidates[np.resize(order[:_PARENTS], len(candidates))]


@eqx.filter_jit
def _log_probs(posterior: Posterior, objects: np.ndarray) -> jax.Array:
    has_density = not isinstance(posterior.prior, ScorePrior)
    return jax.vmap(posterior.log_prob if has_density else posterior.log_likelihood)(objects)


def _untwinned(objects: np.ndarray, optics: Optics) -> np.ndarray:
    """Each flipped if that brings it nearer to the first: a metric is pooled over the chains."""
    if CONJUGATE_FLIP not in optics.symmetries:
        return objects
    first = objects[0]
    twins = np.conj(np.flip(objects, axis=tuple(range(1, objects.ndim))))
    as_is, flipped = (np.abs(np.tensordot(o, first.conj(), first.ndim)) for o in (objects, twins))
    nearer = (flipped > as_is).reshape(-1, *(1,) * first.ndim)
    return np.where(nearer, twins, objects)
