"""Cameras: from the expected signal to the recorded value, and the exact probability of it.

Everything is normalised: electrons / full well, so that 1 is saturation (unless the well of
`Poisson` holds more) and the photon noise of a pixel of expected signal x has variance sigma0^2 x,
sigma0 = 1/sqrt(full well) (eq:fwc). A camera does two things that must agree: `sample` simulates a
recording, `log_prob` is the exact log-probability of what was recorded: true Poisson counts
(eq:poisson), saturation, read noise, and the step of the ADC, never the Gaussian approximation.

What it computes follows the dtype of the expected signal.
"""

import abc
import math
import operator
from functools import lru_cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .asked import where_asked
from .counts import (
    UNBOUNDED,
    noisy_count_log_interval,
    noisy_count_log_pdf,
    poisson_log_interval,
    poisson_log_pmf,
)
from .realview import is_complex, normal_like, real_score

_LARGEST_WELL = 2**23 - 1  # above, float32 cannot tell k from k + 1/2 electrons
_LARGEST_DRAW = 2**15  # electrons
_EPS32 = float(np.finfo(np.float32).eps)  # recordings are often stored in float32


class Camera(eqx.Module):
    """What every camera offers; all arrays elementwise over pixels, `y` and `expected` broadcast.

    Attributes: `sigma0`, photon noise at full scale (0.0 if there is none); `read_variance`,
    variance of the signal-independent noise, normalised units; `counting`, whether `expected` must
    be a light intensity: real, nonnegative (negative counts as darkness).
    """

    sigma0: eqx.AbstractVar[float]
    read_variance: eqx.AbstractVar[float]
    counting: eqx.AbstractVar[bool]

    @property
    def saturation(self) -> float:
        """Signal above which a recording tells only that it was above it; inf if there is none."""
        return math.inf

    @property
    def adc_variance(self) -> float:
        """Variance of an ADC's rounding where its steps are finer than the noise; 0.0 if none."""
        return 0.0

    @abc.abstractmethod
    def sample(self, key: jax.Array, expected: jax.Array) -> jax.Array:
        """One recording of the expected signal: its shape, its dtype, normalised units.

        Raises ValueError for a complex signal before a counting camera.
        """

    @abc.abstractmethod
    def log_prob(self, y: jax.Array, expected: jax.Array) -> jax.Array:
        """Log-probability (log-density, if `y` is continuous) of each pixel; nats, real dtype.

        `y` is taken as it is: `check` it first. Differentiable twice with respect to `expected`.
        Raises ValueError for a complex `expected` before a counting camera.
        """

    @abc.abstractmethod
    def check(self, y: np.ndarray) -> None:
        """Raise ValueError, naming value and remedy, if `y` cannot be a recording of this camera.

        For concrete data, not under jit.
        """

    @eqx.filter_jit
    def score(self, y: jax.Array, expected: jax.Array) -> jax.Array:
        """Elementwise d log_prob / d expected; for a complex signal d/dRe + j d/dIm."""
        expected = _floating(expected)
        expected = jnp.broadcast_to(expected, jnp.broadcast_shapes(jnp.shape(y), expected.shape))
        return real_score(jax.grad(lambda e: jnp.sum(self.log_prob(y, e)))(expected))


class Gaussian(Camera):
    """Signal-independent Gaussian noise, no full well: y = expected + sigma n.

    `sigma`: standard deviation, normalised units; in Re and in Im each for a complex signal.
    Raises ValueError unless sigma > 0.
    """

    sigma: float = eqx.field(static=True)

    def __init__(self, sigma: float):
        self.sigma = _positive("sigma", sigma, "a noise standard deviation in normalised units")

    @property
    def sigma0(self) -> float:
        return 0.0

    @property
    def read_variance(self) -> float:
        return self.sigma**2

    @property
    def counting(self) -> bool:
        return False

    def sample(self, key: jax.Array, expected: jax.Array) -> jax.Array:
        """One recording: expected + sigma n."""
        expected = _floating(expected)
        return expected + self.sigma * normal_like(key, expected)

    def log_prob(self, y: jax.Array, expected: jax.Array) -> jax.Array:
        """Log-density, over Re and Im together if the signal is complex."""
        expected = _floating(expected)
        residual = (_follow(y, expected) - expected) / self.sigma
        parts = 2 if jnp.iscomplexobj(residual) else 1
        square = residual.real**2 + residual.imag**2 if parts == 2 else residual**2
        return -0.5 * square - parts * math.log(self.sigma * math.sqrt(2 * math.pi))

    def check(self, y: np.ndarray) -> None:
        """Refuse nan, inf and integer data."""
        _check_floats(np.asarray(y), "divide by the full scale first")


class _CountingCamera(Camera):
    """Electrons in a full well, read by an ADC or not."""

    full_well: eqx.AbstractVar[int]
    holds: eqx.AbstractVar[int]
    bits: eqx.AbstractVar[int | None]

    @property
    def sigma0(self) -> float:
        return 1 / math.sqrt(self.full_well)

    @property
    def counting(self) -> bool:
        return True

    @property
    def _top(self) -> int:
        """The ADC's last code."""
        return 2**self.bits - 1

    @property
    def adc_variance(self) -> float:
        return 0.0 if self.bits is None else 1 / (12 * self._codes_of_one**2)

    @property
    def highest(self) -> float:
        """The largest recording, but for read noise: 1, or more where the well holds more."""
        return self.holds / self.full_well

    @property
    def _codes_of_one(self) -> float:
        """Steps of the ADC up to a signal of 1."""
        return self._top / self.highest

    def _code(self, y: jax.Array) -> jax.Array:
        code = jnp.round(y * self._codes_of_one)
        return jnp.clip(code, 0, self._top).astype(jnp.int32)

    def from_codes(self, codes: np.ndarray) -> jax.Array:
        """Normalised recording from ADC codes: integers 0 .. 2^bits - 1 of any integer dtype.

        Raises ValueError for a camera without bits, data that are not integers, and codes out of
        range (a container of 16 bits may hold fewer, in its low bits).
        """
        codes = np.asarray(codes)
        if self.bits is None:
            raise ValueError("this camera has no ADC: give bits= to read codes")
        if not np.issubdtype(codes.dtype, np.integer):
            raise ValueError(
                f"codes have dtype {codes.dtype}: give the ADC's integers, or use the data as they "
                "are if already normalised"
            )
        if codes.size and (codes.min() < 0 or codes.max() > self._top):
            worst = codes.min() if codes.min() < 0 else codes.max()
            raise ValueError(
                f"code {worst} is outside 0..{self._top} of a {self.bits}-bit ADC: set bits to the "
                "ADC's, or shift codes right that are stored in the high bits"
            )
        return jnp.asarray(codes / self._codes_of_one, jnp.result_type(float))

    @eqx.filter_jit
    def _electrons(self, key: jax.Array, expected: jax.Array) -> jax.Array:
        """min(N, holds), N ~ Poisson; int32.

        Drawn in parts (sums of Poisson counts are Poisson): the acceptance test of
        jax.random.poisson cancels in float32, leaving the variance 2 % off at 1e6 electrons.
        Brighter than `bright` the pixel saturates anyway, but for a chance below 1e-80.
        """
        bright = self.holds + 20 * math.sqrt(self.holds) + 200
        parts = math.ceil(self.holds / _LARGEST_DRAW)
        lam = jnp.clip(self.full_well * expected, 0, bright) / parts

        def add(i: jax.Array, total: jax.Array) -> jax.Array:
            return total + jax.random.poisson(jax.random.fold_in(key, i), lam, dtype=jnp.int32)

        total = jax.lax.fori_loop(0, parts, add, jnp.zeros(lam.shape, jnp.int32))
        return jnp.minimum(total, self.holds)

    def _check_range(self, y: np.ndarray, lowest: float, highest: float) -> None:
        if is_complex(y.dtype):
            raise ValueError(
                f"complex data ({y.dtype}): a camera records intensities, give |y|^2, or use "
                "Gaussian for a complex signal"
            )
        remedy = (
            "set bits, and divide with camera.from_codes(...)"
            if self.bits is None
            else "divide with camera.from_codes(...)"
        )
        _check_floats(y, remedy)
        if not y.size:
            return
        if y.min() < lowest:
            raise ValueError(
                f"y = {y.min():.6g} is {'negative' if lowest == 0 else 'far below zero'} "
                f"({y.min() * self.full_well:.6g} electrons): subtract a smaller dark level, or "
                "use a camera with (more) read noise"
            )
        if y.max() > highest:
            raise ValueError(
                f"y = {y.max():.6g} is above the full well "
                f"({self.highest:.6g} = {self.holds} electrons): "
                "divide the electrons by the full well, or raise full_well"
            )

    def _check_grid(self, y: np.ndarray) -> None:
        codes = y.astype(np.float64) * self._codes_of_one
        off = np.abs(codes - np.round(codes)) > 4 * _EPS32 * self._top
        if off.any():
            raise ValueError(
                f"y = {y[off].flat[0]:.6g} is not on the grid k/{self._codes_of_one:.6g} of a "
                f"{self.bits}-bit ADC: set bits to the ADC's, or to None for data that were not "
                "quantised"
            )


class Poisson(_CountingCamera):
    """Photon noise alone (eq:poisson), clipped at the full well and, with `bits`, quantised.

    Simulates N ~ Poisson(full_well x expected), clips at `full_well`, and records N / full_well; or
    with bits the code floor(N M / full_well + 1/2), M = 2^bits - 1, as code / M.

    `full_well`: electrons, a whole number 1 .. 2^23 - 1 (counts are whole, and exact in float32);
    `bits`: None, or 1 .. 16. `holds`: electrons of the well where it holds more than those of a
    signal of 1, which `full_well` then is: it clips at `holds`, the last code is there, and
    recordings reach holds / full_well. Raises ValueError otherwise.
    """

    full_well: int = eqx.field(static=True)
    bits: int | None = eqx.field(static=True)
    holds: int = eqx.field(static=True)

    def __init__(self, full_well: float, bits: int | None = None, holds: float | None = None):
        self.full_well = _whole_well(full_well)
        self.bits = _adc_bits(bits)
        self.holds = self.full_well if holds is None else _whole_well(holds, "holds")
        if self.holds < self.full_well:
            raise ValueError(
                f"holds = {holds} electrons, and a signal of 1 has {self.full_well}: give at least "
                "as many, or a smaller full_well"
            )

    @property
    def read_variance(self) -> float:
        return self.adc_variance

    @property
    def saturation(self) -> float:
        """Half an electron below the first count of the last code (or below the full well)."""
        if self.bits is None:
            return (self.holds - 0.5) / self.full_well
        return (float(_first_counts(self.holds, self.bits)[-2]) - 0.5) / self.full_well

    def sample(self, key: jax.Array, expected: jax.Array) -> jax.Array:
        """One recording, 0 to `highest`."""
        expected = _intensity(expected)
        electrons = self._electrons(key, expected)
        if self.bits is None:
            return electrons.astype(expected.dtype) / self.full_well
        starts = jnp.asarray(_first_counts(self.holds, self.bits)[1:-1], jnp.int32)
        code = jnp.searchsorted(starts, electrons, side="right")
        return code.astype(expected.dtype) / self._codes_of_one

    def log_prob(self, y: jax.Array, expected: jax.Array) -> jax.Array:
        """Log-probability of the recorded count, or of all counts that give the recorded code.

        y = `highest` stands for every count from there (or from the last code's first one) up.
        A code that no count gives (full_well < 2^bits - 1) has value -inf. Errors: see
        `counts.poisson_log_interval`; counts up to 64 a code are summed exactly.
        """
        expected = _intensity(expected)
        y, expected = jnp.broadcast_arrays(_follow(y, expected), expected)
        lam = self.full_well * expected
        if self.bits is None:
            count = jnp.round(y * self.full_well)
            start, saturated = self.holds, count >= self.holds
            value = poisson_log_pmf(count, lam)
        else:
            firsts = _first_counts(self.holds, self.bits)
            code = self._code(y)
            start, saturated = int(firsts[-2]), code == self._top
            table = jnp.asarray(firsts, expected.dtype)
            lo, hi = table[code], table[code + 1] - 1
            value = poisson_log_interval(lo, hi, lam, int(np.diff(firsts[:-1]).max()))
        tail = partial(poisson_log_interval, start, jnp.inf, width=UNBOUNDED)
        return jnp.where(saturated, where_asked(tail, 0.0, saturated, lam), value)

    def electrons_between(self, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The least and the largest number of electrons that give `y`; inf at the full well.

        Whole numbers in the dtype of `y`, and shaped as it; the same one where y tells the count.
        """
        y = jnp.asarray(y)
        if self.bits is None:
            low = jnp.round(y * self.full_well)
            return low, jnp.where(low >= self.holds, jnp.inf, low)
        table, code = jnp.asarray(_first_counts(self.holds, self.bits), y.dtype), self._code(y)
        return table[code], jnp.where(code == self._top, jnp.inf, table[code + 1] - 1)

    def check(self, y: np.ndarray) -> None:
        """Refuse nan, inf, integers, complex, out of range, and what no electron count gives."""
        y = np.asarray(y)
        self._check_range(y, 0, self.highest * (1 + 4 * _EPS32))
        if self.bits is None:
            self._check_whole(y)
        else:
            self._check_grid(y)
            self._check_reachable(y)

    def _check_whole(self, y: np.ndarray) -> None:
        electrons = y.astype(np.float64) * self.full_well
        off = np.abs(electrons - np.round(electrons)) > min(0.25, 2 * _EPS32 * self.full_well)
        if off.any():
            raise ValueError(
                f"y = {y[off].flat[0]:.6g} is {electrons[off].flat[0]:.6g} electrons, not a whole "
                "number: set bits for quantised data, or use PoissonGaussian for read noise"
            )

    def _check_reachable(self, y: np.ndarray) -> None:
        codes = np.round(y.astype(np.float64) * self._codes_of_one).astype(int)
        firsts = _first_counts(self.holds, self.bits)
        lost = firsts[codes] >= firsts[codes + 1]
        if lost.any():
            raise ValueError(
                f"y = {y[lost].flat[0]:.6g} is code {codes[lost].flat[0]}, which no whole number "
                f"of 0..{self.holds} electrons gives: raise full_well, lower bits, or use "
                "PoissonGaussian for read noise"
            )


class PoissonGaussian(_CountingCamera):
    """Photon noise, clipped at the full well, then Gaussian read noise and, with `bits`, an ADC.

    Simulates z = min(N, full_well) + read_noise n, N ~ Poisson(full_well x expected), and records
    z / full_well (slightly negative, or above 1, where noise makes it so); or with bits the code
    floor(z M / full_well + 1/2) clipped to 0..M, M = 2^bits - 1, as code / M.

    `full_well`: electrons, a whole number 1 .. 2^23 - 1; `read_noise`: standard deviation,
    electrons, > 0; `bits`: None, or 1 .. 16. Raises ValueError otherwise.
    """

    full_well: int = eqx.field(static=True)
    read_noise: float = eqx.field(static=True)
    bits: int | None = eqx.field(static=True)

    def __init__(self, full_well: float, read_noise: float, bits: int | None = None):
        self.full_well = _whole_well(full_well)
        self.read_noise = _positive(
            "read_noise", read_noise, "a standard deviation in electrons (no read noise: Poisson)"
        )
        self.bits = _adc_bits(bits)

    @property
    def holds(self) -> int:
        return self.full_well

    @property
    def read_variance(self) -> float:
        return (self.read_noise / self.full_well) ** 2 + self.adc_variance

    @property
    def saturation(self) -> float:
        """The lower edge of the last code; without an ADC read noise hides where it is: inf."""
        return math.inf if self.bits is None else 1 - 0.5 / self._top

    def sample(self, key: jax.Array, expected: jax.Array) -> jax.Array:
        """One recording; 0 to 1 with bits, a little beyond without."""
        expected = _intensity(expected)
        count_key, noise_key = jax.random.split(key)
        electrons = self._electrons(count_key, expected).astype(expected.dtype)
        z = electrons + self.read_noise * normal_like(noise_key, electrons)
        if self.bits is None:
            return z / self.full_well
        code = jnp.floor(z * (self._top / self.full_well) + 0.5)
        return jnp.clip(code, 0, self._top) / self._top

    def log_prob(self, y: jax.Array, expected: jax.Array) -> jax.Array:
        """Log-density of y (per unit of y), or log-probability of the recorded code.

        Errors: see `counts.noisy_count_log_pdf` and `counts.noisy_count_log_interval`.
        """
        expected = _intensity(expected)
        y, expected = jnp.broadcast_arrays(_follow(y, expected), expected)
        lam = self.full_well * expected
        noise, well = self.read_noise, self.full_well
        if self.bits is None:
            return noisy_count_log_pdf(y * well, lam, noise, well) + math.log(well)
        code = self._code(y)
        edges = tuple(jnp.asarray(e, expected.dtype)[code] for e in _edges(well, self.bits))
        open_ends = code == 0, code == self._top
        return noisy_count_log_interval(edges, well / self._top, lam, noise, well, open_ends)

    def check(self, y: np.ndarray) -> None:
        """Refuse nan, inf, integers, complex, off the ADC's grid, or beyond ten read noises."""
        y = np.asarray(y)
        slack = 10 * self.read_noise / self.full_well if self.bits is None else 0
        self._check_range(y, -slack, 1 + slack + 4 * _EPS32)
        if self.bits is not None:
            self._check_grid(y)


# ---- the ADC -------------------------------------------------------------------------------------


@lru_cache(maxsize=32)
def _first_counts(full_well: int, bits: int) -> np.ndarray:
    """First electron count of each code 0..M, and full_well + 1; (M + 2,) int64.

    Code c = floor(N M / full_well + 1/2) starts at N = ceil((2c - 1) full_well / 2M).
    """
    top = 2**bits - 1
    code = np.arange(top + 1, dtype=np.int64)
    firsts = np.maximum(-((1 - 2 * code) * full_well // (2 * top)), 0)
    return np.append(firsts, full_well + 1)


@lru_cache(maxsize=32)
def _edges(full_well: int, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower edge (c - 1/2) full_well / M of each code, electrons: whole part, fraction."""
    top = 2**bits - 1
    numerator = (2 * np.arange(top + 1, dtype=np.int64) - 1) * full_well
    whole = numerator // (2 * top)
    return whole, (numerator - whole * 2 * top) / (2 * top)


# ---- what is accepted ----------------------------------------------------------------------------


def _floating(expected: jax.Array) -> jax.Array:
    expected = jnp.asarray(expected)
    return expected if jnp.issubdtype(expected.dtype, jnp.inexact) else expected.astype(float)


def _intensity(expected: jax.Array) -> jax.Array:
    expected = _floating(expected)
    if jnp.iscomplexobj(expected):
        raise ValueError(
            f"expected signal is complex ({expected.dtype}): a counting camera records an "
            "intensity, give |field|^2, or use Gaussian"
        )
    return expected


def _follow(y: jax.Array, expected: jax.Array) -> jax.Array:
    """Data in the precision of the expected signal."""
    y = jnp.asarray(y)
    real = jnp.real(expected).dtype
    return y.astype(jnp.result_type(real, jnp.complex64)) if jnp.iscomplexobj(y) else y.astype(real)


def _check_floats(y: np.ndarray, remedy: str) -> None:
    if not np.issubdtype(y.dtype, np.inexact):
        raise ValueError(f"integer data ({y.dtype}): these look like ADC codes; {remedy}")
    bad = ~np.isfinite(y)
    if bad.any():
        raise ValueError(
            f"y holds {bad.sum()} values that are not finite (the first is {y[bad].flat[0]}): "
            "mask or repair dead pixels first"
        )


def _positive(name: str, value: float, meaning: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (0 < number < math.inf):
        raise ValueError(f"{name} = {value} must be a positive number: {meaning}")
    return number


def _whole_well(full_well: float, name: str = "full_well") -> int:
    number = _positive(name, full_well, "give the full well in electrons")
    if number != round(number) or number > _LARGEST_WELL:
        raise ValueError(
            f"{name} = {full_well} must be a whole number of electrons, at most "
            f"{_LARGEST_WELL}: round it"
        )
    return int(number)


def _adc_bits(bits: int | None) -> int | None:
    if bits is None:
        return None
    try:
        number = operator.index(bits)
    except TypeError:
        number = 0
    if isinstance(bits, bool) or not 1 <= number <= 16:
        raise ValueError(f"bits = {bits} must be an integer 1..16, or None for no ADC")
    return number
