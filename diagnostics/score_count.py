"""How often a run asks the prior for its score: counted while it runs, not declared."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models.priors.base import Prior
from ..problem import Posterior


def score_evaluations(run: Callable[[Posterior], Any], posterior: Posterior) -> int:
    """Prior score evaluations of `run(posterior)`, a function traceable by JAX, counted as it runs.

    An evaluation is a score or a denoised object at one point, or a gradient of the log-density;
    the density alone is none, and neither is a derivative that is carried through a denoiser. With
    a learned prior each is one pass through the network: the currency of diffusion posteriors.
    What is computed is counted: of chains that move side by side, also those that wait for the
    longer path of another. The run is compiled anew, and its values are those it has uncounted,
    but for rounding.
    """
    tally: list[int] = []
    counted = Posterior(posterior.likelihood, _counted(posterior.prior, tally), posterior.y)
    jax.block_until_ready(eqx.filter_jit(run)(counted))
    return sum(tally)


def _counted(prior: Prior, tally: list[int]) -> Prior:
    """The same prior, of a class of its own that writes down what it is asked for.

    A subclass: code that looks at the kind of the prior finds what it looks for.
    """
    kind = type(prior)

    def one(x: jax.Array) -> jax.Array:
        """1.0, and a line in the tally. Whatever needs it has been computed."""
        place = jax.lax.stop_gradient(jnp.ravel(x)[0].real)

        def write(places: jax.Array) -> np.ndarray:
            # Under vmap all points come at once.
            tally.append(int(np.size(places)))
            return np.ones(np.shape(places), places.dtype)

        like = jax.ShapeDtypeStruct((), place.dtype)
        return jax.pure_callback(write, like, place, vmap_method="broadcast_all")

    @jax.custom_jvp
    def differentiated(x: jax.Array) -> jax.Array:
        return x

    @differentiated.defjvp
    def _(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
        return primals[0], tangents[0] * one(primals[0])

    def score(self: Prior, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        return one(x) * _as(kind, self).score(x, sigma)

    def denoise(self: Prior, x: jax.Array, sigma: jax.Array | float) -> jax.Array:
        return one(x) * _as(kind, self).denoise(x, sigma)

    def log_prob(self: Prior, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        return _as(kind, self).log_prob(differentiated(x), sigma)

    methods = {"score": score, "denoise": denoise, "log_prob": log_prob}
    return _as(type(kind)(f"Counted{kind.__name__}", (kind,), methods), prior)


def _as(kind: type[Prior], prior: Prior) -> Prior:
    """The prior with its fields as they are, as one of `kind`."""
    made = object.__new__(kind)
    for field in dataclasses.fields(prior):
        object.__setattr__(made, field.name, getattr(prior, field.name))
    return made
