"""Log-probabilities of counts against exact sums, in both precisions."""

from decimal import Decimal, localcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.special import gammaln, log_ndtr, logsumexp

from posterior.models.counts import (
    DARK,
    UNBOUNDED,
    noisy_count_log_interval,
    noisy_count_log_pdf,
    poisson_log_interval,
    poisson_log_pmf,
)

LAMS = np.array([1e-6, 1e-3, 0.1, 0.5, 1, 3, 7.9, 15, 16, 30, 100, 1234.5, 2e4, 1e6])
COUNTS = np.array([0, 1, 2, 5, 7, 8, 9, 15, 16, 17, 30, 100, 1000, 20000, 999000, 10**6, 1003000])


def exact_log_pmf(k, lam):
    """The textbook formula in extended precision: absolute error 1e-11 at a million electrons."""
    k, lam = np.asarray(k, np.longdouble), np.asarray(lam, np.longdouble)
    n = k + 16
    stirling = 1 / (12 * n) - 1 / (360 * n**3) + 1 / (1260 * n**5) - 1 / (1680 * n**7)
    log_factorial = (n + 0.5) * np.log(n) - n + 0.5 * np.log(2 * np.pi * np.longdouble(1))
    shift = sum(np.log(k + i) for i in range(1, 17))
    return (k * np.log(lam) - lam - (log_factorial + stirling - shift)).astype(float)


def decimal_log_pmf(k, lam):
    """The same for one pixel in 40 digits."""
    with localcontext(prec=40):
        k, lam, n = Decimal(int(k)), Decimal(float(lam)), Decimal(int(k) + 100)
        series = [(12, 1), (-360, 3), (1260, 5), (-1680, 7), (1188, 9)]
        log_two_pi = Decimal("1.8378770664093454835606594728112352797")
        log_factorial = (n + Decimal("0.5")) * n.ln() - n + log_two_pi / 2
        log_factorial += sum(1 / (d * n**power) for d, power in series)
        shift = sum((k + i).ln() for i in range(1, 101))
        return float(k * lam.ln() - lam - (log_factorial - shift))


def exact_interval(lo, hi, lam):
    """log P and d log P / d lam, from every count of the interval that matters."""
    peak = min(max(np.floor(lam), lo), hi)
    reach = np.floor(12 * np.sqrt(peak + 1)) + 80
    n = np.arange(max(lo, peak - reach), min(hi, peak + reach) + 1)
    terms = exact_log_pmf(n, lam)
    value = logsumexp(terms)
    return value, np.sum(np.exp(terms - value) * (n - lam)) / lam


def test_reference_formula_is_scipys():
    k = np.arange(0, 60)
    log_pmf = k * np.log(7.0) - 7.0 - gammaln(k + 1)
    np.testing.assert_allclose(exact_log_pmf(k, 7.0), log_pmf, rtol=1e-13, atol=1e-13)


def test_log_pmf_is_exact_to_eps(precision):
    eps = float(np.finfo(precision).eps)
    k, lam = np.meshgrid(COUNTS, LAMS.astype(precision))
    value = np.asarray(poisson_log_pmf(k, jnp.asarray(lam)))
    expected = np.vectorize(decimal_log_pmf)(k, lam)
    assert value.dtype == precision
    np.testing.assert_array_less(np.abs(value - expected), 4 * eps * (1 + np.abs(expected)))


def test_log_pmf_agrees_with_scipy(x64):
    k, lam = np.meshgrid(COUNTS, LAMS)
    expected = stats.poisson.logpmf(k, lam)  # itself off by 1e-9 at a million electrons
    np.testing.assert_allclose(poisson_log_pmf(k, lam), expected, rtol=1e-9, atol=2e-9)


def test_derivative_is_exact(precision):
    eps = float(np.finfo(precision).eps)
    k, lam = (jnp.asarray(a.ravel(), precision) for a in np.meshgrid(COUNTS, LAMS[1:]))
    slope = jax.vmap(jax.grad(poisson_log_pmf, 1))(k, lam)
    curvature = jax.vmap(jax.grad(jax.grad(poisson_log_pmf, 1), 1))(k, lam)
    k, lam = np.asarray(k, float), np.asarray(lam, float)
    np.testing.assert_allclose(slope, (k - lam) / lam, rtol=3 * eps)
    assert np.all(np.abs(curvature + k / lam**2) < 8 * eps * (k / lam**2 + 1 / lam))


def test_darkness(precision):
    lam = jnp.asarray([-5.0, -1e-3, 0.0, 1e-9, 1e-7], precision)
    zero = poisson_log_pmf(0, lam)
    np.testing.assert_allclose(zero, -np.maximum(np.asarray(lam), 0), atol=1e-13)
    slope = jax.vmap(jax.grad(poisson_log_pmf, 1), (None, 0))
    np.testing.assert_allclose(slope(0.0, lam), [0, 0, -1, -1, -1])
    np.testing.assert_allclose(slope(3.0, lam), 3 / DARK, rtol=1e-5)
    line = poisson_log_pmf(3, lam) - poisson_log_pmf(3, jnp.zeros_like(lam))
    np.testing.assert_allclose(line, np.asarray(lam) * (3 / DARK - 1), rtol=1e-5, atol=1e-4)


INTERVALS = [
    (lo, lo + width - 1, lam)
    for lam in (1e-6, 0.3, 2.0, 20.0, 35.0, 60.0, 200.0, 1500.0, 3e4, 1e6, 5e6)
    for lo in (0, 1, 10, 50, 200, 1400, 29000, 998000)
    for width in (1, 2, 20, 33, 64, 65, 80, 150, 1000, 3922, np.inf)
]


def test_intervals_match_exact_sums(precision):
    eps = float(np.finfo(precision).eps)
    cases = np.array(INTERVALS).astype(precision)
    expected, slope = np.array([exact_interval(*map(float, case)) for case in cases]).T
    lo, hi, lam = jnp.asarray(cases.T)
    value, derivative = jax.jvp(
        lambda lam: poisson_log_interval(lo, hi, lam, UNBOUNDED), (lam,), (jnp.ones_like(lam),)
    )
    tolerance = 5e-8 + 10 * eps + 8 * eps * np.abs(expected)
    assert np.all(np.abs(value - expected) < tolerance)
    # A score errs against 1/sqrt(lam), its own standard deviation.
    scale = np.abs(slope) + np.minimum(1, 1 / np.sqrt(cases[:, 2]))
    assert np.all(np.abs(derivative - slope) < (5e-8 + 10 * eps) * scale)


@pytest.mark.parametrize("width", [2, 20, 32, 64])
def test_short_intervals_are_summed_exactly(x64, width):
    lam = jnp.asarray([1e-3, 5.0, 40.0, 2e3])
    for lo in (0, 3, 1900):
        value = poisson_log_interval(lo, lo + width - 1, lam, width)
        expected = [exact_interval(lo, lo + width - 1, float(x))[0] for x in lam]
        np.testing.assert_allclose(value, expected, rtol=1e-12, atol=1e-13)


def test_saturated_tail_is_scipys_survival_function(x64):
    lam = jnp.asarray([0.5, 60.0, 90.0, 100.0, 130.0, 400.0])
    value = poisson_log_interval(100, jnp.inf, lam, UNBOUNDED)
    np.testing.assert_allclose(value, stats.poisson.logsf(99, lam), rtol=1e-9, atol=3e-8)


def test_intervals_partition_all_counts(precision):
    starts = np.array([0, 3, 40, 41, 120, 260, 1000, 40000.0])
    lo, hi = starts, np.append(starts[1:] - 1, np.inf)
    lam = jnp.asarray([0.1, 5, 44, 140, 900, 4e4, 1e6], precision)[:, None]
    total = jnp.sum(jnp.exp(poisson_log_interval(lo, hi, lam, UNBOUNDED)), axis=1)
    np.testing.assert_allclose(total, 1, atol=1e-5 if precision == "float32" else 1e-7)


@pytest.mark.parametrize("width", [1, 5, UNBOUNDED])
def test_empty_interval(precision, width):
    value, slope = jax.value_and_grad(poisson_log_interval, 2)(
        5.0, 4.0, jnp.asarray(3, precision), width
    )
    assert value == -jnp.inf
    assert slope == 0


def test_interval_derivative_twice(x64):
    lam = 1400.0
    second = jax.grad(jax.grad(poisson_log_interval, 2), 2)(1300.0, 1500.0, lam, UNBOUNDED)
    step = 0.1
    slopes = [exact_interval(1300, 1500, lam + d)[1] for d in (-step, step)]
    np.testing.assert_allclose(second, (slopes[1] - slopes[0]) / (2 * step), rtol=1e-4)


def test_follows_the_dtype_of_lam_inside_x64(x64):
    lam = jnp.asarray([0.5, 900.0], jnp.float32)
    assert poisson_log_pmf(np.arange(2), lam).dtype == jnp.float32
    assert poisson_log_interval(np.zeros(2), np.full(2, 80.0), lam, UNBOUNDED).dtype == jnp.float32


# ---- read noise ----------------------------------------------------------------------------------


def all_counts(full_well, lam):
    """Every recordable count and the log of its probability, the full well's included."""
    counts = np.arange(2 * full_well + 500, dtype=np.longdouble)
    log_factorial = np.cumsum(np.log(np.maximum(counts, 1)))
    log_pmf = (counts * np.log(np.longdouble(lam)) - lam - log_factorial).astype(float)
    return counts[: full_well + 1].astype(float), np.append(
        log_pmf[:full_well], logsumexp(log_pmf[full_well:])
    )


def log_step(a, b):
    """log(Phi(b) - Phi(a)) in float64."""
    a, b = np.where(a + b > 0, -b, a), np.where(a + b > 0, -a, b)
    log_b = log_ndtr(b)
    return log_b + np.log(-np.expm1(np.minimum(log_ndtr(a) - log_b, -1e-300)))


def assert_close(value, expected, tolerance):
    excess = np.abs(np.asarray(value, float) - expected) / (tolerance * (1 + np.abs(expected)))
    assert excess.max() < 1, (excess.max(), excess.argmax())


@pytest.mark.parametrize(("full_well", "noise"), [(10, 0.3), (20000, 2.0)])
def test_noisy_density_matches_exact_sum(x64, full_well, noise):
    relative = np.array([0.0, 1e-3, 0.1, 0.5, 0.97, 1.05])
    z, lam = np.meshgrid(relative * full_well + 0.3 * noise, relative * full_well + 0.1)
    z, lam = z.ravel(), lam.ravel()
    expected = []
    for zi, li in zip(z, lam):
        n, log_pmf = all_counts(full_well, li)
        density = -0.5 * ((zi - n) / noise) ** 2 - np.log(noise * np.sqrt(2 * np.pi))
        expected.append(logsumexp(log_pmf + density))
    value = noisy_count_log_pdf(z, lam, noise, full_well)
    assert_close(value, np.array(expected), 2e-7)
    with jax.enable_x64(False):
        single = noisy_count_log_pdf(z.astype("f4"), lam.astype("f4"), noise, full_well)
    # float32 stores z to half an eps: the density follows by its slope in z.
    slope = np.abs(z - np.minimum(lam, full_well)) / np.maximum(noise**2, 1) + 1
    rounding = 2e-7 * full_well * slope
    assert np.all(np.abs(single - value) < 1e-5 * (1 + np.abs(value)) + rounding)


NOISY_STEPS = [(100, 1.0, 1000), (5000, 2.0, 40)]  # one piece, three pieces


@pytest.mark.parametrize(("full_well", "noise", "steps"), NOISY_STEPS)
def test_noisy_interval_matches_exact_sum(x64, full_well, noise, steps):
    step = full_well / steps
    codes, light = np.array([0, 1, steps // 2, steps]), np.array([1e-3, 0.1, 0.5, 0.97, 1.05])
    code, lam = (a.ravel() for a in np.meshgrid(codes, light * full_well))
    expected = []
    for c, li in zip(code, lam):
        n, log_pmf = all_counts(full_well, li)
        a = -np.inf if c == 0 else ((c - 0.5) * step - n) / noise
        b = np.inf if c == steps else ((c + 0.5) * step - n) / noise
        expected.append(logsumexp(log_pmf + log_step(a + 0 * n, b + 0 * n)))
    edge = (code - 0.5) * step
    edges = jnp.floor(edge), jnp.asarray(edge - np.floor(edge))
    open_ends = code == 0, code == steps
    dtype, tolerance = ("float64", 2e-7) if noise == 1 else ("float32", 1e-5)
    lam = jnp.asarray(lam, dtype)
    value = noisy_count_log_interval(edges, step, lam, noise, full_well, open_ends)
    assert_close(value, np.array(expected), tolerance)
