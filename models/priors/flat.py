"""No prior at all: every object is as likely as any other."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp

from .base import Prior, checked_shape, is_complex_kind


class FlatPrior(Prior):
    """The improper density 1 over objects of `shape`, real or complex (`dtype`).

    An annealing error does not change it, so its score is zero at every level and the posterior is
    the likelihood, normalised where it can be: where the data leave nothing free. It serves as the
    baseline without a prior. It is no distribution: it has no draws and no scale, so that samplers
    need a start, and annealing `sigma_max` and `sigma_min` or the path "split". Evidence under it
    means nothing.
    """

    shape: tuple[int, ...] = eqx.field(static=True)
    complex_valued: bool = eqx.field(static=True)
    perturbation: str = eqx.field(static=True)

    def __init__(self, shape: Sequence[int] | int, dtype: type = float):
        self.shape = checked_shape(shape)
        self.complex_valued = is_complex_kind(dtype)
        self.perturbation = "gaussian"

    @property
    def scale(self) -> jax.Array:
        """Refuses: it would be infinite."""
        raise ValueError(
            "a flat prior has no scale to anneal from: give sigma_max= and sigma_min=, or "
            'path="split"'
        )

    @property
    def stiffness(self) -> float:
        """0: the log-density is not curved."""
        return 0.0

    def sample(self, key: jax.Array) -> jax.Array:
        """Refuses: nothing can be drawn from an improper density."""
        raise ValueError("a flat prior has no draws: give start=, such as a maximum likelihood")

    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """0 at every level: the density has no norm, and only differences mean anything."""
        return jnp.zeros((), self._to_vector(x).dtype)

    def score(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Zeros, in the shape and the dtype of `x`."""
        self._to_vector(x)
        return jnp.zeros_like(x)
