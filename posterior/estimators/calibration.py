"""Self-calibration of a ptychographic microscope: object, pupil and LEDs from one stack.

The numbers of a microscope are never quite right, and a likelihood that believes them is sure of
the wrong object. What the images tell of them is fitted together with the object, by quasi-Newton
on the likelihood of Poisson counts: the aberrations of the pupil, the place, spacing and turn of
the LED array, and the brightness of each LED (Eckert, Phillips and Waller, Applied Optics 57, 5434,
2018, and Yeh et al., Optics Express 23, 33214, 2015, do so one after the other).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from rich.progress import track

from ..models.camera import Poisson
from ..models.likelihood import IntensityLikelihood
from ..models.optics import FourierPtychography
from ..models.pupil import pupils
from ..models.realview import from_real, to_real
from ..stacks import Stack, grid
from .quasi_newton import default_start, minimised

_MISPLACED = 4  # parameters of `Calibration.leds`
_ABERRATIONS = 19  # to the second spherical one
# Samples at the outermost LED, and radians, that change the images as much as the first steps on
# the object do: with units ten times as large quasi-Newton goes astray, or takes ten times as long.
_LED_UNIT, _ABERRATION_UNIT = 0.01, 0.005
_HISTORY = 20
_FAINT = 0.05  # electrons: light that no model is sure to lack


class Calibration(NamedTuple):
    """What a stack tells of its microscope.

    - `leds`: (4,) shift of the LED array (row, column) in Fourier samples of `stacks.grid`, its
      magnification less 1, and its turn in radians, from the columns to the rows.
    - `aberration`: radians, as in models/pupil.py.
    """

    leds: np.ndarray
    aberration: np.ndarray

    def optics(self, stack: Stack, upsampling: int) -> FourierPtychography:
        """The optics of the LEDs of a stack, each centre where it is, not at a whole sample."""
        low, rim, radii, nominal = grid(stack)
        places = np.asarray(_moved(nominal, self.leds))
        whole = np.rint(places).astype(int)
        pupil = pupils(low, radii, places - whole, self.aberration)
        shape = tuple(upsampling * n for n in low)
        return FourierPtychography(shape, whole, np.asarray(pupil), rim)

    def likelihood(
        self, stack: Stack, upsampling: int, o: np.ndarray
    ) -> tuple[IntensityLikelihood, np.ndarray]:
        """The likelihood of a stack of electrons, and its recording.

        Each LED is as bright as makes the expected electrons of its image, with the object `o`,
        those that were counted. The full well is one electron above the brightest pixel.
        """
        full_well = int(stack.intensity.max()) + 1
        optics = self.optics(stack, upsampling)
        light = np.abs(np.asarray(optics(jnp.asarray(o)), complex)) ** 2
        irradiance = _brightness(stack.intensity, light) / full_well
        likelihood = IntensityLikelihood(optics, Poisson(full_well), irradiance)
        return likelihood, stack.intensity / full_well


class Calibrated(NamedTuple):
    """A `calibration`, the object (complex) found with it, and the `dispersion` that they leave.

    For each LED, (M,): squared residuals over the variance of Poisson counts, sum over sum, for
    each degree of freedom; 1 where photon noise explains them, nan where there are no more pixels
    than degrees. Approximation: of those the object takes up two for each of its frequencies that
    reach the camera, the same share from every LED, and as many for the rim (measured with the
    right microscope: 1.03 to 1.09).
    """

    calibration: Calibration
    object: np.ndarray
    dispersion: np.ndarray


NOMINAL = Calibration(np.zeros(_MISPLACED), np.zeros(_ABERRATIONS))


def calibrate(
    stack: Stack,
    upsampling: int,
    start: Calibration = NOMINAL,
    *,
    rounds: int = 5,
    iterations: int = 60,
    progress: bool = True,
) -> Calibrated:
    """The calibration and the object under which a stack of electrons is most probable.

    - `stack`: whole electrons (`in_electrons`).
    - `upsampling`: object pixels for one of the camera, along an axis.
    - `start`: a defocus of many radians is not found from 0.
    - `rounds` of `iterations` steps of quasi-Newton, one compiled loop each. A turn of the LEDs
      converges last: of a simulated one a third is left after 5.

    The object has a mean amplitude of about 1; its brightness and that of the LEDs are not told
    apart. Raises ValueError for intensities that are no whole electrons, and LEDs that leave the
    band of the object.
    """
    counts = stack.intensity
    if (counts != np.rint(counts)).any():
        raise ValueError("the stack is not in whole electrons: use in_electrons first")
    scene = _Scene.of(stack, start, upsampling)
    microscope = np.concatenate([start.leds, start.aberration]) / _units(stack)
    o = to_real(_first_object(stack, scene.optics))
    v = jnp.concatenate([o, microscope.astype(o.dtype)])
    for _ in track(range(rounds), "calibration", disable=not progress):
        v = _fitted(scene, v, iterations)
    o, microscope = v[: len(o)], np.asarray(v[len(o) :], float) * _units(stack)
    found = Calibration(microscope[:_MISPLACED], microscope[_MISPLACED:])
    o = np.asarray(from_real(o, scene.optics.in_shape, complex))
    return Calibrated(found, o, _dispersion(stack, upsampling, found, o))


class _Scene(eqx.Module):
    """The images, and all of the microscope that is not fitted."""

    optics: FourierPtychography
    counts: jax.Array
    places: jax.Array
    radii: jax.Array
    units: jax.Array

    @classmethod
    def of(cls, stack: Stack, start: Calibration, upsampling: int) -> "_Scene":
        where = grid(stack)
        arrays = stack.intensity, where.places, where.radii, _units(stack)
        return cls(start.optics(stack, upsampling), *map(jnp.asarray, arrays))

    def cost(self, v: jax.Array) -> jax.Array:
        """Minus the log-likelihood of Poisson counts, less a constant, over its stiffest curvature.

        `v`: real view of the object, then the microscope, in units. Each LED has the brightness at
        which the likelihood is highest, in closed form.
        """
        o, microscope = v[: -len(self.units)], v[-len(self.units) :] * self.units
        leds, aberration = microscope[:_MISPLACED], microscope[_MISPLACED:]
        offsets = _moved(self.places, leds) - self.optics.centres
        pupil = pupils(self.optics.low_shape, self.radii, offsets, aberration)
        optics = eqx.tree_at(lambda optics: optics.pupil, self.optics, pupil)
        field = optics(from_real(o, optics.in_shape, complex))
        light = field.real**2 + field.imag**2
        expected = _brightness(self.counts, light) * light + _FAINT
        # The differences are small beside the sums, which float32 rounds.
        surprise = expected - self.counts * (1 + jnp.log(expected / (self.counts + _FAINT)))
        # An image of n electrons a pixel bends by about 4 n where the amplitude is about 1.
        return jnp.sum(surprise) / (4 * jnp.max(jnp.mean(self.counts, axis=(1, 2))))


def _brightness(counts: ArrayLike, light: ArrayLike) -> ArrayLike:
    """Of each LED (M, 1, 1), so that the expected electrons of its image are those counted."""
    return counts.sum(axis=(1, 2), keepdims=True) / light.sum(axis=(1, 2), keepdims=True)


def _dispersion(stack: Stack, upsampling: int, found: Calibration, o: np.ndarray) -> np.ndarray:
    likelihood, _ = found.likelihood(stack, upsampling, o)
    expected = np.asarray(likelihood.expected(jnp.asarray(o)), float) * likelihood.camera.full_well
    free = 1 - 2 * likelihood.optics.frequencies() / stack.intensity.size
    if free <= 0:
        return np.full(len(expected), np.nan)
    squares = np.sum((stack.intensity - expected) ** 2, axis=(1, 2))
    return squares / np.sum(expected, axis=(1, 2)) / free


@eqx.filter_jit
def _fitted(scene: _Scene, v: jax.Array, iterations: int) -> jax.Array:
    cost = jax.value_and_grad(scene.cost)
    return minimised(cost, v, iterations, tolerance=0.0, history=_HISTORY)[0]


def _units(stack: Stack) -> np.ndarray:
    """Of what the microscope is fitted in (parameters,)."""
    outermost = np.linalg.norm(grid(stack).places, axis=1).max()
    # A magnification or a turn of this moves the outermost LED by one unit.
    relative = _LED_UNIT / max(outermost, 1.0)
    return np.r_[_LED_UNIT, _LED_UNIT, relative, relative, [_ABERRATION_UNIT] * _ABERRATIONS]


def _first_object(stack: Stack, optics: FourierPtychography) -> jax.Array:
    """Of mean amplitude 1: the bright-field images, each LED as bright as the next."""
    relative = stack.intensity / stack.intensity.mean(axis=(1, 2), keepdims=True)
    full_well = relative.max() * (1 + 1e-6)
    likelihood = IntensityLikelihood(optics, Poisson(1), 1 / full_well)
    return default_start(likelihood, relative / full_well)


def _moved(places: jax.Array, leds: jax.Array) -> jax.Array:
    """Places (M, 2) after the shift, magnification and turn of `Calibration.leds`."""
    turned = jnp.stack([-places[:, 1], places[:, 0]], axis=1)
    return places * (1 + leds[2]) + leds[3] * turned + leds[:2]
