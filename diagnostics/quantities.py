"""What calibration is asked of: real numbers f(x, y) of an object and its recording.

Every f is valid, for the rank of f(truth, y) among f(draw, y) is uniform whatever f is. Which
faults it sees depends on f: those of the recording, such as the log-likelihood, see a posterior
that forgot its data, and pixels or parameters never do (Modrak et al. 2023).
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..estimators.quasi_newton import default_start
from ..models.likelihood import Likelihood
from ..models.priors.base import Prior
from ..problem import Problem

Quantity = Callable[[jax.Array, jax.Array], jax.Array]

_RINGS = {"low": (0.0, 1 / 6), "middle": (1 / 6, 1 / 3), "high": (1 / 3, np.inf)}
_SCALES = 3


def values_of(
    names: Sequence[str], quantities: Sequence[Quantity], x: jax.Array, y: jax.Array
) -> jax.Array:
    """The quantities of (x, y), (Q,); ValueError, with its name, for one that is no real number."""
    found = [f(x, y) for f in quantities]
    for name, value in zip(names, found):
        if jnp.shape(value) != () or jnp.iscomplexobj(value):
            raise ValueError(f"{name} is no real number (f(x, y) gives {value}): give one")
    return jnp.stack(found)


class LogLikelihood(eqx.Module):
    """Exact log-probability of the recording."""

    likelihood: Likelihood

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        return self.likelihood.log_prob(x, y)


class LogPrior(eqx.Module):
    """Log-density of the prior."""

    prior: Prior

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        return self.prior.log_prob(x)


class LogPosterior(eqx.Module):
    """Both: ranks of the posterior density are the coverage of its highest-density regions."""

    likelihood: Likelihood
    prior: Prior

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        return self.likelihood.log_prob(x, y) + self.prior.log_prob(x)


DENSITIES = (LogLikelihood, LogPrior, LogPosterior)


class DistanceToEstimate(eqx.Module):
    """Squared distance to what the recording alone suggests, c H^H y.

    TARP's coverage (Lemos et al. 2023) with a reference that depends on the data. With one that
    does not, it passes the prior for the posterior.
    """

    likelihood: Likelihood

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        start = default_start(self.likelihood, y)
        return _energy(x - (start if jnp.iscomplexobj(x) else start.real))


class DistanceToAmplitudes(eqx.Module):
    """Squared distance of the field's amplitudes from those recorded, sqrt(y); of intensities.

    TARP with a reference that depends on the data, where no object is known to suggest: defined for
    every optics, and blind to a global phase. No default: the noise of sqrt(y) is the same at every
    brightness, so that the log-likelihood of counts orders draws nearly alike, and in phase
    retrieval of two pixels neither the prior, nor another recording, nor a likelihood too broad was
    caught at fewer simulations for it. Raises ValueError for linear optics, which have
    `DistanceToEstimate`.
    """

    likelihood: Likelihood

    def __check_init__(self):
        if self.likelihood.linear:
            raise ValueError(
                f"{type(self.likelihood).__name__} records a field, not its intensity: use "
                "DistanceToEstimate"
            )

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        # Read noise makes values below 0, which suggest darkness.
        recorded = jnp.sqrt(jnp.maximum(y, 0.0))
        return _energy(jnp.sqrt(self.likelihood.expected(x)) - recorded)


class DistanceTo(eqx.Module):
    """Squared distance to one object, such as a mode: sees chains that never leave theirs."""

    place: jax.Array

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        return _energy(x - self.place.astype(x.dtype))


class SquaredNorm(eqx.Module):
    """Sum of |x|^2: sees errors of the spread that are small in every pixel."""

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        return _energy(x)


class PatchMean(eqx.Module):
    """Mean over a part of the object; of the amplitude, if it is complex."""

    patch: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        part = x[tuple(slice(*ends) for ends in self.patch)]
        return jnp.mean(jnp.abs(part) if jnp.iscomplexobj(part) else part)


class RingEnergy(eqx.Module):
    """Energy between two spatial frequencies, in cycles a pixel; blind to a global phase."""

    low: float = eqx.field(static=True)
    high: float = eqx.field(static=True)
    axes: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        ring = jnp.asarray(self.inside(x.shape), x.real.dtype)
        return _energy(jnp.fft.fftn(x, axes=self.axes, norm="ortho") * ring)

    def inside(self, shape: tuple[int, ...]) -> np.ndarray:
        """Which frequencies of an object of `shape`, with one axis of size 1 for any other."""
        sides = [shape[axis] for axis in self.axes]
        parts = np.meshgrid(*(np.fft.fftfreq(n) for n in sides), indexing="ij", sparse=True)
        radius = np.sqrt(sum(part**2 for part in parts))
        ring = (self.low <= radius) & (radius < self.high)
        return ring.reshape(*ring.shape, *(1,) * (len(shape) - ring.ndim))


class HaarEnergy(eqx.Module):
    """Energy of the differences of neighbouring blocks, 2^scale pixels wide."""

    scale: int = eqx.field(static=True)
    axes: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """A real scalar."""
        for _ in range(self.scale):
            for axis in self.axes:
                x = sum(_pairs(x, axis)) / 2
        return sum(_energy(jnp.subtract(*_pairs(x, axis))) for axis in self.axes)


def default_quantities(problem: Problem) -> dict[str, Quantity]:
    """What `sbc` asks, unless told otherwise, by name.

    Of the recording: log-likelihood, and for linear optics the distance to c H^H y. Of the object:
    log-prior and log-posterior where the prior has a density, squared norm, means of halves or
    quarters, energies of three Fourier rings and of Haar wavelets of up to three scales. Those of
    complex objects do not see a global phase, the densities and the distance apart.
    """
    likelihood, prior, shape = problem.likelihood, problem.prior, problem.prior.shape
    # Colours are no place: a third axis is left alone.
    axes = tuple(range(min(len(shape), 2)))
    found: dict[str, Quantity] = {"log-likelihood": LogLikelihood(likelihood)}
    if has_density(prior):
        found["log-prior"] = LogPrior(prior)
        found["log-posterior"] = LogPosterior(likelihood, prior)
    if likelihood.linear:
        found["distance to estimate"] = DistanceToEstimate(likelihood)
    found["squared norm"] = SquaredNorm()
    for patch in _patches(tuple(shape[axis] for axis in axes)):
        place = ", ".join(f"{first}:{last}" for first, last in patch)
        found[f"mean [{place}]"] = PatchMean(patch)
    for name, (low, high) in _RINGS.items():
        ring = RingEnergy(low, high, axes)
        if ring.inside(shape).any():
            found[f"{name} frequencies"] = ring
    for scale in range(_SCALES):
        if min(shape[axis] for axis in axes) >= 2 ** (scale + 1):
            found[f"wavelets of {2**scale} px"] = HaarEnergy(scale, axes)
    return found


def has_density(prior: Prior) -> bool:
    """Whether `log_prob` is known: of a score network it is not."""
    x = jax.ShapeDtypeStruct(prior.shape, prior.dtype)
    try:
        eqx.filter_eval_shape(prior.log_prob, x)
    except (ValueError, NotImplementedError):
        return False
    return True


def _patches(sides: tuple[int, ...]) -> list[tuple[tuple[int, int], ...]]:
    """The object in halves along every axis of two pixels or more."""
    found: list[tuple[tuple[int, int], ...]] = [()]
    for n in sides:
        halves = [(0, n)] if n < 2 else [(0, n // 2), (n // 2, n)]
        found = [(*patch, half) for patch in found for half in halves]
    return found


def _pairs(x: jax.Array, axis: int) -> tuple[jax.Array, jax.Array]:
    """Even and odd neighbours along an axis; an odd one at the end is left out."""
    even = x.shape[axis] // 2 * 2
    x = jax.lax.slice_in_dim(x, 0, even, axis=axis)
    return tuple(jax.lax.slice_in_dim(x, i, even, 2, axis) for i in (0, 1))


def _energy(x: jax.Array) -> jax.Array:
    return jnp.sum(jnp.square(x.real) + (jnp.square(x.imag) if jnp.iscomplexobj(x) else 0.0))
