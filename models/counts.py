"""Log-probabilities of electron counts: one count, an interval of counts, a count plus read noise.

Everything is elementwise, follows the dtype of the expected count `lam`, and may be jitted, vmapped
and differentiated twice with respect to `lam`.

Two ideas carry the file. Loader's saddle-point form (C. Loader, "Fast and accurate computation of
binomial probabilities", 2000) writes a Poisson probability without the cancelling large terms of
k log(lam) - lam - log k!, whose error in float32 is of order 1 at a million electrons. Every sum
over counts has log-concave terms: it is cut where they have fallen by e^-depth from the peak, then
summed exactly, or, if too many counts are left, by Gauss-Legendre quadrature with
Euler-Maclaurin corrections at the ends.

Darkness. Below `DARK` electrons the log-probability is continued linearly in `lam` down to 0, so
that the score stays finite. At negative `lam` the value is that of darkness, less a linear penalty
with the same slope where that slope points back to positive light (any recorded electron makes it
do so).
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial.chebyshev import chebinterpolate
from numpy.polynomial.legendre import leggauss
from scipy.special import erfcx

from .asked import where_asked

DARK = 1e-6  # electrons

UNBOUNDED = 2**30  # width of an interval whose length is not known

_STEP_NODES = 64  # two edges as sharp as the read noise, up to 12 of its widths apart
_SHIFT = 8
_LOG_2PI = 1.8378770664093453
_FAR = 1e8  # electrons, an edge that is not there
_NEVER = -1e30  # finite stand-in for log 0: keeps derivatives free of nan

# B_{2j}(1/2) / (2j (2j - 1)): log n! about h = n + 1/2, Stirling's series without the log(h) / 2.
_STIRLING = (
    -1 / 24,
    7 / 2880,
    -31 / 40320,
    127 / 215040,
    -511 / 608256,
    1414477 / 738017280,
    -8191 / 1277952,
)


def _tail_series() -> list[float]:
    """Chebyshev series in 2t - 1 of log(erfcx(z) / t), t = 1 / (1 + z/2), z from 0 to infinity."""

    def smooth(x: np.ndarray) -> np.ndarray:
        t = (x + 1) / 2
        return np.log(erfcx(2 / t - 2) / t)

    return chebinterpolate(smooth, 30).tolist()


_TAIL_SERIES = _tail_series()


@jax.jit
def poisson_log_pmf(k: jax.Array, lam: jax.Array) -> jax.Array:
    """Log-probability of `k` electrons where `lam` are expected (eq:poisson).

    `k`: whole numbers >= 0, any dtype; `lam`: floats, electrons; shapes broadcast. The result has
    the dtype of `lam`, and its derivative is k/lam - 1 to full relative precision.

    Below DARK = 1e-6 electrons the value is continued linearly in `lam` (slope k/DARK - 1).
    `lam` < 0 is darkness: 0 for k = 0, and for k > 0 the same line goes on, so that the score is
    finite and points to positive light. For k = 0 the value is -max(lam, 0).

    Measured error: below 3 eps (1 + |value|), from 0 to 1e6 electrons (against 40 digits).
    """
    k, lam = _broadcast(k, lam)
    return _from_dark(_log_pmf_of, (k,), lam)


@partial(jax.jit, static_argnames="width")
def poisson_log_interval(lo: jax.Array, hi: jax.Array, lam: jax.Array, width: int) -> jax.Array:
    """Log-probability that the electron count lies in lo..hi, both ends included.

    `lo`, `hi`: whole numbers >= 0, any dtype; `hi` may be inf (saturation); lo > hi is the empty
    interval, of value -inf and derivative 0. `lam`: floats, electrons. Shapes broadcast. `width`:
    upper bound on the number of counts in the interval (static; `UNBOUNDED` if not known, and for
    the infinite). The derivative is (E[N | lo <= N <= hi] - lam) / lam. Darkness is treated as in
    `poisson_log_pmf`.

    Approximation: none up to 64 counts (32 in float32). Above, the measured relative error of the
    probability is below 2e-8 in float64, from 0 to 5e6 electrons, and 4e-7 (1 + |value|) in
    float32, most of it the rounding of the value.
    """
    lo, lam = _broadcast(lo, lam)
    hi, lam = _broadcast(hi, lam)
    lo = jnp.broadcast_to(lo, lam.shape)
    empty = lo > hi
    if width <= 1:
        value = _from_dark(_log_pmf_of, (lo,), lam)
    else:
        value = _from_dark(partial(_log_interval, width), (lo, jnp.maximum(lo, hi)), lam)
    return jnp.where(empty, -jnp.inf, value)


@partial(jax.jit, static_argnames=("read_noise", "full_well"))
def noisy_count_log_pdf(
    z: jax.Array, lam: jax.Array, read_noise: float, full_well: int
) -> jax.Array:
    """Log-density (per electron) of min(N, full_well) + read noise at `z`, N ~ Poisson(lam).

    `z`, `lam`: floats, electrons, shapes broadcast; `read_noise`: standard deviation, electrons;
    `full_well`: electrons. Darkness is treated as in `poisson_log_pmf`.

    Approximation: the sum over counts as in `poisson_log_interval`; measured relative error below
    2e-7 in float64. In float32 the storage of `z` to half an eps comes first, an error of about
    6e-8 z |z - N| / read_noise^2: 2e-3 at 30000 electrons with a read noise of 2. The mass at the
    full well is left out where no `z` of the array comes near it; that is exact to e^-16 as long as
    `lam` < 50 full wells.
    """
    z, lam = _broadcast(z, lam)
    return _from_dark(partial(_log_noisy, float(read_noise), int(full_well)), (z,), lam)


@partial(jax.jit, static_argnames=("step", "read_noise", "full_well"))
def noisy_count_log_interval(
    edges: tuple[jax.Array, jax.Array],
    step: float,
    lam: jax.Array,
    read_noise: float,
    full_well: int,
    open_ends: tuple[jax.Array, jax.Array],
) -> jax.Array:
    """Log-probability that min(N, full_well) + read noise lies in one step of an ADC.

    `edges`: the lower edge of the step, electrons, as whole part and fraction (so that float32 does
    not round it); `step`: its length, electrons; `open_ends`: booleans, the step has no lower edge,
    no upper edge. Otherwise as `noisy_count_log_pdf`; measured relative error below 2e-7 in float64
    and 3e-6 (1 + |value|) in float32. Where a step is shorter than a tenth of the read noise, its
    probability given N has a relative error of 5e-6 within six read noises, and below
    step^2 / (12 read_noise^2) < 1e-3 beyond.
    """
    whole, lam = _broadcast(edges[0], lam)
    data = (whole, edges[1].astype(lam.dtype), *open_ends)
    data = tuple(jnp.broadcast_to(d, lam.shape) for d in data)
    log_prob = partial(_log_noisy_step, float(step), float(read_noise), int(full_well))
    return _from_dark(log_prob, data, lam)


# ---- darkness, and derivatives -------------------------------------------------------------------


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _from_dark(log_prob: Callable, data: Any, lam: jax.Array) -> jax.Array:
    """log_prob(data, lam), continued below DARK.

    Elementwise, so the derivative is one number an element: it is found forwards, beside the value.
    Reverse mode would store every term of every sum.
    """
    return _value_and_slope(log_prob, data, lam)[0]


@_from_dark.defjvp
def _from_dark_jvp(log_prob, primals, tangents):  # noqa: ANN001
    value, slope = _value_and_slope(log_prob, *primals)
    return value, slope * tangents[1]


def _value_and_slope(log_prob: Callable, data: Any, lam: jax.Array) -> tuple[jax.Array, jax.Array]:
    bright = jnp.maximum(lam, DARK)
    value, slope = jax.jvp(partial(log_prob, data), (bright,), (jnp.ones_like(lam),))
    inwards = jnp.maximum(slope, 0)
    value = value + slope * (jnp.clip(lam, 0, DARK) - jnp.minimum(bright, DARK))
    value = value + inwards * jnp.minimum(lam, 0)
    return value, jnp.where(lam < 0, inwards, slope)


def _broadcast(data: jax.Array, lam: jax.Array) -> tuple[jax.Array, jax.Array]:
    data, lam = jnp.broadcast_arrays(data, lam)
    return data.astype(lam.dtype), lam


# ---- one count -----------------------------------------------------------------------------------


@jax.custom_jvp
def _log_pmf(k: jax.Array, lam: jax.Array) -> jax.Array:
    """Loader's form about h = k + 1/2, which has no singular point at k = 0; lam >= DARK."""
    difference = (k - lam) + 0.5
    value = -_deviance(k + 0.5, lam, difference) - 0.5 * (jnp.log(lam) + _LOG_2PI)
    return jnp.where(k == 0, -lam, value)


@_log_pmf.defjvp
def _log_pmf_jvp(primals, tangents):  # noqa: ANN001
    k, lam = primals
    return _log_pmf(k, lam), (k - lam) / lam * tangents[1]


def _log_pmf_of(data: tuple[jax.Array], lam: jax.Array) -> jax.Array:
    return _log_pmf(data[0], lam)


def _deviance(h: jax.Array, ref: jax.Array, difference: jax.Array) -> jax.Array:
    """h log(h/ref) - (h - ref), plus the Stirling remainder of log (h - 1/2)!.

    `difference` is h - ref, given because the caller knows it without rounding. Real h >= 0.
    """
    small = h < _SHIFT
    safe = jnp.where(small, h + _SHIFT, h)
    log_quotient = jnp.log(safe / ref)
    far = h * log_quotient - difference
    v = difference / (h + ref)
    near = difference * v + 2 * h * _odd_series(v)
    value = jnp.where(small | (jnp.abs(v) > 0.2), far, near) + _stirling(safe)
    # log n! = log (n + 8)! - log((n + 1) ... (n + 8)), with h log h cancelled by hand.
    return value + jnp.where(small, jnp.log(_rising(jnp.minimum(h, _SHIFT))) - _SHIFT, 0)


def _odd_series(v: jax.Array) -> jax.Array:
    """atanh(v) - v for |v| <= 0.2."""
    terms = 5 if v.dtype == jnp.float32 else 11
    v2 = v * v
    total = jnp.zeros_like(v)
    for j in range(terms, 0, -1):
        total = total * v2 + 1 / (2 * j + 1)
    return total * v2 * v


def _stirling(h: jax.Array) -> jax.Array:
    """log n! - (h log h - h + log(2 pi) / 2), h = n + 1/2 >= 8."""
    inverse = 1 / h
    square = inverse * inverse
    total = jnp.zeros_like(h)
    for coefficient in reversed(_STIRLING[:3] if h.dtype == jnp.float32 else _STIRLING):
        total = total * square + coefficient
    return total * inverse


def _rising(h: jax.Array) -> jax.Array:
    """(h + 8)^8 / ((n + 1) ... (n + 8)), h = n + 1/2."""
    product = jnp.ones_like(h)
    for i in range(_SHIFT):
        product = product * (h + (i + 0.5))
    return (h + _SHIFT) ** _SHIFT / product


def _log_quotient(a: jax.Array, b: jax.Array) -> jax.Array:
    """log(a/b), to full relative precision where a is close to b."""
    x = (a - b) / b
    close = jnp.abs(x) < 0.5
    return jnp.where(close, jnp.log1p(jnp.where(close, x, 0)), jnp.log(a / b))


class _Terms(NamedTuple):
    """log of the terms of a sum, relative to the term at m = 0, and its derivative in m."""

    log: Callable[[jax.Array], jax.Array]
    slope: Callable[[jax.Array], jax.Array]


def _pmf_terms(peak: jax.Array, lam: jax.Array) -> _Terms:
    """log pmf(peak + m) - log pmf(peak), precise however far from `lam` the peak lies."""
    h = peak + 0.5
    log_quotient = _log_quotient(lam, h)
    remainder = _deviance(h, h, jnp.zeros_like(h))

    def log(m: jax.Array) -> jax.Array:
        return m * log_quotient - (_deviance(h + m, h, m) - remainder)

    def slope(m: jax.Array) -> jax.Array:
        # digamma(n + 1) about n + 1/2; rough at n = 0, where it only steers the window.
        inverse = 1 / jnp.maximum(h + m, 0.5)
        return jnp.log(lam * inverse) - inverse**2 * (1 / 24 - inverse**2 * (7 / 960))

    return _Terms(log, slope)


# ---- sums over counts ----------------------------------------------------------------------------


def _depth(dtype: np.dtype) -> float:
    """Terms below e^-depth of the largest are left out."""
    return 16.0 if dtype == jnp.float32 else 32.0


def _nodes(dtype: np.dtype) -> int:
    """Quadrature nodes over a smooth peak of this depth, and the most counts summed exactly."""
    return 32 if dtype == jnp.float32 else 64


def _log_interval(width: int, data: tuple[jax.Array, jax.Array], lam: jax.Array) -> jax.Array:
    lo, hi = data
    return _log_span(lo[..., None], hi[..., None], lam[..., None], width)[..., 0]


def _log_span(lo: jax.Array, hi: jax.Array, lam: jax.Array, width: int) -> jax.Array:
    """log P(lo <= N <= hi) for arrays of shape (*pixels, 1)."""
    peak = jnp.clip(jnp.floor(jax.lax.stop_gradient(lam)), lo, hi)
    terms, nodes = _pmf_terms(peak, lam), _nodes(lam.dtype)
    total = _log_sum(terms, lo - peak, hi - peak, _curvature(peak), width, nodes)
    return jnp.minimum(_log_pmf(peak, lam) + total, 0)


def _log_tail(start: int, lam: jax.Array) -> jax.Array:
    """log P(N >= start)."""
    ends = (jnp.full_like(lam, start), jnp.full_like(lam, jnp.inf))
    return _log_interval(UNBOUNDED, ends, lam)


def _curvature(peak: jax.Array) -> jax.Array:
    """Least curvature of -log pmf over the terms that count: Bernstein's, n^2 / 2(peak + n/3)."""
    depth = _depth(peak.dtype)
    reach = jnp.sqrt(2 * depth * peak) + 2 * depth / 3
    return 1 / (peak + reach / 3)


def _log_sum(
    terms: _Terms, lo: jax.Array, hi: jax.Array, curvature: jax.Array, width: int, nodes: int
) -> jax.Array:
    """log of the sum over whole m in lo..hi of exp(terms.log(m)), terms log-concave.

    Arrays have shape (*pixels, 1). m = 0 is close to the largest term; -terms.log has at least this
    curvature; `width` bounds the number of terms that count; above `nodes` of them, quadrature
    takes over. An empty sum gives _NEVER.
    """
    first, last = _window(terms, lo, hi, curvature)
    count = last - first + 1
    empty = count < 1
    index = _row(np.arange(min(width, nodes)), count)
    m = jnp.minimum(first + index, last)
    weight = (index < count).astype(count.dtype)
    if width > nodes:
        many = count > nodes
        node, node_weight = (_row(a, count) for a in leggauss(nodes))
        m = jnp.where(many, (first + last) / 2 + count / 2 * node, m)
        weight = jnp.where(many, count / 2 * node_weight, weight)
        ends = jnp.where(many, _euler_maclaurin(terms, first, last), 0)
    else:
        ends = jnp.zeros_like(count)
    m = jnp.where(empty, 0, m)
    total = jnp.sum(weight * jnp.exp(terms.log(m)), axis=-1, keepdims=True) + ends
    return jnp.where(empty, _NEVER, jnp.log(jnp.where(empty, 1, total)))


def _window(
    terms: _Terms, lo: jax.Array, hi: jax.Array, curvature: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """First and last m in lo..hi whose terms can exceed e^-depth of the term at 0."""
    depth = _depth(curvature.dtype)
    slope = jax.lax.stop_gradient(terms.slope(jnp.zeros_like(curvature)))
    root = jnp.abs(slope) + jnp.sqrt(slope**2 + 2 * depth * curvature)
    downhill, uphill = jnp.ceil(2 * depth / root), jnp.ceil(root / curvature)
    first = jnp.maximum(lo, -jnp.where(slope > 0, downhill, uphill))
    last = jnp.minimum(hi, jnp.where(slope < 0, downhill, uphill))
    return first, last


def _euler_maclaurin(terms: _Terms, first: jax.Array, last: jax.Array) -> jax.Array:
    """What the integral from first - 1/2 to last + 1/2 lacks of the sum of f = exp(terms.log).

    At each end -f'/24 + 7 f^(3)/5760 - 31 f^(5)/967680, from the slope of log f and its change.
    """
    ends = jnp.concatenate([first - 0.5, last + 0.5], axis=-1)
    before, s, after = jnp.split(
        terms.slope(jnp.concatenate([ends - 0.5, ends, ends + 0.5], axis=-1)), 3, axis=-1
    )
    s2, c = s * s, after - before
    series = 1 / 24 - 7 / 5760 * (s2 + 3 * c) + 31 / 967680 * s2 * (s2 + 10 * c)
    side = _row(np.array([1.0, -1.0]), ends)
    return jnp.sum(side * s * series * jnp.exp(terms.log(ends)), axis=-1, keepdims=True)


def _row(values: np.ndarray, like: jax.Array) -> jax.Array:
    """Node values along the last axis, against arrays (*pixels, 1)."""
    return jnp.asarray(values, like.dtype).reshape(*(1,) * (like.ndim - 1), -1)


# ---- counts with read noise ----------------------------------------------------------------------


def _log_noisy(noise: float, full_well: int, data: tuple[jax.Array], lam: jax.Array) -> jax.Array:
    z = data[0]
    body = _log_noisy_body(noise, full_well, z[..., None], lam[..., None])[..., 0]
    at_full_well = _log_normal((full_well - z) / noise) - math.log(noise)
    near = z > full_well - _saturation_reach(noise, full_well)
    return _add_saturated(body, at_full_well, near, full_well, lam)


def _log_noisy_body(noise: float, full_well: int, z: jax.Array, lam: jax.Array) -> jax.Array:
    """log of the sum over N < full_well of pmf(N) phi((z - N) / noise) / noise."""
    whole = jnp.round(z)
    peak = whole + jnp.round(z - whole + _pull(z, lam, noise))
    peak = jnp.clip(peak, 0, full_well - 1)
    pmf = _pmf_terms(peak, lam)
    offset, variance = z - peak, noise**2
    terms = _Terms(
        lambda m: pmf.log(m) + m * (2 * offset - m) / (2 * variance),
        lambda m: pmf.slope(m) + (offset - m) / variance,
    )
    curvature = _curvature(peak) + 1 / variance
    width = int(min(full_well, 2.5 * _reach(noise, lam.dtype) + 7))
    nodes = _nodes(lam.dtype)
    total = _log_sum(terms, -peak, full_well - 1 - peak, curvature, width, nodes)
    return _log_pmf(peak, lam) + _log_normal(offset / noise) - math.log(noise) + total


def _log_noisy_step(
    step: float, noise: float, full_well: int, data: tuple[jax.Array, ...], lam: jax.Array
) -> jax.Array:
    data = tuple(d[..., None] for d in data)
    whole, fraction, no_lower, no_upper = data

    def response(n: jax.Array) -> _Terms:
        """m -> log P(recorded in this step | n + m electrons)."""
        offset, length = (whole - n) + fraction, step / noise

        def log(m: jax.Array) -> jax.Array:
            return _log_step((offset - m) / noise, length, no_lower, no_upper)

        def slope(m: jax.Array) -> jax.Array:
            below, above = _ends((offset - m) / noise, length, no_lower, no_upper)
            value = log(m)
            # Bounded: a hundred thousand read noises away both logarithms are all rounding.
            rise, fall = (jnp.exp(jnp.minimum(_log_normal(u) - value, 40)) for u in (below, above))
            return (rise - fall) / noise

        return _Terms(log, slope)

    body = _log_step_body(step, noise, full_well, data, lam[..., None], response)
    full = jnp.full_like(body, full_well)
    at_full_well = response(full).log(jnp.zeros_like(full))
    near = no_upper | (whole + step > full_well - _saturation_reach(noise, full_well))
    return _add_saturated(body[..., 0], at_full_well[..., 0], near[..., 0], full_well, lam)


def _log_step_body(
    step: float,
    noise: float,
    full_well: int,
    data: tuple[jax.Array, ...],
    lam: jax.Array,
    response: Callable[[jax.Array], _Terms],
) -> jax.Array:
    """The sum over N < full_well; steps much longer than the noise are summed in three pieces."""
    whole, fraction, no_lower, no_upper = data
    # Positions count from `whole`, where float32 resolves a fraction of the read noise.
    lower = jnp.where(no_lower, -_FAR, fraction)
    upper = jnp.where(no_upper, _FAR, fraction + step)
    nearest = jnp.clip(jax.lax.stop_gradient(lam) - whole, lower, upper)
    mode = jnp.round(nearest + _pull(whole + nearest, lam, noise))
    reach = _reach(noise, lam.dtype)

    def piece(start: jax.Array, stop: jax.Array, width: float) -> jax.Array:
        start, stop = jnp.maximum(whole + start, 0), jnp.minimum(whole + stop, full_well - 1)
        peak = jnp.clip(whole + mode, jnp.minimum(start, full_well - 1), jnp.maximum(stop, 0))
        start = jnp.maximum(start, jnp.floor(peak - width))
        stop = jnp.minimum(stop, jnp.ceil(peak + width))
        pmf, recorded = _pmf_terms(peak, lam), response(peak)
        at_peak = recorded.log(jnp.zeros_like(peak))
        terms = _Terms(
            lambda m: pmf.log(m) + (recorded.log(m) - at_peak),
            lambda m: pmf.slope(m) + recorded.slope(m),
        )
        most = int(min(full_well, width + 1.5 * reach + 7))
        total = _log_sum(terms, start - peak, stop - peak, _curvature(peak), most, _STEP_NODES)
        return jnp.where(stop < start, _NEVER, _log_pmf(peak, lam) + at_peak + total)

    bottom = jnp.floor(jnp.minimum(mode, lower) - 1.3 * reach)
    top = jnp.ceil(jnp.maximum(mode, upper) + 1.3 * reach)
    if step <= 2 * reach:
        return piece(bottom, top, step + 2 * reach)
    # Between these cuts the response is 1 to e^-depth.
    cut_lower, cut_upper = jnp.floor(lower + reach), jnp.floor(upper - reach)
    start = jnp.maximum(whole + cut_lower + 1, 0)
    stop = jnp.minimum(whole + cut_upper, full_well - 1)
    middle = _log_span(start, jnp.maximum(start, stop), lam, UNBOUNDED)
    middle = jnp.where(stop < start, _NEVER, middle)
    edges = piece(jnp.stack([bottom, cut_upper + 1]), jnp.stack([cut_lower, top]), 3 * reach)
    return jnp.logaddexp(jnp.logaddexp(edges[0], middle), edges[1])


def _ends(
    u: jax.Array, length: float, no_lower: jax.Array, no_upper: jax.Array
) -> tuple[jax.Array, jax.Array]:
    return jnp.where(no_lower, -1e6, u), jnp.where(no_upper, 1e6, u + length)


def _log_step(u: jax.Array, length: float, no_lower: jax.Array, no_upper: jax.Array) -> jax.Array:
    """log P(u < standard normal < u + length), either end open where told."""
    below, above = _ends(u, length, no_lower, no_upper)
    beyond_below, beyond_above = _log_normal_tail(jnp.abs(below)), _log_normal_tail(jnp.abs(above))
    near = jnp.maximum(beyond_below, beyond_above)
    gap = jnp.abs(beyond_below - beyond_above)
    one_side = near + jnp.log(-jnp.expm1(-jnp.maximum(gap, jnp.finfo(gap.dtype).tiny)))
    both_sides = jnp.log1p(-jnp.minimum(jnp.exp(beyond_below) + jnp.exp(beyond_above), 0.999))
    value = jnp.where(below * above < 0, both_sides, one_side)
    if length >= 0.1:
        return value
    # The difference of two normal probabilities would cancel: expand about the middle.
    middle = u + length / 2
    inner = _log_normal(middle) + math.log(length) - length**2 / 24
    inner = inner + _log_sinhc(jnp.abs(middle) * (length / 2))
    return jnp.where(no_lower | no_upper, value, inner)


def _log_normal_tail(u: jax.Array) -> jax.Array:
    """log P(standard normal > u), u >= 0; absolute error some eps (1 + u^2)."""
    t = 1 / (1 + u * math.sqrt(1 / 8))
    coefficients = _TAIL_SERIES[:13] if u.dtype == jnp.float32 else _TAIL_SERIES
    x, b, previous = 2 * t - 1, jnp.zeros_like(u), jnp.zeros_like(u)
    for c in coefficients[:0:-1]:
        b, previous = c + 2 * x * b - previous, b
    return coefficients[0] + x * b - previous + jnp.log(t / 2) - u * u / 2


def _log_sinhc(a: jax.Array) -> jax.Array:
    """log(sinh(a) / a), a >= 0."""
    near = a < 0.3
    far = jnp.where(near, 1, a)
    square = a * a
    series = square * (1 / 6 - square * (1 / 180 - square * (1 / 2835 - square / 37800)))
    return jnp.where(near, series, far + jnp.log(-jnp.expm1(-2 * far) / (2 * far)))


def _log_normal(u: jax.Array) -> jax.Array:
    return -0.5 * (u * u + _LOG_2PI)


def _reach(noise: float, dtype: np.dtype) -> float:
    """Electrons beyond which the read noise is below e^-depth of its peak."""
    return noise * math.sqrt(2 * _depth(dtype))


def _pull(z: jax.Array, lam: jax.Array, noise: float) -> jax.Array:
    """The count N that makes Poisson(N | lam) phi((z - N) / noise) largest, less z; approximate.

    N + noise^2 log(N / lam) = z, that is N = noise^2 omega(x): Newton steps for Wright's omega.
    """
    z, lam = jax.lax.stop_gradient((z, lam))
    variance = noise**2
    x = z / variance + jnp.log(lam / variance)
    large = jnp.maximum(x, 1)
    omega = jnp.where(x > 1, large - jnp.log(large), jax.nn.sigmoid(x))
    tiny = jnp.finfo(lam.dtype).tiny
    for _ in range(4):
        omega = jnp.maximum(omega, tiny)
        omega = omega * (1 + (x - jnp.log(omega))) / (1 + omega)
    return -variance * (jnp.log(jnp.maximum(omega, tiny)) + jnp.log(variance / lam))


def _saturation_reach(noise: float, full_well: int) -> float:
    """Recorded values lower than this below the full well cannot come from a saturated pixel."""
    variance = noise**2
    if variance > full_well / 2:
        return math.inf
    return 16 * variance / (1 - variance / full_well) + 16 * noise


def _add_saturated(
    body: jax.Array, at_full_well: jax.Array, near: jax.Array, full_well: int, lam: jax.Array
) -> jax.Array:
    """Add the mass P(N >= full_well) that sits at the full well, if any pixel is near it."""
    tail = where_asked(partial(_log_tail, full_well), _NEVER, near, lam)
    return jnp.logaddexp(body, tail + at_full_well)
