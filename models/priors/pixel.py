"""Independent pixels with any tabulated density of intensities."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats

from .base import Prior, check_finite, checked_shape
from .perturbation import refuse_counts

# Half-width of the quadrature in standard deviations of the annealing error.
_REACH = 8.0
_NODES = 257
# Bins for each point of the table, of which most then hold a cell or two.
_BINS = 2


class PixelPrior(Prior):
    """Independent positive pixels, each with the same tabulated density.

    `grid` (m,), increasing, not negative; `density` (m,), not negative, normalised here. Between
    grid points the density is linear; outside it is zero. Real objects only.

    `perturbation` "signal": the annealed variable is folded at zero, |x + sqrt(x) e| with
    e ~ N(0, sigma^2) (eq:defining_x_tilde). Its density and score (eq:true_p, perturbation.py) are
    quadratures of the trapezoid rule, in a variable that fits the kernel's width at every sigma.
    "poisson": it is sigma^2 N, N ~ Poisson(x/sigma^2), which has no score; `denoise` is a
    quadrature on the grid. Raises ValueError on a grid or density that is no density.
    """

    grid: jax.Array
    density: jax.Array
    bins: "_Bins"
    shape: tuple[int, ...] = eqx.field(static=True)
    complex_valued: bool = eqx.field(static=True, default=False)
    perturbation: str = eqx.field(static=True, default="signal")

    def __init__(
        self,
        grid: np.ndarray,
        density: np.ndarray,
        shape: tuple[int, ...],
        perturbation: str = "signal",
    ):
        grid, density = np.asarray(grid, dtype=float), np.asarray(density, dtype=float)
        check_finite(grid=grid, density=density)
        if grid.ndim != 1 or grid.size < 2 or density.shape != grid.shape:
            raise ValueError(
                f"grid of shape {grid.shape} and density of shape {density.shape}: "
                "give two vectors of one length, 2 or more"
            )
        if grid[0] < 0 or np.any(np.diff(grid) <= 0):
            raise ValueError("grid must increase strictly from a value that is not negative")
        if density.min() < 0 or density.max() == 0:
            raise ValueError(
                f"density runs from {density.min():.3g} to {density.max():.3g}: "
                "it must not be negative, nor zero everywhere"
            )
        self.grid = jnp.asarray(grid)
        self.density = jnp.asarray(density / np.trapezoid(density, grid))
        self.bins = _Bins.of(grid)
        self.shape = checked_shape(shape)
        self.complex_valued = False
        if perturbation not in ("signal", "poisson"):
            raise ValueError(f"perturbation {perturbation!r}: use 'signal' or 'poisson'")
        self.perturbation = perturbation

    @classmethod
    def gamma(
        cls,
        concentration: float,
        rate: float,
        shape: tuple[int, ...],
        nodes: int = 4001,
        perturbation: str = "signal",
    ) -> "PixelPrior":
        """Gamma density, conjugate to Poisson counts; tabulated to its 1e-10 quantiles."""
        distribution = scipy.stats.gamma(concentration, scale=1 / rate)
        lowest = 0.0 if concentration > 1 else distribution.ppf(1e-6)
        # Equal steps of sqrt(x) follow the density where it bends most, near zero.
        grid = np.linspace(np.sqrt(lowest), np.sqrt(distribution.isf(1e-10)), nodes) ** 2
        return cls(grid, distribution.pdf(grid), shape, perturbation)

    @property
    def scale(self) -> jax.Array:
        """Standard deviation of a pixel."""
        mean = jnp.trapezoid(self.grid * self.density, self.grid)
        return jnp.sqrt(jnp.trapezoid((self.grid - mean) ** 2 * self.density, self.grid))

    def sample(self, key: jax.Array) -> jax.Array:
        """One picture, by inverting the cumulative distribution (a quadratic in each cell)."""
        width = jnp.diff(self.grid)
        left, right = self.density[:-1], self.density[1:]
        cumulative = jnp.concatenate([jnp.zeros(1), jnp.cumsum((left + right) / 2 * width)])
        u = jax.random.uniform(key, self.shape, self.grid.dtype) * cumulative[-1]
        cell = jnp.clip(jnp.searchsorted(cumulative, u, side="right") - 1, 0, width.size - 1)
        slope = (right - left)[cell] / width[cell]
        excess = u - cumulative[cell]
        # The root of left t + slope t^2/2 = excess, in the form without cancellation.
        root = jnp.sqrt(jnp.maximum(left[cell] ** 2 + 2 * slope * excess, 0.0))
        step = 2 * excess / jnp.maximum(left[cell] + root, jnp.finfo(u.dtype).tiny)
        return self.grid[cell] + jnp.minimum(step, width[cell])

    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Log-density of the annealed picture at `x`; -inf outside the support.

        At sigma > 0 that of the folded variable, normalised over x >= 0.
        """
        self._to_vector(x)
        if self.perturbation == "poisson":
            _refuse_level(sigma)
            return jnp.sum(self._log_density(x))
        sigma = jnp.asarray(sigma, x.dtype)
        return jnp.sum(
            jax.lax.cond(
                sigma > 0,
                lambda: self._annealed(x, jnp.where(sigma > 0, sigma, 1.0))[0],
                lambda: self._log_density(x),
            )
        )

    def score(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """(tanh(z/sigma^2) - z E[1/x | z])/sigma^2 at z = `x`, which is eq:true_p folded.

        The density's own slope at sigma = 0; odd in `x`, which is of no use below zero.
        """
        self._to_vector(x)
        if self.perturbation == "poisson":
            _refuse_level(sigma)
            return self._own_score(x)
        sigma = jnp.asarray(sigma, x.dtype)
        return jax.lax.cond(
            sigma > 0,
            lambda: self._annealed(x, jnp.where(sigma > 0, sigma, 1.0))[1],
            lambda: self._own_score(x),
        )

    def denoise(self, x: jax.Array, sigma: jax.Array | float) -> jax.Array:
        """E[object | counts x/sigma^2], for "poisson": the trapezoid rule on the grid.

        Raises ValueError for "signal".
        """
        if self.perturbation != "poisson":
            return super().denoise(x, sigma)
        self._to_vector(x)
        counts, grid = x[..., None] / sigma**2, self.grid.astype(x.dtype)
        width = (jnp.diff(grid, prepend=grid[0]) + jnp.diff(grid, append=grid[-1])) / 2
        log_weight = jax.scipy.special.xlogy(counts, grid) - grid / sigma**2
        weight = jax.nn.softmax(log_weight + jnp.log(width * self.density), axis=-1)
        return jnp.sum(weight * grid, axis=-1)

    def _own_score(self, x: jax.Array) -> jax.Array:
        return self._slope(x) / jnp.maximum(self._density(x), jnp.finfo(x.dtype).tiny)

    def _density(self, x: jax.Array) -> jax.Array:
        cell = self.bins.cell(self.grid, x)
        found = self.density[cell] + self._slopes()[cell] * (x - self.grid[cell])
        return jnp.where((x >= self.grid[0]) & (x <= self.grid[-1]), found, 0.0)

    def _log_density(self, x: jax.Array) -> jax.Array:
        density = self._density(x)
        inside = density > 0
        # Two selections, so that the gradient outside the support is zero and not NaN.
        return jnp.where(inside, jnp.log(jnp.where(inside, density, 1.0)), -jnp.inf)

    def _slope(self, x: jax.Array) -> jax.Array:
        cell = self.bins.cell(self.grid, x)
        return jnp.where((x >= self.grid[0]) & (x <= self.grid[-1]), self._slopes()[cell], 0.0)

    def _slopes(self) -> jax.Array:
        return jnp.diff(self.density) / jnp.diff(self.grid)

    def _annealed(self, x: jax.Array, sigma: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Elementwise log-density and score of the folded variable.

        With x = z e^{2w} the kernel's exponent (z - x)^2/(2 sigma^2 x) is 2 z sinh(w)^2/sigma^2:
        even in w, so a grid of |w| up to asinh(reach sigma/(2 sqrt z)) holds it all, however wide
        or narrow. The fold adds a factor 1 + exp(-2 z/sigma^2) that does not depend on x.
        """
        negative, sign = x < 0, jnp.sign(x)
        # At zero itself the grid would be endless; the density does not change below this.
        x = jnp.maximum(jnp.abs(x), 1e-12 * self.grid[-1])
        reach = jnp.arcsinh(_REACH * sigma / (2 * jnp.sqrt(x)))
        u = jnp.linspace(-1.0, 1.0, _NODES, dtype=x.dtype)
        w = reach[..., None] * u
        clean = x[..., None] * jnp.exp(2 * w)
        exponent = -2 * x[..., None] * jnp.sinh(w) ** 2 / sigma**2
        # dx = 2 clean dw, and the kernel carries 1/sqrt(2 pi sigma^2 clean).
        log_weight = exponent + jnp.log(2 * jnp.sqrt(clean)) + self._log_density(clean)
        log_norm = jnp.log(reach * (u[1] - u[0]) / (sigma * jnp.sqrt(2 * jnp.pi)))
        log_sum = jax.nn.logsumexp(log_weight, axis=-1)
        weight = jnp.exp(log_weight - jnp.where(jnp.isfinite(log_sum), log_sum, 0.0)[..., None])
        # (clean - x)/clean = 1 - e^{-2w}
        unfolded = jnp.sum(weight * -jnp.expm1(-2 * w), axis=-1)
        # So far from all light that no node meets it, the nearest is the only source.
        nearest = self._nearest(x)
        at_nearest = (nearest - x) / jnp.maximum(nearest, 1e-12 * self.grid[-1])
        unfolded = jnp.where(jnp.isfinite(log_sum), unfolded, at_nearest)
        score = sign * (unfolded - 2 * jax.nn.sigmoid(-2 * x / sigma**2)) / sigma**2
        log_density = log_sum + log_norm + jax.nn.softplus(-2 * x / sigma**2)
        return jnp.where(negative, -jnp.inf, log_density), score

    def _nearest(self, x: jax.Array) -> jax.Array:
        """The value of the table with a density that most likely became `x`, elementwise."""
        lit, grid = self.density > 0, self.grid.astype(x.dtype)
        below = jax.lax.cummax(jnp.where(lit, grid, -jnp.inf))
        above = jax.lax.cummin(jnp.where(lit, grid, jnp.inf), reverse=True)
        cell = jnp.clip(jnp.searchsorted(grid, x, side="right") - 1, 0, grid.size - 2)
        low, high = below[cell], above[cell + 1]
        low, high = jnp.where(low < 0, high, low), jnp.where(jnp.isinf(high), low, high)

        def distance(clean: jax.Array) -> jax.Array:
            return jnp.square(x - clean) / jnp.maximum(clean, 1e-12 * grid[-1])

        return jnp.where(distance(low) < distance(high), low, high)


class _Bins(eqx.Module):
    """Where to look a value up: bins even in sqrt(x), each with the first cell of the table in it.

    A binary search of the whole table is three quarters of a score: this one searches a bin.
    """

    first: jax.Array
    steps: int = eqx.field(static=True)

    @classmethod
    def of(cls, grid: np.ndarray) -> "_Bins":
        """Bins of a table (m,) whose values increase from 0 or more."""
        edges = grid[-1] * np.linspace(0.0, 1.0, _BINS * grid.size + 1) ** 2
        first = np.clip(np.searchsorted(grid, edges, side="right") - 1, 0, grid.size - 2)
        steps = int(np.ceil(np.log2(1 + np.diff(first).max())))
        return cls(jnp.asarray(first), steps)

    def cell(self, grid: jax.Array, x: jax.Array) -> jax.Array:
        """The cell whose ends are around `x`, elementwise; the outermost for what is outside.

        Within rounding of an edge the cell before it: there a line between points is the same.
        """
        bins = self.first.size - 1
        place = bins * jnp.sqrt(jnp.clip(x / grid[-1], 0.0, 1.0))
        chosen = jnp.minimum(place.astype(jnp.int32), bins - 1)
        cell = self.first[chosen]
        for step in reversed(range(self.steps)):
            further = jnp.minimum(cell + 2**step, grid.size - 2)
            cell = jnp.where(x >= grid[further], further, cell)
        return cell


def _refuse_level(sigma: jax.Array | float) -> None:
    if isinstance(sigma, jax.core.Tracer) or sigma != 0:
        refuse_counts("poisson")
