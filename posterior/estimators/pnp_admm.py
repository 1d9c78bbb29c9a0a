"""Plug-and-play ADMM: an object that explains its intensities, with any denoiser for its prior.

Venkatakrishnan, Bouman and Wohlberg, GlobalSIP 2013; for phase retrieval Heide et al., ACM Trans.
Graphics 35, 84 (2016), and Metzler et al., ICML 2018, who compare with it. With amplitudes
a = sqrt(y / irradiance) it looks for the least of

    || a - |z| ||^2 / 2 + R(x),   z = H x,

by turns: z keeps the direction of H x + u and comes nearer to the amplitudes, in closed form; u
adds up by how far z and H x are apart; and the denoiser takes the place of R's proximal map. Where
H^H H = 1, as of a Fourier transform, the map is exact; of other optics ADMM is linearised.
"""

import operator
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..models.annealing import component_sd
from ..models.likelihood import IntensityLikelihood
from .denoisers import Denoiser, check_denoiser, iterated
from .magnitudes import Magnitudes, magnitudes
from .red import positive


class Plugged(NamedTuple):
    """The object that `plug_and_play_admm` ended at.

    `gap`: || H x - z || / || amplitude ||; 0 where the iterations have come to an end.
    """

    object: jax.Array
    gap: jax.Array


class _State(NamedTuple):
    object: jax.Array
    dual: jax.Array
    gap: jax.Array


def plug_and_play_admm(
    likelihood: IntensityLikelihood,
    y: np.ndarray,
    start: jax.Array,
    denoiser: Denoiser,
    levels: Sequence[float],
    weight: float = 1.0,
    iterations: int = 50,
) -> Plugged:
    """What plug-and-play ADMM makes of `start`, such as the object that `hio` finds.

    - `y`: of `likelihood.data_shape`, normalised; `start`: of the object's shape, real or complex.
    - `denoiser`: a prior of the gaussian perturbation, or a function of an array and the sd of its
      noise (BM3D).
    - `levels`: of the denoiser, units of the object; `iterations` at each.
    - `weight`: of the penalty; at 1 it is the variance of an amplitude's noise over that of the
      level, and what a Gaussian prior's denoiser ends at is stationary under the posterior with
      normal amplitudes of one variance.

    Neither saturation nor the ADC is modelled, and all amplitudes weigh alike. Of the loss, which
    has many minima, it finds one near the start, if any: with a denoiser that is no proximal map
    nothing is promised, and `gap` tells. One compiled computation with a prior, a loop with a
    function. Raises ValueError for other likelihoods and starts, and numbers that are not positive
    and finite.
    """
    problem, start = magnitudes(likelihood, y, start, "plug-and-play ADMM")
    complex_object = jnp.iscomplexobj(start)
    check_denoiser(denoiser, start.shape, complex_object)
    levels = np.array([positive("level", level) for level in levels])
    weight = positive("weight", weight)
    if operator.index(iterations) < 1 or not levels.size:
        raise ValueError(f"iterations {iterations} at levels {levels}: give 1 or more of both")
    noise = float(jnp.min(problem.variance))
    curvature = float(likelihood.optics.norm_squared())
    penalties = weight * noise / curvature / component_sd(levels, complex_object) ** 2
    real = start.real.dtype
    each = [jnp.asarray(np.repeat(v, iterations), real) for v in (levels, penalties)]
    schedule = (*each, jnp.full(each[0].shape, curvature, real))
    field = likelihood.optics(start)
    state = _State(start, jnp.zeros_like(field), jnp.ones((), real))
    found = iterated(_step, problem, denoiser, state, schedule)
    return Plugged(found.object, found.gap)


def _step(
    problem: Magnitudes, denoise: Callable, state: _State, at: tuple[jax.Array, ...]
) -> _State:
    """`dual` is u times the penalty, which changes with the level."""
    level, penalty, curvature = at
    x, field = state.object, problem.optics(state.object)
    moved = field + state.dual / penalty
    modulus = (problem.amplitude + penalty * jnp.abs(moved)) / (1 + penalty)
    z = modulus * jnp.sign(moved)
    apart = field - z
    dual = state.dual + penalty * apart
    back = problem.to_object(apart + dual / penalty, x)
    gap = jnp.linalg.norm(apart) / jnp.linalg.norm(problem.amplitude)
    return _State(denoise(x - back / curvature, level), dual, gap)
