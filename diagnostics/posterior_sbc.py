"""Posterior SBC: is a sampler calibrated at the recording at hand, not on average over others?"""

import os
from collections.abc import Mapping
from concurrent.futures import Executor

import jax
import jax.numpy as jnp
import numpy as np

from ..models.exposures import Exposures
from ..problem import Posterior
from ..samplers.base import Sampler
from .campaign import Drawer, Enumerated
from .checks import check_draws_finite, check_varies
from .quantities import Quantity
from .sbc import Calibration, sbc


def posterior_sbc(
    posterior: Posterior,
    first: np.ndarray,
    sampler: Sampler | Drawer,
    key: jax.Array,
    simulations: int = 200,
    *,
    quantities: Mapping[str, Quantity] | None = None,
    chains: int = 1,
    draws: int = 100,
    warmup: int | None = None,
    thin: int = 1,
    independent: bool | None = None,
    batch: int | None = None,
    limit: float | None = None,
    folder: str | os.PathLike | None = None,
    executor: Executor | None = None,
    progress: bool = True,
) -> Calibration:
    """Calibration of `sampler` at the recording y of `posterior` (Säilynoja et al. 2025).

    `first` (n, *shape): draws of `posterior` by the same sampler. From each a second exposure y' is
    simulated, and the object is drawn anew given both. If both runs are exact, the rank of
    f(first, (y, y')) among f of the new draws is uniform, for every f. `simulations` of `first` are
    taken, at even distances. They must be as good as independent there: draws that resemble each
    other are not so many witnesses, and an exact sampler then fails too often. Give one draw each
    of many chains, or chains whose `ess` is several times `simulations`.

    `quantities`: {name: f(x, (y, y'))}, the recordings of shape (2, *data_shape), a real scalar
    each; None: `default_quantities` of both exposures. The sampler sees the likelihood `Exposures`.
    The rest as in `sbc`; simulation i depends on `fold_in(key, i)` and its object alone.

    Blind to what is common to both runs: a sampler that is exact for another prior passes, such as
    one that never finds a mode, and so does a wrong model, for the second exposure is of it. Other
    faults of both runs cancel in part. `sbc` sees them, on average over recordings.
    Raises ValueError as `sbc` does, for `first` of another shape or kind, shorter than
    `simulations`, not finite or all the same, and for cameras and priors that `Exposures` refuses.
    """
    if not isinstance(posterior, Posterior):
        raise ValueError(f"posterior is a {type(posterior).__name__}: use problem.condition(y)")
    objects = _chosen(first, posterior, simulations)
    both = Exposures(posterior.likelihood, 2)
    problem = _SecondExposure(both, posterior.prior, posterior.y, objects)
    return sbc(
        problem, sampler, key, simulations, quantities=quantities, chains=chains, draws=draws,
        warmup=warmup, thin=thin, independent=independent, batch=batch, limit=limit,
        folder=folder, executor=executor, progress=progress,
    )  # fmt: skip


class _SecondExposure(Enumerated):
    """Two exposures of which one is recorded; simulated of the objects (n, *shape) in turn."""

    y: jax.Array
    objects: jax.Array

    def numbered(self, key: jax.Array, number: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The object of this number, and the recording beside a second exposure of it."""
        x = self.objects[number]
        second = self.likelihood.likelihood.simulate(key, x)
        return x, jnp.stack([self.y.astype(second.dtype), second])


def _chosen(first: np.ndarray, posterior: Posterior, count: int) -> jax.Array:
    first = np.asarray(first)
    if first.shape[1:] != posterior.shape:
        raise ValueError(
            f"first draws of shape {first.shape}: give (n, *{posterior.shape}), chains one after "
            "the other"
        )
    if np.iscomplexobj(first) != posterior.prior.complex_valued:
        raise ValueError(f"first draws are {first.dtype}, the object is {posterior.dtype}")
    if len(first) < count:
        raise ValueError(
            f"{len(first)} first draws for {count} simulations: give one or more for each"
        )
    check_draws_finite(first, "first draws")
    check_varies(first, axis=0)
    kind = complex if np.iscomplexobj(first) else float
    even = np.linspace(0, len(first) - 1, count).round().astype(int)
    return jnp.asarray(first[even], jax.dtypes.canonicalize_dtype(kind))
