"""Metrics: the linear map M that turns a posterior of mixed scales into one of equal scales.

A preconditioned Langevin step is x + h M score + sqrt(2 h) R n with M = R R^T. Every metric is
diagonal in some coordinates of the object, in which warm-up learns it from spreads.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp


class Metric(eqx.Module):
    """A positive map M = R R^T that is diagonal in its own coordinates."""

    variance: eqx.AbstractVar[jax.Array]

    @abc.abstractmethod
    def root(self, x: jax.Array) -> jax.Array:
        """R x."""

    @abc.abstractmethod
    def root_adjoint(self, score: jax.Array) -> jax.Array:
        """R^T score."""

    @abc.abstractmethod
    def position_coordinates(self, x: jax.Array) -> Any:
        """The object in the coordinates whose spreads `learned` asks for; a pytree of arrays."""

    @abc.abstractmethod
    def score_coordinates(self, score: jax.Array) -> Any:
        """The score in the dual coordinates."""

    @classmethod
    @abc.abstractmethod
    def identity(cls, x: jax.Array) -> "Metric":
        """The metric that changes nothing, for objects like `x`."""

    @abc.abstractmethod
    def learned(self, position: Any, score: Any) -> "Metric":
        """The metric from the spreads, in these coordinates, of positions and of scores.

        sd(position)/sd(score) for each coordinate: exactly the variance of a Gaussian target,
        wherever its draws are taken, so it is learned long before the chains have mixed.
        Spreads are variances: complex arrays hold one for Re and one for Im.
        """


class Diagonal(Metric):
    """One variance for each real component of each pixel (complex: for Re and for Im)."""

    variance: jax.Array

    def root(self, x: jax.Array) -> jax.Array:
        """M^(1/2) x."""
        return _by_part(lambda v, x: jnp.sqrt(v) * x, self.variance, x)

    def root_adjoint(self, score: jax.Array) -> jax.Array:
        """M^(1/2) score."""
        return self.root(score)

    def position_coordinates(self, x: jax.Array) -> jax.Array:
        """The pixels themselves."""
        return x

    def score_coordinates(self, score: jax.Array) -> jax.Array:
        """The pixels themselves."""
        return score

    @classmethod
    def identity(cls, x: jax.Array) -> "Diagonal":
        """Unit variances."""
        return cls(_by_part(jnp.ones_like, x))

    def learned(self, position: jax.Array, score: jax.Array) -> "Diagonal":
        """sd ratio for each real component."""
        return type(self)(_by_part(_ratio, position, score))


class FourierDiagonal(Metric):
    """Stationary after each pixel is brought to scale: R = D F^-1 V^(1/2) F.

    D, `scale`, follows the brightness: photon noise makes the posterior of a dark pixel tighter
    than that of a bright one by far. V, `variance`, has one value for each Fourier coefficient. Of
    a complex object Re and Im are treated apart: near a transparent object they are the amplitude
    and the phase, which data and prior know unequally well.
    """

    scale: jax.Array
    variance: jax.Array

    def root(self, x: jax.Array) -> jax.Array:
        """D F^-1 V^(1/2) F x."""
        return _by_part(jnp.multiply, self.scale, self._filter(x))

    def root_adjoint(self, score: jax.Array) -> jax.Array:
        """F^-1 V^(1/2) F D score."""
        return self._filter(_by_part(jnp.multiply, self.scale, score))

    def position_coordinates(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The pixels, and the Fourier coefficients of the scaled object."""
        return x, _spectra(_by_part(jnp.divide, x, self.scale))

    def score_coordinates(self, score: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The same of the score."""
        return score, _spectra(_by_part(jnp.multiply, self.scale, score))

    @classmethod
    def identity(cls, x: jax.Array) -> "FourierDiagonal":
        """Unit scales and variances."""
        return cls(_by_part(jnp.ones_like, x), jnp.ones_like(_spectra(x).real))

    def learned(
        self, position: tuple[jax.Array, jax.Array], score: tuple[jax.Array, jax.Array]
    ) -> "FourierDiagonal":
        """Scales from the pixels, to a geometric mean of 1; sd ratios for the coefficients.

        The coefficients were measured under the former scale, which differs less from window to
        window. Their Re and Im are pooled: opposite frequencies have equal values.
        """
        pixels, spectra = zip(position, score)
        scale = _by_part(lambda *a: _normalised(jnp.sqrt(_ratio(*a))), *pixels)
        return type(self)(scale, _ratio(*(s.real + s.imag for s in spectra)))

    def _filter(self, x: jax.Array) -> jax.Array:
        if not jnp.iscomplexobj(x):
            return _filtered(self.variance, x)
        return jax.lax.complex(
            _filtered(self.variance[0], x.real), _filtered(self.variance[1], x.imag)
        )


METRICS = {"diagonal": Diagonal, "fourier": FourierDiagonal}


def _spectra(x: jax.Array) -> jax.Array:
    """Unitary Fourier coefficients; of a complex object those of Re and of Im, stacked."""
    if not jnp.iscomplexobj(x):
        return jnp.fft.fftn(x, norm="ortho")
    return jnp.stack([jnp.fft.fftn(part, norm="ortho") for part in (x.real, x.imag)])


def _filtered(variance: jax.Array, x: jax.Array) -> jax.Array:
    return jnp.fft.ifftn(jnp.sqrt(variance) * jnp.fft.fftn(x)).real


def _normalised(scale: jax.Array) -> jax.Array:
    return scale / jnp.exp(jnp.mean(jnp.log(scale)))


def _ratio(position: jax.Array, score: jax.Array) -> jax.Array:
    ratio = jnp.sqrt(position / jnp.where(score > 0, score, 1.0))
    return jnp.where((score > 0) & (ratio > 0) & jnp.isfinite(ratio), ratio, 1.0)


def _by_part(function: callable, *arrays: jax.Array) -> jax.Array:
    """Apply a real function to Re and to Im apart; arrays are all real or all complex."""
    if not jnp.iscomplexobj(arrays[0]):
        return function(*arrays)
    return jax.lax.complex(function(*(a.real for a in arrays)), function(*(a.imag for a in arrays)))
