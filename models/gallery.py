"""Small problems whose posterior is known: what samplers and diagnostics are tested on.

Each comes with draws of its posterior for any recording, by a closed form, or by a quadrature or
importance sampling whose fineness is stated. `GALLERY` maps names to functions that build them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .camera import Gaussian as GaussianCamera
from .camera import Poisson
from .laplace import Weighted, laplace
from .likelihood import IntensityLikelihood, Likelihood, LinearLikelihood
from .optics import (
    Blur,
    CodedDiffraction,
    Fourier,
    FourierPtychography,
    Identity,
    Matrix,
    Optics,
)
from .priors import Gaussian, GaussianField, GaussianMixture, PixelPrior
from .priors.base import Prior
from .realview import from_real, to_real

Exact = Callable[[jax.Array, jax.Array, int], jax.Array]


class Known(NamedTuple):
    """A likelihood and a prior, and `exact(key, y, count)`: independent draws (count, *shape).

    `exact` is traceable by JAX. `basis` says what it rests on, and how fine that is;
    `modes`, where the posterior has several, are objects (modes, *shape), one in each;
    `proposed(key, y)`, where draws are by importance, are the weighted ones they are taken from.
    """

    likelihood: Likelihood
    prior: Prior
    exact: Exact
    basis: str
    modes: np.ndarray | None = None
    proposed: Callable[[jax.Array, jax.Array], Weighted] | None = None


def linear_gaussian(
    size: int = 32, rows: int = 24, dtype: type = float, noise: float = 0.3, seed: int = 0
) -> Known:
    """Correlated Gaussian objects behind a random matrix; with few `rows` most directions are free.

    The posterior is normal, of one covariance for all recordings.
    """
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, size)) / np.sqrt(size)
    real, n = matrix, size
    if dtype is complex:
        matrix = (matrix + 1j * rng.standard_normal((rows, size)) / np.sqrt(size)) / np.sqrt(2)
        real, n = np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]]), 2 * size
    root = rng.standard_normal((n, n)) / np.sqrt(n)
    covariance, mean = 0.5 * np.eye(n) + root @ root.T, rng.standard_normal(n)
    gain, rest = _conditioned(covariance, real, noise)
    cholesky = np.linalg.cholesky(rest)

    def exact(key: jax.Array, y: jax.Array, count: int) -> jax.Array:
        centre = mean + gain @ (to_real(y) - real @ mean)
        draws = centre + jax.random.normal(key, (count, n)) @ cholesky.T
        return jax.vmap(lambda v: from_real(v, (size,), jax.dtypes.canonicalize_dtype(dtype)))(
            draws
        )

    prior = Gaussian(mean, covariance, (size,), dtype)
    likelihood = LinearLikelihood(Matrix(matrix), GaussianCamera(noise))
    return Known(likelihood, prior, exact, "closed form")


def field_deblurring(side: int = 64, noise: float = 0.05) -> Known:
    """A blurred picture of a stationary Gaussian field; Wiener's filter, and its spread."""
    shape = (side, side)
    rows, columns = np.meshgrid(*(np.fft.fftfreq(side) for _ in shape), indexing="ij")
    power = 1e-3 / (0.05 + np.hypot(rows, columns)) ** 2
    distance = np.hypot(*np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)))
    psf = np.exp(-0.5 * (distance / 1.5) ** 2)
    optics, mean = Blur(shape, psf / psf.sum()), 0.5

    def exact(key: jax.Array, y: jax.Array, count: int) -> jax.Array:
        transfer = optics.transfer
        rest = power / (1 + power * jnp.abs(transfer) ** 2 / noise**2)
        blurred_mean = mean * transfer[0, 0].real
        centre = rest * transfer.conj() / noise**2 * jnp.fft.fft2(y - blurred_mean)
        n = jax.random.normal(key, (count, *shape))
        return mean + jnp.fft.ifft2(centre + jnp.sqrt(rest) * jnp.fft.fft2(n)).real

    prior = GaussianField(power, mean)
    return Known(LinearLikelihood(optics, GaussianCamera(noise)), prior, exact, "closed form")


def mixture_linear(size: int = 8, rows: int = 2, modes: int = 9, noise: float = 0.5) -> Known:
    """A mixture of unit Gaussians, of which a random matrix sees a few directions.

    The posterior is a mixture, with the weights of the evidence.
    """
    rng = np.random.default_rng(size)
    means = 3 * rng.standard_normal((modes, size))
    weights = rng.dirichlet(np.full(modes, 3.0))
    matrix = rng.standard_normal((rows, size)) / np.sqrt(size)
    return _unit_mixture(weights, means, matrix, noise)


def mixture_of_25(size: int = 8, rows: int = 1, seed: int = 0) -> Known:
    """The mixture that papers on diffusion posteriors compare samplers on; `seed`: which of them.

    25 unit Gaussians at (8i, 8j, 8i, 8j, ...), i and j from -2 to 2, with the squares of normal
    numbers for weights; a matrix with uniform singular values; noise uniform up to the largest of
    these (Cardoso, Janati, Le Corff and Moulines 2024, section 4).
    """
    rng = np.random.default_rng([seed, size, rows])
    grid = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3), indexing="ij"), axis=-1)
    means = 8.0 * np.tile(grid.reshape(25, 2), (1, size // 2))
    weights = rng.standard_normal(25) ** 2
    left, _, right = np.linalg.svd(rng.standard_normal((rows, size)), full_matrices=False)
    values = np.sort(rng.uniform(size=rows))[::-1]
    # In units of the noise: all of one size are one compiled program.
    matrix = (left * values) @ right / (rng.uniform() * values[0])
    return _unit_mixture(weights / weights.sum(), means, matrix, 1.0)


def gamma_poisson(size: int = 16, full_well: int = 50) -> Known:
    """Photon counts of pixels with a gamma density, its conjugate.

    Saturation, which has no conjugate, has a probability of 6e-6 in a pixel.
    """
    concentration, rate = 3.0, 20.0

    def exact(key: jax.Array, y: jax.Array, count: int) -> jax.Array:
        shape = concentration + y * full_well
        return jax.random.gamma(key, shape, (count, size)) / (rate + full_well)

    prior = PixelPrior.gamma(concentration, rate, (size,))
    likelihood = LinearLikelihood(Identity((size,)), Poisson(full_well))
    return Known(likelihood, prior, exact, "closed form")


def quantised_counts(
    size: int = 16, full_well: int = 100, bits: int = 4, nodes: int = 2048
) -> Known:
    """Photon counts behind an ADC of 16 codes: each code leaves several counts possible.

    Every pixel by a quadrature of its own, whose cells are 0.05 % of the prior's range.
    """
    prior = PixelPrior.gamma(3.0, 12.0, (size,))
    camera = Poisson(full_well, bits=bits)
    edges = np.linspace(0.0, float(prior.grid[-1]), nodes + 1)
    centres, width = jnp.asarray((edges[1:] + edges[:-1]) / 2), edges[1]
    density = np.interp(centres, prior.grid, prior.density)

    def exact(key: jax.Array, y: jax.Array, count: int) -> jax.Array:
        def of_pixel(key: jax.Array, y: jax.Array) -> jax.Array:
            logits = camera.log_prob(y, jnp.asarray(centres, y.dtype)) + np.log(density)
            key_cell, key_place = jax.random.split(key)
            cell = _drawn_cells(key_cell, logits, count)
            return centres[cell] + width * (jax.random.uniform(key_place, (count,)) - 0.5)

        return jax.vmap(of_pixel, out_axes=1)(jax.random.split(key, size), y)

    likelihood = LinearLikelihood(Identity((size,)), camera)
    return Known(likelihood, prior, exact, f"quadrature of {nodes} cells a pixel")


def one_complex_pixel(sigma_0: float = 0.1, nodes: int = 400, reach: float = 1.6) -> Known:
    """The intensity of one complex pixel, and a prior of three phases that it cannot tell apart.

    By a quadrature in amplitude and phase, in cells of 0.004 and 0.016 rad: 3 and 8 % of the
    prior's sd.
    """
    places = 0.75 * np.exp(1j * np.array([0.3, 2.5, -1.7]))
    means = np.stack([places.real, places.imag], axis=1)
    covariances = np.broadcast_to(0.15**2 * np.eye(2), (3, 2, 2))
    prior = GaussianMixture(np.array([0.6, 0.3, 0.1]), means, covariances, (1,), complex)
    likelihood = IntensityLikelihood(Identity((1,)), Poisson(round(1 / sigma_0**2)))
    radius = (np.arange(nodes) + 0.5) * (reach / nodes)
    angle = (np.arange(nodes) + 0.5) * (2 * np.pi / nodes)
    cells = jnp.asarray(radius[:, None] * np.exp(1j * angle))
    # Cells are as large as they are far from the origin.
    area = jax.vmap(jax.vmap(prior.log_prob))(cells[..., None]) + np.log(radius)[:, None]

    def exact(key: jax.Array, y: jax.Array, count: int) -> jax.Array:
        amplitudes = jnp.asarray(radius, prior.dtype)[:, None]
        logits = jax.vmap(lambda o: likelihood.log_prob(o, y))(amplitudes)[:, None] + area
        key_cell, key_place = jax.random.split(key)
        cell = _drawn_cells(key_cell, logits.ravel(), count)
        within = jax.random.uniform(key_place, (2, count)) - 0.5
        r = jnp.asarray(radius)[cell // nodes] + within[0] * (reach / nodes)
        phase = jnp.asarray(angle)[cell % nodes] + within[1] * (2 * np.pi / nodes)
        return (r * jnp.exp(1j * phase))[:, None].astype(prior.dtype)

    basis = f"quadrature of {nodes} amplitudes by {nodes} phases"
    return Known(likelihood, prior, exact, basis, places[:, None])


def two_pixel_retrieval(sigma_0: float = 0.25, proposals: int = 20_000) -> Known:
    """Fourier magnitudes of two complex pixels: two twins, which the prior weighs 2 to 1.

    By importance: draws of the prior, resampled by their likelihood with replacement. Of 20,000
    half count at the median over recordings, 700 at the least of 300.
    """
    twins = np.array([[0.55 + 0.2j, 0.25 - 0.3j], [0.25 + 0.3j, 0.55 - 0.2j]])
    means = np.concatenate([twins.real, twins.imag], axis=1)
    covariances = np.broadcast_to(0.1**2 * np.eye(4), (2, 4, 4))
    prior = GaussianMixture(np.array([2.0, 1.0]) / 3, means, covariances, (2,), complex)
    likelihood = IntensityLikelihood(Fourier((2,), oversampling=2), Poisson(round(1 / sigma_0**2)))

    def proposed(key: jax.Array, y: jax.Array) -> Weighted:
        objects = jax.vmap(prior.sample)(jax.random.split(key, proposals))
        return Weighted(objects, jax.vmap(lambda o: likelihood.log_prob(o, y))(objects))

    basis = f"importance sampling of {proposals} draws of the prior"
    return Known(likelihood, prior, _resampled(proposed), basis, twins, proposed)


def six_pixel_retrieval(sigma_0: float = 0.1) -> Known:
    """Fourier magnitudes of six complex pixels: two twins, which the prior weighs 2 to 1."""
    rng = np.random.default_rng(6)
    one = rng.uniform(0.3, 0.9, (2, 3)) * np.exp(1j * rng.uniform(-2, 2, (2, 3)))
    # In one dimension there would be up to 2^5 others.
    twins = np.stack([one, one[::-1, ::-1].conj()])
    optics = Fourier((2, 3), oversampling=2)
    # Each component has several maxima, which its mean alone does not lead to.
    return _of_complex(twins, [2.0, 1.0], 0.1, optics, sigma_0, starts=32)


def coded_diffraction(side: int = 4, sigma_0: float = 0.1) -> Known:
    """Far fields behind four random phase masks; a global phase that only the prior knows.

    It believes in two objects that differ by a turn of 1.5 rad, which the data do not tell apart.
    """
    rng = np.random.default_rng(4)
    shape = (side, side)
    one = rng.uniform(0.4, 0.9, shape) * np.exp(1j * rng.uniform(-0.6, 0.6, shape))
    masks = np.exp(2j * np.pi * rng.uniform(size=(4, *shape)))
    turned = np.stack([one, one * np.exp(1.5j)])
    return _of_complex(turned, [0.7, 0.3], 0.1, CodedDiffraction(masks), sigma_0, 16_000)


def small_ptychography(side: int = 6, sigma_0: float = 0.1) -> Known:
    """Nine low-resolution intensities of a transparent object, each from another direction."""
    centres = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(9, 2)
    optics = FourierPtychography.from_radius((side, side), centres, 1.5, side // 3)
    return _of_complex(np.full((1, side, side), 0.8 + 0j), [1.0], 0.15, optics, sigma_0)


def digits(components: int = 10, full_well: int = 100) -> Known:
    """Handwritten digits, 8 x 8, faint on a bright ground, under photon noise.

    The prior is a mixture fitted to the 1797 of scikit-learn (Alpaydin and Kaynak 1998).
    """
    from sklearn.datasets import load_digits
    from sklearn.mixture import GaussianMixture as Fitted

    # Normals have negative light on darker ground, where a recording of no photons leaves Laplace's
    # proposals 5 effective draws of 4000; here it is 1989 at the least of 60 recordings.
    pictures = 0.3 + 0.3 * load_digits().data / 16
    fitted = Fitted(components, reg_covar=1.5e-4, random_state=0).fit(pictures)
    prior = GaussianMixture(fitted.weights_, fitted.means_, fitted.covariances_, (8, 8))
    likelihood = LinearLikelihood(Identity((8, 8)), Poisson(full_well))
    return _by_laplace(likelihood, prior, fitted.means_.reshape(-1, 8, 8))


GALLERY: dict[str, Callable[[], Known]] = {
    "linear Gaussian": linear_gaussian,
    "linear Gaussian, complex": lambda: linear_gaussian(dtype=complex, size=16, rows=12),
    "linear Gaussian, 4 rows of 32": lambda: linear_gaussian(rows=4),
    "field deblurring, 64 x 64": field_deblurring,
    "mixture, 8 dimensions": mixture_linear,
    "mixture, 80 dimensions": lambda: mixture_linear(size=80, rows=4),
    "gamma and Poisson": gamma_poisson,
    "Poisson at 4 bits": quantised_counts,
    "digits, 8 x 8": digits,
    "complex pixel, sigma_0 0.05": lambda: one_complex_pixel(0.05),
    "complex pixel, sigma_0 0.1": one_complex_pixel,
    "complex pixel, sigma_0 0.3": lambda: one_complex_pixel(0.3),
    "two-pixel phase retrieval": two_pixel_retrieval,
    "six-pixel phase retrieval": six_pixel_retrieval,
    "coded diffraction, 4 x 4": coded_diffraction,
    "ptychography, 6 x 6": small_ptychography,
}


def of_counts(known: Known) -> Known:
    """The same problem, whose prior has the error of photon counts, as `Thickening` asks for.

    The density of the object itself is the same. Raises ValueError for a prior that is no
    `PixelPrior`: no other has both errors.
    """
    prior = known.prior
    if not isinstance(prior, PixelPrior):
        raise ValueError(f"the prior is a {type(prior).__name__}: give a problem of a PixelPrior")
    return known._replace(prior=PixelPrior(prior.grid, prior.density, prior.shape, "poisson"))


def file_name(name: str) -> str:
    """The name of a problem, as a file may have it."""
    return "".join(c if c.isalnum() else "-" for c in name)


def _of_complex(
    modes: np.ndarray,
    weights: list[float],
    sd: float,
    optics: Optics,
    sigma_0: float,
    proposals: int = 4000,
    starts: int = 1,
) -> Known:
    """Counted intensities of objects about `modes` (K, *shape), `sd` per real component."""
    means = np.concatenate([m.reshape(len(modes), -1) for m in (modes.real, modes.imag)], axis=1)
    variances = np.full(len(modes), sd**2)
    prior = GaussianMixture(np.array(weights), means, variances, modes.shape[1:], complex)
    likelihood = IntensityLikelihood(optics, Poisson(round(1 / sigma_0**2)))
    return _by_laplace(likelihood, prior, modes, proposals, starts)


def _by_laplace(
    likelihood: Likelihood,
    prior: GaussianMixture,
    modes: np.ndarray,
    proposals: int = 4000,
    starts: int = 1,
) -> Known:
    def proposed(key: jax.Array, y: jax.Array) -> Weighted:
        return laplace(key, likelihood, prior, y, proposals, starts=starts)

    basis = f"importance sampling of {proposals} draws about maxima found from {starts} starts"
    several = modes if len(modes) > 1 else None
    return Known(likelihood, prior, _resampled(proposed), basis, several, proposed)


def _resampled(proposed: Callable[[jax.Array, jax.Array], Weighted]) -> Exact:
    def exact(key: jax.Array, y: jax.Array, count: int) -> jax.Array:
        key_proposed, key_chosen = jax.random.split(key)
        return proposed(key_proposed, y).resampled(key_chosen, count)

    return exact


def _unit_mixture(
    weights: np.ndarray, means: np.ndarray, matrix: np.ndarray, noise: float
) -> Known:
    """Unit Gaussians about `means` behind a matrix: each conditioned by itself, in closed form."""
    rows, size = matrix.shape
    gain, rest = _conditioned(np.eye(size), matrix, noise)
    seen = np.linalg.cholesky(matrix @ matrix.T + noise**2 * np.eye(rows))
    cholesky = np.linalg.cholesky(rest)

    def exact(key: jax.Array, y: jax.Array, count: int) -> jax.Array:
        off = y - means @ matrix.T
        scaled = jax.scipy.linalg.solve_triangular(jnp.asarray(seen, y.dtype), off.T, lower=True)
        evidence = np.log(weights) - 0.5 * jnp.sum(scaled**2, axis=0)
        centres = means + off @ gain.T
        key_mode, key_noise = jax.random.split(key)
        mode = jax.random.categorical(key_mode, evidence, shape=(count,))
        return centres[mode] + jax.random.normal(key_noise, (count, size)) @ cholesky.T

    prior = GaussianMixture(weights, means, np.ones(len(weights)), (size,))
    likelihood = LinearLikelihood(Matrix(matrix), GaussianCamera(noise))
    return Known(likelihood, prior, exact, "closed form", means)


def _conditioned(
    covariance: np.ndarray, matrix: np.ndarray, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gain and covariance of a Gaussian given a linear recording with white noise."""
    rest = np.linalg.inv(np.linalg.inv(covariance) + matrix.T @ matrix / noise**2)
    return rest @ matrix.T / noise**2, rest


def _drawn_cells(key: jax.Array, logits: jax.Array, count: int) -> jax.Array:
    """Indices (count,) of cells of these log-weights, with replacement."""
    return jax.random.choice(key, len(logits), (count,), p=jax.nn.softmax(logits))
