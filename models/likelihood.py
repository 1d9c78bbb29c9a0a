"""Likelihoods: optics and camera together, y = N(Hx) or y = N(|Ho|^2).

`log_prob` is always the exact probability of what was recorded. `annealed_score` is the score of
the annealed variable (models/annealing.py), which tends to the exact one as sigma -> 0.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from . import annealing
from .camera import Camera
from .optics import Identity, Optics
from .realview import real_score

# Below this many electrons the variance of a count is held.
_FAINTEST = 0.1


class Likelihood(eqx.Module):
    """The probability of a recording given the object.

    Attributes: `optics` (object -> field), `camera` (expected signal -> recorded value). Data are
    normalised: electrons / full well (eq:fwc).
    """

    optics: eqx.AbstractVar[Optics]
    camera: eqx.AbstractVar[Camera]

    @property
    def data_shape(self) -> tuple[int, ...]:
        """Shape of a recording."""
        return self.optics.out_shape

    @property
    def object_shape(self) -> tuple[int, ...]:
        """Shape of the object."""
        return self.optics.in_shape

    @property
    def linear(self) -> bool:
        """Whether the camera records the field itself, so that the expected signal is Hx."""
        return False

    @abc.abstractmethod
    def expected(self, x: jax.Array) -> jax.Array:
        """Expected signal of the object `x`, in units of the full well; shape of the data."""

    def feasible(self, x: jax.Array) -> jax.Array:
        """`x` moved to where the data can have come from: a place for a chain to start."""
        return x

    def simulate(self, key: jax.Array, x: jax.Array) -> jax.Array:
        """One recording of the object `x`."""
        return self.camera.sample(key, self.expected(x))

    def log_prob(self, x: jax.Array, y: jax.Array, weights: jax.Array | float = 1.0) -> jax.Array:
        """Exact log-probability of the recording `y`: a real scalar.

        `weights`: how often each measurement counts, broadcast to `y`.
        """
        return jnp.sum(weights * self.camera.log_prob(y, self.expected(x)))

    def score(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Gradient of `log_prob` in the real view of `x`: d/dRe + j d/dIm."""
        return real_score(jax.grad(self.log_prob)(x, y))

    def log_prob_and_score(
        self, x: jax.Array, y: jax.Array, weights: jax.Array | float = 1.0
    ) -> tuple[jax.Array, jax.Array]:
        """Both for the price of the score."""
        value, gradient = jax.value_and_grad(self.log_prob)(x, y, weights)
        return value, real_score(gradient)

    @abc.abstractmethod
    def annealed_score(
        self,
        x: jax.Array,
        y: jax.Array,
        sigma: jax.Array | float,
        path: str = "convolved",
        published: bool = False,
        perturbation: str = "gaussian",
        clean: jax.Array | None = None,
    ) -> jax.Array:
        """Score of log p(y | x~ = x) at annealing level `sigma`; shaped as the object.

        `clean`: E[object | x~] under the prior, if known, shaped as the object.
        """

    @abc.abstractmethod
    def noise(self, x_complex: bool, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Variance of the noise that an annealing error competes with, and the error's gain.

        Both have the shape of the data: at level sigma an error of variance gain * sigma^2 reaches
        the measurement, beside noise of this variance.
        """

    def curvature(
        self, x_complex: bool, y: jax.Array, sigma: jax.Array | float, path: str
    ) -> jax.Array:
        """Bound on the curvature of the annealed log-likelihood, in the object's units^-2.

        One value a pixel where the optics are the identity, a scalar otherwise.
        """
        noise, gain = self.noise(x_complex, y)
        precision = 1 / annealing.remaining_variance(noise, gain * sigma**2, path)
        if isinstance(self.optics, Identity):
            return precision * self._field_gain**2
        return jnp.max(precision) * self._field_gain**2 * self.optics.norm_squared()

    @property
    def _field_gain(self) -> jax.Array | float:
        return 1.0

    def _to_object(self, field: jax.Array, x: jax.Array) -> jax.Array:
        """H^H field, its real part where the object is real."""
        gradient = self.optics.adjoint(field)
        return gradient if jnp.iscomplexobj(x) else gradient.real


class LinearLikelihood(Likelihood):
    """y = N(Hx): the camera records the field itself.

    A counting camera (Poisson, PoissonGaussian) needs a real field; a negative expected signal
    counts as darkness. With `camera=Gaussian` the field may be complex (noise in Re and in Im).
    """

    optics: Optics
    camera: Camera

    def __check_init__(self):
        _check_parts(self.optics, self.camera)

    @property
    def linear(self) -> bool:
        """True."""
        return True

    def expected(self, x: jax.Array) -> jax.Array:
        """Hx; refuses a complex field before a counting camera."""
        field = self.optics(x)
        if self.camera.counting and jnp.iscomplexobj(field):
            raise ValueError(
                "a counting camera cannot record a complex field: "
                "use IntensityLikelihood, or a Gaussian camera"
            )
        return field

    def feasible(self, x: jax.Array) -> jax.Array:
        """|x| where light is counted: negative light explains no electron."""
        return jnp.abs(x) if self.camera.counting and not jnp.iscomplexobj(x) else x

    def annealed_score(
        self,
        x: jax.Array,
        y: jax.Array,
        sigma: jax.Array | float,
        path: str = "convolved",
        published: bool = False,
        perturbation: str = "gaussian",
        clean: jax.Array | None = None,
    ) -> jax.Array:
        """Score of log p(y | x~ = x) at annealing level `sigma`; shaped as the object.

        "gaussian": H^T (y - Hx)/(noise variance -+ annealing variance); exact for Gaussian noise if
        H H^H is diagonal, and exact for Poisson counts (without quantisation) at sigma = 0. The
        noise of counts is that of the light in `clean`, E[object | x~], or for want of it in x.
        "signal": for the identity and Poisson counts only; along "split" eq:log_p_y_x_tilde, which
        knows no ADC, along "convolved" its first two moments as a count has them,
        (y - x)/((sigma_0^2 + sigma^2) x + variance of the ADC), exact for Poisson counts without
        one at sigma = 0. A saturated pixel counts as "at least this", with Gaussian noise.
        `published` changes nothing here: the printed equations of real images are right.
        """
        if perturbation == "signal":
            return self._signal_score(x, y, sigma, path)
        field = self.expected(x)
        light = field if clean is None else self.expected(clean)
        noise, gain = self._noise_at(light, jnp.iscomplexobj(x))
        variance = annealing.remaining_variance(noise, gain * sigma**2, path)
        score = annealing.counts_score(field, y, variance)
        return self._to_object(self._where_saturated(score, field, y, variance), x)

    def _where_saturated(
        self, score: jax.Array, expected: jax.Array, y: jax.Array, variance: jax.Array
    ) -> jax.Array:
        edge = self.camera.saturation
        if not math.isfinite(edge):
            return score
        return jnp.where(y > edge, annealing.saturated_score(expected, edge, variance), score)

    def _signal_score(
        self, x: jax.Array, y: jax.Array, sigma: jax.Array | float, path: str
    ) -> jax.Array:
        if not isinstance(self.optics, Identity) or not self.camera.counting:
            raise ValueError(
                "signal-dependent annealing is derived for photon counts of the picture itself "
                "(Identity optics): use a prior with the gaussian perturbation"
            )
        noise = jnp.asarray(self.camera.sigma0**2, x.dtype)
        variance = annealing.remaining_variance(noise, sigma**2, path)
        seen = variance * x + self.camera.read_variance
        if path == "split":
            score = annealing.signal_score(x, y, variance)
        else:
            score = annealing.counts_score(x, y, seen)
        return self._where_saturated(score, x, y, seen)

    def noise(self, x_complex: bool, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Variance of the recorded signal (per real component), and the annealing gain."""
        # Where nothing was recorded there may still be an electron's worth of light.
        return self._noise_at(jnp.maximum(y, self.camera.sigma0**2), x_complex)

    def _noise_at(self, signal: jax.Array, x_complex: bool) -> tuple[jax.Array, jax.Array]:
        level = jnp.maximum(signal.real, _FAINTEST * self.camera.sigma0**2)
        variance = self.camera.sigma0**2 * level + self.camera.read_variance
        return variance, _annealing_gain(self.optics, x_complex)


class IntensityLikelihood(Likelihood):
    """y = N(irradiance |Ho|^2 + background): the camera records the intensity of the field.

    - `irradiance` (rho of eq:non_linear_transorm): a positive number, or an array that broadcasts
      to the data, such as one value a LED: (M, 1, 1).
    - `background`: light that the object does not send, in units of the full well: 0 or more, or
      an array that broadcasts to the data; None: none. Counts of it are in the data, and their
      noise with them.
    """

    optics: Optics
    camera: Camera
    irradiance: jax.Array
    background: jax.Array | None

    def __init__(
        self,
        optics: Optics,
        camera: Camera,
        irradiance: float | np.ndarray = 1.0,
        background: float | np.ndarray | None = None,
    ):
        _check_parts(optics, camera)
        irradiance = np.asarray(irradiance, dtype=float)
        if not np.all(np.isfinite(irradiance) & (irradiance > 0)):
            raise ValueError(f"irradiance {irradiance.min():.3g}: it must be positive and finite")
        self.optics = optics
        self.camera = camera
        self.irradiance = jnp.asarray(irradiance)
        self.background = None
        if background is not None:
            self.background = jnp.asarray(_checked_background(background, optics.out_shape))

    def expected(self, x: jax.Array) -> jax.Array:
        """irradiance |Hx|^2 + background."""
        field = self._field(x)
        light = jnp.square(field.real) + jnp.square(field.imag)
        return light if self.background is None else light + self.background.astype(light.dtype)

    def amplitude(self, y: jax.Array) -> jax.Array:
        """|Hx| of which `y` is a recording without noise, shaped as `y`; 0 below the background."""
        return jnp.sqrt(jnp.maximum(self._signal(y), 0) / self.irradiance)

    def annealed_score(
        self,
        x: jax.Array,
        y: jax.Array,
        sigma: jax.Array | float,
        path: str = "convolved",
        published: bool = False,
        perturbation: str = "gaussian",
        clean: jax.Array | None = None,
    ) -> jax.Array:
        """Score of log p(y | x~ = x) at annealing level `sigma`; shaped as the object.

        H^H applied to the score of each measurement. "convolved": of its Poisson counts, exact at
        every level if H H^H is diagonal, and at sigma = 0 for any H (quantisation apart; read noise
        counts as photon noise of equal variance). "split": the paper's Rician score, in which
        sqrt(y) has the variance sigma_0^2/4 - sigma^2 ||h_i||^2/4 per component; it is up to twice
        too sure where a few electrons are counted. A saturated pixel counts as "at least
        this", with Gaussian noise. Where H H^H is not diagonal, the correlation of the annealing
        errors is neglected. A background is shared out by `annealing.signal_count` ("convolved"),
        or taken from y and its noise kept ("split"). `clean` is not used.
        `published=True`: eq:complex_final as printed, for complex objects along "split".
        """
        if perturbation != "gaussian":
            raise ValueError(
                f"perturbation {perturbation!r}: intensities of a field need a prior with the "
                "gaussian perturbation"
            )
        field = self._field(x)
        noise, gain = self._amplitude_noise(y, jnp.iscomplexobj(x))
        if published:
            return self._published_score(field, x, y, sigma, path)
        if path == "convolved" and self.camera.counting:
            score = self._counted_score(field, y, gain * sigma**2)
        else:
            variance = annealing.remaining_variance(noise, gain * sigma**2, path)
            score = annealing.intensity_score(field, self._signal(y), variance)
        score = self._where_saturated(score, field, y, noise, gain * sigma**2, path)
        return self._to_object((score * jnp.sqrt(self.irradiance)).astype(field.dtype), x)

    def _counted_score(self, field: jax.Array, y: jax.Array, error: jax.Array) -> jax.Array:
        noise = self._root_noise(y, self.camera.read_variance)
        if self.background is not None:
            y = annealing.signal_count(field, y, noise, error, self.background)
        return annealing.counted_intensity_score(field, y, noise, error)

    def _where_saturated(
        self,
        score: jax.Array,
        field: jax.Array,
        y: jax.Array,
        noise: jax.Array,
        error: jax.Array,
        path: str,
    ) -> jax.Array:
        edge = self.camera.saturation
        if not math.isfinite(edge):
            return score
        variance = annealing.remaining_variance(noise, error, path)
        amplitude = jnp.abs(field)
        outwards = field / jnp.maximum(amplitude, jnp.finfo(amplitude.dtype).tiny)
        edge_amplitude = jnp.sqrt(jnp.maximum(self._signal(edge), 0))
        saturated = annealing.saturated_score(amplitude, edge_amplitude, variance)
        return jnp.where(y > edge, outwards * saturated, score)

    def _published_score(
        self, field: jax.Array, x: jax.Array, y: jax.Array, sigma: jax.Array | float, path: str
    ) -> jax.Array:
        if path != "split" or not jnp.iscomplexobj(x):
            raise ValueError("published=True is the paper's form: complex objects, path='split'")
        noise, gain = self._amplitude_noise(y, True)
        variance = 4 * annealing.remaining_variance(noise, gain * sigma**2, path)
        weighted = annealing.published_intensity_score(field, self._signal(y), variance)
        return self._to_object((weighted * jnp.sqrt(self.irradiance)).astype(field.dtype), x)

    def noise(self, x_complex: bool, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Variance of the amplitude sqrt(y - background), and the annealing gain of the field."""
        return self._amplitude_noise(y, x_complex)

    def _field(self, x: jax.Array) -> jax.Array:
        field = self.optics(x)
        return field * jnp.sqrt(self.irradiance).astype(field.real.dtype)

    def _signal(self, y: jax.Array) -> jax.Array:
        return y if self.background is None else y - self.background

    def _amplitude_noise(self, y: jax.Array, x_complex: bool) -> tuple[jax.Array, jax.Array]:
        dark = self.camera.read_variance
        if self.background is not None:
            dark = dark + self.camera.sigma0**2 * self.background
        gain = self.irradiance * _annealing_gain(self.optics, x_complex)
        return self._root_noise(self._signal(y), dark), gain

    def _root_noise(self, y: jax.Array, dark: jax.Array | float) -> jax.Array:
        # sd(sqrt(y)) = sd(y)/(2 sqrt(y)): photon noise gives sigma_0/2 at every brightness.
        # That is first order in the noise; in the dark the noise itself sets the level.
        floor = jnp.maximum(self.camera.sigma0**2, jnp.sqrt(dark))
        level = jnp.maximum(y, floor)
        return (self.camera.sigma0**2 + dark / level) / 4

    @property
    def _field_gain(self) -> jax.Array:
        return jnp.sqrt(jnp.max(self.irradiance))


def _annealing_gain(optics: Optics, x_complex: bool) -> jax.Array:
    """Variance per real component of each measurement for an annealing error of sigma = 1.

    A complex object's error has variance 1/4 in Re and in Im, and so has h_i e / ||h_i||. A real
    object's error of variance 1 is shared by Re and Im of a complex field (equally on average:
    an approximation), and goes whole into a real one.
    """
    power = optics.row_norms() ** 2
    if x_complex:
        return power / 4
    return power if optics.real else power / 2


def _check_parts(optics: Optics, camera: Camera) -> None:
    if not isinstance(optics, Optics):
        raise ValueError(f"optics is a {type(optics).__name__}: give an operator of models.optics")
    if not isinstance(camera, Camera):
        raise ValueError(f"camera is a {type(camera).__name__}: give a camera of models.camera")


def _checked_background(background: float | np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    background = np.asarray(background, dtype=float)
    if not np.all(np.isfinite(background) & (background >= 0)):
        raise ValueError(f"background {background.min():.3g}: it must be finite, and 0 or more")
    try:
        fits = np.broadcast_shapes(background.shape, shape) == shape
    except ValueError:
        fits = False
    if not fits:
        raise ValueError(
            f"background of shape {background.shape} for data of shape {shape}: give one number, "
            "or what broadcasts to them"
        )
    return background
