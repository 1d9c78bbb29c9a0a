"""Quasi-Newton: the object of highest likelihood, or of highest posterior density, by L-BFGS.

For Fourier ptychography it is the method that Yeh et al. (Optics Express 23, 33214, 2015) found
most robust, here on the exact likelihood of what was recorded.
"""

import operator
import warnings
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ..models.likelihood import IntensityLikelihood, Likelihood
from ..models.optics import FourierPtychography
from ..models.realview import from_real, to_real
from ..problem import Posterior

with warnings.catch_warnings():
    # It works, and is pinned; that nobody maintains it is known here.
    warnings.filterwarnings("ignore", "JAXopt is no longer maintained", DeprecationWarning)
    import jaxopt


class Optimum(NamedTuple):
    """An object (*shape) where the climb ended, and the log-probability there.

    `gradient`: norm of the gradient there, over that at the start; `iterations`: how many it took.
    """

    object: jax.Array
    log_prob: jax.Array
    gradient: jax.Array
    iterations: jax.Array


def maximum_likelihood(
    likelihood: Likelihood,
    y: ArrayLike,
    start: ArrayLike | None = None,
    *,
    weights: ArrayLike = 1.0,
    iterations: int = 200,
    tolerance: float = 1e-5,
    history: int = 10,
) -> Optimum:
    """The object under which the recording `y` is most probable, no prior.

    - `y`: of `likelihood.data_shape`, normalised.
    - `start`: an object, real or complex: what is found is of its kind, and lies in its valley.
      None: `default_start`.
    - `weights`: how often each measurement counts, broadcast to `y`, from 0.
    - `iterations`: at most; it ends earlier where the gradient falls below `tolerance` times that
      at the start, or where rounding leaves no higher step to be found.
    - `history`: steps that the approximate curvature is built from.

    One compiled loop, in the real view. Raises ValueError for data that cannot be such a recording,
    a start that is not finite, or dark where light was recorded, and settings out of range.
    """
    y = _recording(likelihood, y)
    start = default_start(likelihood, y) if start is None else start
    target = _Data(likelihood, y, _weights(weights, y))
    return _climb(target, likelihood, y, start, iterations, tolerance, history)


def maximum_posterior(
    posterior: Posterior,
    start: ArrayLike | None = None,
    *,
    iterations: int = 200,
    tolerance: float = 1e-5,
    history: int = 10,
) -> Optimum:
    """The object of highest posterior density (MAP); the prior needs a `log_prob`.

    As `maximum_likelihood`; the object is of the prior's kind.
    """
    likelihood, y = posterior.likelihood, posterior.y
    if start is None:
        start = default_start(likelihood, y)
        # H^H y of a real object may be complex.
        start = start if posterior.prior.complex_valued else start.real
    if jnp.iscomplexobj(start) and not posterior.prior.complex_valued:
        raise ValueError(f"the start is complex ({start.dtype}), but the prior is for real objects")
    start = jnp.asarray(start, posterior.dtype)
    return _climb(posterior, likelihood, y, start, iterations, tolerance, history)


def default_start(likelihood: Likelihood, y: ArrayLike) -> jax.Array:
    """An object (*shape) to climb from, for optics that tell one.

    Ptychography: mean amplitude of the bright-field images (of all, if there is none), brought to
    the object's pixels by Fourier interpolation; complex. Linear optics: c H^H y with the c that
    fits best. Raises ValueError for the rest: an object without phases is no start.
    """
    optics = likelihood.optics
    if likelihood.linear:
        back = optics.adjoint(jnp.asarray(y))
        seen = optics(back)
        energy = jnp.vdot(seen, seen).real
        # A dark recording suggests a dark object.
        scale = jnp.vdot(seen, jnp.asarray(y)).real / jnp.where(energy > 0, energy, 1.0)
        return back * scale.astype(back.dtype)
    if isinstance(likelihood, IntensityLikelihood) and isinstance(optics, FourierPtychography):
        return _bright_field(likelihood, optics, y)
    raise ValueError(
        f"{type(optics).__name__} optics give no start: give start=, such as hio(...).object"
    )


class _Data(eqx.Module):
    """A likelihood and its recording: the target that has no prior."""

    likelihood: Likelihood
    y: jax.Array
    weights: jax.Array

    def log_prob_and_score(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        return self.likelihood.log_prob_and_score(x, self.y, self.weights)


def _climb(
    target: Posterior | _Data,
    likelihood: Likelihood,
    y: ArrayLike,
    start: ArrayLike,
    iterations: int,
    tolerance: float,
    history: int,
) -> Optimum:
    start = _checked_start(start, likelihood.object_shape)
    for name, value in (("iterations", iterations), ("history", history)):
        _check_count(name, value)
    if not 0 <= tolerance < 1:
        raise ValueError(f"tolerance {tolerance}: a fraction of the start's gradient, from 0 to 1")
    _check_lit(likelihood, y, start)
    # In units of the stiffest curvature the first step, along the gradient, is of the right size.
    stiffest = jnp.max(likelihood.curvature(jnp.iscomplexobj(start), y, 0.0, "convolved"))
    return _minimise(target, start, stiffest, jnp.asarray(tolerance), iterations, history)


@eqx.filter_jit
def _minimise(
    target: Posterior | _Data,
    start: jax.Array,
    stiffest: jax.Array,
    tolerance: jax.Array,
    iterations: int,
    history: int,
) -> Optimum:
    def cost(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        value, score = target.log_prob_and_score(from_real(v, start.shape, start.dtype))
        return -value / stiffest, -to_real(score) / stiffest

    v = to_real(start)
    steepest = jnp.linalg.norm(cost(v)[1])
    v, state = minimised(cost, v, iterations, tolerance * steepest, history)
    relative = jnp.where(steepest > 0, state.error / steepest, 0.0)
    o = from_real(v, start.shape, start.dtype)
    return Optimum(o, -state.value * stiffest, relative, state.iter_num)


def minimised(
    cost: Callable[[jax.Array], tuple[jax.Array, jax.Array]],
    v: jax.Array,
    iterations: int,
    tolerance: jax.Array | float,
    history: int,
) -> tuple[jax.Array, NamedTuple]:
    """Where `cost`, which gives value and gradient, is least near `v`, and the solver's state.

    Where no step down is found along the direction that the history suggests, the history is
    forgotten; it ends where that has led no further down than the last time.
    """
    solver = jaxopt.LBFGS(
        cost,
        value_and_grad=True,
        maxiter=iterations,
        tol=tolerance,
        history_size=history,
        stop_if_linesearch_fails=True,
        implicit_diff=False,
        unroll=False,
    )

    def goes_on(carry: tuple[jax.Array, NamedTuple, jax.Array]) -> jax.Array:
        _, state, stuck_at = carry
        stuck = state.failed_linesearch & (state.value >= stuck_at)
        return (state.iter_num < iterations) & (state.error > tolerance) & ~stuck

    def step(carry: tuple[jax.Array, NamedTuple, jax.Array]) -> tuple:
        v, state, stuck_at = carry
        forget = state.failed_linesearch

        def anew() -> NamedTuple:
            return solver.init_state(v)._replace(iter_num=state.iter_num)

        stuck_at = jnp.where(forget, state.value, stuck_at)
        state = jax.lax.cond(forget, anew, lambda: state)
        return *solver.update(v, state), stuck_at

    begin = solver.init_state(v)
    carry = v, begin, jnp.full_like(begin.value, jnp.inf)
    return jax.lax.while_loop(goes_on, step, carry)[:2]


# ---- where to start ------------------------------------------------------------------------------


def bright_fields(optics: FourierPtychography) -> np.ndarray:
    """Which LEDs (M,) shine through the pupil themselves, by half of its largest transmission."""
    low = optics.low_shape
    pupils = np.broadcast_to(np.asarray(optics.pupil), (len(optics.centres), *low))
    # The LED's own light, frequency zero, passes the pupil at the place opposite to the centre.
    place = np.array(low) // 2 - np.asarray(optics.centres)
    inside = np.all((place >= 0) & (place < low), axis=1)
    row, column = np.where(inside[:, None], place, 0).T
    # A soft pupil fades out: beyond its half the image is a dark field.
    return inside & (np.abs(pupils[np.arange(len(row)), row, column]) > np.abs(pupils).max() / 2)


def _bright_field(
    likelihood: IntensityLikelihood, optics: FourierPtychography, y: ArrayLike
) -> jax.Array:
    amplitude = likelihood.amplitude(jnp.asarray(y))
    low, bright = optics.low_shape, bright_fields(optics)
    mean = amplitude[bright if bright.any() else slice(None)].mean(axis=0)
    mean = jnp.pad(mean, [(r, r) for r in optics.rim], mode="symmetric")
    whole = FourierPtychography(optics.in_shape, np.zeros((1, 2), int), np.ones(low))
    return whole.adjoint(mean[None]) / whole.norm_squared()


# ---- what is accepted ----------------------------------------------------------------------------


def _recording(likelihood: Likelihood, y: ArrayLike) -> jax.Array:
    if not isinstance(likelihood, Likelihood):
        raise ValueError(
            f"likelihood is a {type(likelihood).__name__}: give a Likelihood of models, or a "
            "Posterior to maximum_posterior"
        )
    y = np.asarray(y)
    if y.shape != likelihood.data_shape:
        raise ValueError(f"data of shape {y.shape}: these optics record {likelihood.data_shape}")
    likelihood.camera.check(y)
    return jnp.asarray(y, jax.dtypes.canonicalize_dtype(complex if np.iscomplexobj(y) else float))


def _weights(weights: ArrayLike, y: jax.Array) -> jax.Array:
    weights = np.asarray(weights, float)
    if not (np.all(np.isfinite(weights)) and np.all(weights >= 0) and np.any(weights > 0)):
        raise ValueError(
            f"weights from {weights.min():.3g} to {weights.max():.3g}: give finite ones, from 0, "
            "not all 0"
        )
    try:
        fits = np.broadcast_shapes(weights.shape, y.shape) == y.shape
    except ValueError:
        fits = False
    if not fits:
        raise ValueError(
            f"weights of shape {weights.shape} for data of shape {y.shape}: give one for each "
            "measurement, or what broadcasts to them"
        )
    return jnp.asarray(weights, y.real.dtype)


def _checked_start(start: ArrayLike, shape: tuple[int, ...]) -> jax.Array:
    start = jnp.asarray(start)
    if start.shape != shape:
        raise ValueError(f"start of shape {start.shape}: the object has shape {shape}")
    if not jnp.issubdtype(start.dtype, jnp.inexact):
        start = start.astype(float)
    bad = int(jnp.sum(~jnp.isfinite(start)))
    if bad:
        raise ValueError(f"start holds {bad} values that are not finite: give numbers everywhere")
    return start


def _check_lit(likelihood: Likelihood, y: ArrayLike, start: jax.Array) -> None:
    if isinstance(likelihood, IntensityLikelihood):
        # The gradient of |H o|^2 is zero there.
        dark = not jnp.any(start != 0)
    else:
        dark = likelihood.camera.counting and jnp.any((likelihood.expected(start) <= 0) & (y > 0))
    if dark:
        raise ValueError(
            "the start is dark where light was recorded: give start= an object that shines there"
        )


def _check_count(name: str, value: int) -> None:
    if isinstance(value, bool) or not hasattr(value, "__index__") or operator.index(value) < 1:
        raise ValueError(f"{name} {value}: give a whole number, 1 or more")
