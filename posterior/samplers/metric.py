"""Metrics: the linear map M that turns a posterior of mixed scales into one of equal scales.

A preconditioned Langevin step is x + h M score + sqrt(2 h) M^(1/2) n. Both metrics are diagonal in
some real coordinates of the object, in which `estimate` learns them.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp


class Metric(eqx.Module):
    """A positive map that is diagonal in its own coordinates."""

    variance: eqx.AbstractVar[jax.Array]

    @abc.abstractmethod
    def root(self, x: jax.Array) -> jax.Array:
        """M^(1/2) x."""

    @staticmethod
    @abc.abstractmethod
    def coordinates(x: jax.Array) -> jax.Array:
        """The object in the coordinates where M is diagonal; complex = two real ones."""

    @classmethod
    @abc.abstractmethod
    def identity(cls, x: jax.Array) -> "Metric":
        """The metric that changes nothing, for objects like `x`."""

    @classmethod
    @abc.abstractmethod
    def from_spread(cls, position: jax.Array, score: jax.Array) -> "Metric":
        """M from the spreads, in these coordinates, of positions and of scores.

        sd(position)/sd(score) for each coordinate: exactly the variance of a Gaussian target,
        wherever its draws are taken, so it is learned long before the chains have mixed
        Spreads are variances: complex arrays hold one for Re and one for Im.
        """


class Diagonal(Metric):
    """One variance for each real component of each pixel (complex: for Re and for Im)."""

    variance: jax.Array

    def root(self, x: jax.Array) -> jax.Array:
        """M^(1/2) x."""
        return _by_part(lambda v, x: jnp.sqrt(v) * x, self.variance, x)

    @staticmethod
    def coordinates(x: jax.Array) -> jax.Array:
        """The pixels themselves."""
        return x

    @classmethod
    def identity(cls, x: jax.Array) -> "Diagonal":
        """Unit variances."""
        return cls(_by_part(lambda x: jnp.ones_like(x), x))

    @classmethod
    def from_spread(cls, position: jax.Array, score: jax.Array) -> "Diagonal":
        """sd ratio for each real component."""
        return cls(_by_part(_ratio, position, score))


class FourierDiagonal(Metric):
    """One variance for each Fourier coefficient: for posteriors that are nearly stationary."""

    variance: jax.Array

    def root(self, x: jax.Array) -> jax.Array:
        """M^(1/2) x."""
        result = jnp.fft.ifftn(jnp.sqrt(self.variance) * jnp.fft.fftn(x))
        return result if jnp.iscomplexobj(x) else result.real

    @staticmethod
    def coordinates(x: jax.Array) -> jax.Array:
        """Unitary Fourier coefficients."""
        return jnp.fft.fftn(x, norm="ortho")

    @classmethod
    def identity(cls, x: jax.Array) -> "FourierDiagonal":
        """Unit variances."""
        return cls(jnp.ones(x.shape, x.real.dtype))

    @classmethod
    def from_spread(cls, position: jax.Array, score: jax.Array) -> "FourierDiagonal":
        """sd ratio for each coefficient, Re and Im together."""
        return cls(_ratio(position.real + position.imag, score.real + score.imag))


METRICS = {"diagonal": Diagonal, "fourier": FourierDiagonal}


def _ratio(position: jax.Array, score: jax.Array) -> jax.Array:
    ratio = jnp.sqrt(position / jnp.where(score > 0, score, 1.0))
    return jnp.where((score > 0) & (ratio > 0) & jnp.isfinite(ratio), ratio, 1.0)


def _by_part(function: callable, *arrays: jax.Array) -> jax.Array:
    """Apply a real function to Re and to Im apart; arrays are all real or all complex."""
    if not jnp.iscomplexobj(arrays[0]):
        return function(*arrays)
    return jax.lax.complex(function(*(a.real for a in arrays)), function(*(a.imag for a in arrays)))
