"""prGAMP: phase retrieval by approximate message passing around a denoiser.

Schniter and Rangan, IEEE Trans. Signal Processing 63, 1043 (2015), for amplitudes |H x + w|; with a
denoiser for the prior Metzler, Maleki and Baraniuk, ICIP 2016 (BM3D-prGAMP). By turns a field is
estimated from its amplitudes and from what the object says of it, and the object, which the fields
show under white Gaussian noise of a known standard deviation, is denoised. What each iteration
subtracts of the last (Onsager's term) keeps that noise white where H is like a matrix of
independent normal entries; of other optics that is an approximation, and damping keeps it from
diverging (Rangan, Schniter, Riegler, Fletcher and Cevher, IEEE Trans. Information Theory 2019).
"""

import operator
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..models.annealing import bessel_ratio
from ..models.likelihood import IntensityLikelihood
from ..models.optics import Fourier
from ..models.realview import normal_like
from .denoisers import Denoiser, check_denoiser, iterated
from .magnitudes import Magnitudes, magnitudes
from .red import positive

# Of the noise in what is denoised: how far the Monte-Carlo divergence moves it (Ramani, Blu and
# Unser 2008).
_PROBE = 0.1
_LEAST_SLOPE = 1e-4
_LEAST_TOLD = 0.01  # of what fields known exactly would tell


class Passed(NamedTuple):
    """The object that `prgamp` ended at, and the standard deviation `sd` of its error, per real
    component, that message passing itself states: right where its assumptions hold.
    """

    object: jax.Array
    sd: jax.Array


class _State(NamedTuple):
    """`variance`: of the object, |.|^2; `told`: of the field, per unit of variance (nu_s)."""

    object: jax.Array
    damped: jax.Array
    dual: jax.Array
    variance: jax.Array
    told: jax.Array


def prgamp(
    likelihood: IntensityLikelihood,
    y: np.ndarray,
    key: jax.Array,
    start: jax.Array,
    denoiser: Denoiser,
    start_sd: float,
    iterations: int = 50,
    damping: float = 0.1,
    finest: float = 1e-4,
) -> Passed:
    """What message passing makes of `start`, such as the object that `hio` finds.

    - `y`: of `likelihood.data_shape`, normalised; `start`: of the object's shape, real or complex,
      with an error of `start_sd` per real component.
    - `denoiser`: a prior of the gaussian perturbation, or a function of an array and the sd of its
      noise (BM3D). Each iteration asks it twice, for its divergence along a random direction.
    - `damping`: how much of what is new an iteration takes, in (0, 1]; 1 is undamped.
    - `finest`: the least sd that the denoiser is told, units of the object.

    The noise of an amplitude is taken for that of a field with normal noise w, twice its variance.
    The Fourier transform of a real object has the same amplitude at k and -k: the two recordings
    are averaged, and count once. Neither saturation nor the ADC is modelled but by its variance.
    One compiled computation with a prior, a loop with a function. Raises ValueError for other
    likelihoods and starts, optics whose field is real, and numbers out of range.
    """
    problem, start = magnitudes(likelihood, y, start, "prGAMP")
    real = start.real.dtype
    if not jnp.iscomplexobj(likelihood.optics(start)):
        raise ValueError("the field is real, and its phase a sign: prGAMP is for complex fields")
    check_denoiser(denoiser, start.shape, jnp.iscomplexobj(start))
    start_sd, finest = positive("start_sd", start_sd), positive("finest", finest)
    if operator.index(iterations) < 1:
        raise ValueError(f"iterations {iterations}: give a whole number, 1 or more")
    if not 0 < damping <= 1:
        raise ValueError(f"damping {damping}: give a share of the new in (0, 1], 1 for none")
    twice = isinstance(likelihood.optics, Fourier) and not jnp.iscomplexobj(start)
    problem = _folded(problem) if twice else problem
    parts = 2 if jnp.iscomplexobj(start) else 1
    state = _State(
        start, start, jnp.zeros_like(likelihood.optics(start)),
        jnp.asarray(parts * start_sd**2, real), jnp.zeros(problem.amplitude.shape, real),
    )  # fmt: skip
    first = jnp.arange(iterations) == 0
    # The first iteration has nothing to damp with.
    takes = jnp.where(first, 1.0, damping).astype(real)
    constant = jnp.array([finest, 2.0 if twice else 1.0], real)
    schedule = (
        jax.random.split(key, iterations), takes, jnp.tile(constant, (iterations, 1)),
    )  # fmt: skip
    found = iterated(_step, problem, denoiser, state, schedule)
    return Passed(found.object, jnp.sqrt(found.variance / parts))


def field_moments(
    amplitude: jax.Array, noise: jax.Array, field: jax.Array, variance: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """E[z] and E|z - E[z]|^2 of a complex z ~ CN(field, variance) with |z + w| = amplitude.

    w ~ CN(0, noise). The phase of z + w is a von Mises one about that of `field`; given it z is
    normal (Schniter and Rangan 2015, Eqs. 16 to 23).
    """
    total = variance + noise
    modulus = jnp.abs(field)
    angle = 2 * amplitude * modulus / total
    ratio = angle * bessel_ratio(angle)
    known = (variance * amplitude * ratio + noise * modulus) / total
    square = (variance * amplitude) ** 2 + (noise * modulus) ** 2
    square += 2 * variance * noise * amplitude * modulus * ratio
    spread = square / total**2 + variance * noise / total - known**2
    return known * jnp.sign(field), spread


def _step(
    problem: Magnitudes, denoise: Callable, state: _State, at: tuple[jax.Array, ...]
) -> _State:
    key, take, (finest, times) = at
    optics, x = problem.optics, state.object
    parts = 2 if jnp.iscomplexobj(x) else 1
    power = optics.row_norms() ** 2
    reached = power * state.variance
    expected = optics(x) - reached * state.dual
    z, spread = field_moments(problem.amplitude, 2 * problem.variance, expected, reached)
    dual = state.dual + take * ((z - expected) / reached - state.dual)
    told = state.told + take * ((1 - spread / reached) / reached - state.told)
    damped = state.damped + take * (x - state.damped)
    # Of the object, complex, as the fields show it: both parts of the field tell of a real one.
    # Amplitudes that surprise make the field less certain than before: without a bound all may.
    least = _LEAST_TOLD * jnp.sum(power / reached)
    seen = x.size / jnp.maximum(jnp.sum(power * told), least)
    sd = jnp.maximum(jnp.sqrt(times * seen / 2), finest)
    shown = damped + problem.to_object(seen * dual, x)
    clean, slope = _denoised(key, denoise, shown, sd)
    variance = state.variance + take * (parts * sd**2 * slope - state.variance)
    return _State(clean, damped, dual, variance, told)


def _denoised(
    key: jax.Array, denoise: Callable, shown: jax.Array, sd: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The denoised object, and the mean slope of the denoiser along a random direction."""
    level = 2 * sd if jnp.iscomplexobj(shown) else sd
    probe = normal_like(key, shown)
    clean = denoise(shown, level)
    moved = denoise(shown + (_PROBE * sd * probe).astype(shown.dtype), level) - clean
    slope = jnp.vdot(probe, moved).real / jnp.vdot(probe, probe).real / (_PROBE * sd)
    return clean, jnp.clip(slope, _LEAST_SLOPE, 1.0)


def _folded(problem: Magnitudes) -> Magnitudes:
    """Of a real object: the mean intensity at k and -k, with the noise of a mean."""
    axes = tuple(range(problem.amplitude.ndim))

    def mean(values: jax.Array) -> jax.Array:
        return (values + jnp.roll(jnp.flip(values, axes), 1, axes)) / 2

    amplitude = jnp.sqrt(mean(problem.amplitude**2))
    return Magnitudes(problem.optics, amplitude, mean(problem.variance) / 2)
