"""Real objects among complex ones: what a complex network trained on real pictures would learn."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm

from ..realview import is_complex
from .base import Prior


class RealAmongComplex(Prior):
    """A prior of real objects x, for samplers of complex ones: o = x + 0j.

    A complex annealing error has independent Re and Im of sd sigma / 2 (eq:part_complex): Re is
    the real object with an error of that level, Im the error alone, so that all here is as exact as
    the `prior` is. At sigma = 0 there is no density: levels are held at the finest of a learned
    prior, and for others sigma must be above 0. Raises ValueError for a prior of complex objects or
    of another perturbation than the gaussian.
    """

    prior: Prior
    shape: tuple[int, ...] = eqx.field(static=True)
    complex_valued: bool = eqx.field(static=True)
    perturbation: str = eqx.field(static=True)

    def __init__(self, prior: Prior):
        if prior.complex_valued or prior.perturbation != "gaussian":
            raise ValueError(
                f"the prior is {'complex' if prior.complex_valued else 'real'} with the "
                f"{prior.perturbation!r} perturbation: give one of real objects with the gaussian"
            )
        self.prior, self.shape = prior, prior.shape
        self.complex_valued, self.perturbation = True, "gaussian"

    @property
    def scale(self) -> jax.Array:
        """Root mean square of Re and Im about the mean: Im has none."""
        return self.prior.scale / jnp.sqrt(2.0)

    @property
    def finest(self) -> float:
        """Twice that of the real prior: its level is the error of Re alone."""
        return 2 * self.prior.finest

    def sample(self, key: jax.Array) -> jax.Array:
        """One object, without an imaginary part."""
        return self.prior.sample(key).astype(self.dtype)

    def start(self, key: jax.Array) -> jax.Array:
        """Where the real prior starts."""
        return self.prior.start(key).astype(self.dtype)

    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Log-density of the annealed variable; -inf or nan at sigma = 0."""
        sd = self._sd(sigma)
        return self.prior.log_prob(x.real, sd) + jnp.sum(norm.logpdf(x.imag, scale=sd))

    def score(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """That of Re, and -Im / sd^2."""
        self._to_vector(x)
        sd = self._sd(sigma)
        score = self.prior.score(x.real, sd), -jnp.imag(x) / sd**2
        return jax.lax.complex(score[0], score[1].astype(score[0].dtype))

    def denoise(self, x: jax.Array, sigma: jax.Array | float) -> jax.Array:
        """What the real prior makes of Re."""
        self._to_vector(x)
        clean = self.prior.denoise(x.real, self._sd(sigma))
        return clean.astype(x.dtype if is_complex(x.dtype) else self.dtype)

    def _sd(self, sigma: jax.Array | float) -> jax.Array:
        return jnp.maximum(self._component_sd(jnp.asarray(sigma, float)), self.prior.finest)
