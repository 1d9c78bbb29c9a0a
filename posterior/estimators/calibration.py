"""Self-calibration of a ptychographic microscope: object, pupil and LEDs from one stack.

The numbers of a microscope are never quite right, and a likelihood that believes them is sure of
the wrong object. What the images tell of them is fitted together with the object, by quasi-Newton
on the likelihood of Poisson counts: the aberrations of the pupil, the place, spacing and turn of
the LED array, the brightness of each LED, and the background of its image (Eckert, Phillips and
Waller, Applied Optics 57, 5434, 2018, and Yeh et al., Optics Express 23, 33214, 2015, do so one
after the other, without the background).

A background, stray light or an offset of the camera, adds one number to all pixels of an image, so
that of its Fourier coefficients only the zeroth knows of it. The brightness scales all of them, and
is told by the others: by how deep the structure is that the object gives this image, and that its
other images share. Where an image has no structure the two are one.
"""

import math
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
_FIRST_ROOT = 0.1  # a hundredth of an image; at 0 the slope vanishes
_HALVINGS = 40
_HISTORY = 20
_FAINT = 0.05  # electrons: light that no model is sure to lack


class Calibration(NamedTuple):
    """What a stack tells of its microscope.

    - `leds`: (4,) shift of the LED array (row, column) in Fourier samples of `stacks.grid`, its
      magnification less 1, and its turn in radians, from the columns to the rows.
    - `aberration`: radians, as in models/pupil.py.
    - `background`: whether an image may hold light that is even all over it.
    """

    leds: np.ndarray
    aberration: np.ndarray
    background: bool = False

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

        Each LED is as bright, and its image holds as much background, as makes the counts most
        probable with the object `o`. The full well is one electron above the brightest pixel.
        """
        full_well = int(stack.intensity.max()) + 1
        optics = self.optics(stack, upsampling)
        light = np.abs(np.asarray(optics(jnp.asarray(o)), complex)) ** 2
        share = _shares(stack.intensity, light)[:, None, None] if self.background else 0.0
        brightness, background = (e / full_well for e in _exposure(stack.intensity, light, share))
        background = background if self.background else None
        likelihood = IntensityLikelihood(optics, Poisson(full_well), brightness, background)
        return likelihood, stack.intensity / full_well


class Calibrated(NamedTuple):
    """A `calibration`, the object (complex) found with it, and what is left; (M,), one an LED.

    - `dispersion`: squared residuals over the variance of Poisson counts, sum over sum, for each
      degree of freedom; 1 where photon noise explains them, nan where there are no more pixels than
      degrees. Approximation: of those the object takes up two for each of its frequencies that
      reach the camera, the same share from every LED, and as many for the rim (measured with the
      right microscope: 1.03 to 1.09).
    - `background`: even light in the image, electrons a pixel.
    """

    calibration: Calibration
    object: np.ndarray
    dispersion: np.ndarray
    background: np.ndarray


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
    apart. Background is 0 or more, and none where `start` has none. Raises ValueError for
    intensities that are no whole electrons, and LEDs that leave the band of the object.
    """
    counts = stack.intensity
    if (counts != np.rint(counts)).any():
        raise ValueError("the stack is not in whole electrons: use in_electrons first")
    scene = _Scene.of(stack, start, upsampling)
    microscope = np.concatenate([start.leds, start.aberration]) / _units(stack)
    o = to_real(_first_object(stack, scene.optics))
    roots = np.full(len(counts) if start.background else 0, _FIRST_ROOT)
    v = jnp.concatenate([o, *(jnp.asarray(part, o.dtype) for part in (microscope, roots))])
    for _ in track(range(rounds), "calibration", disable=not progress):
        v = _fitted(scene, v, iterations)
    o, microscope, _ = scene.parts(v)
    leds, aberration = np.split(np.asarray(microscope, float) * _units(stack), [_MISPLACED])
    found = Calibration(leds, aberration, start.background)
    o = np.asarray(from_real(o, scene.optics.in_shape, complex))
    likelihood, _ = found.likelihood(stack, upsampling, o)
    background = np.zeros(len(counts))
    if start.background:
        background = np.ravel(likelihood.background) * likelihood.camera.full_well
    return Calibrated(found, o, _dispersion(counts, likelihood, o), background)


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

    def parts(self, v: jax.Array) -> list[jax.Array]:
        """Real view of the object, the microscope in units, and roots of the background, if any.

        A root r stands for the share r^2 / (1 + r^2) of an image: quasi-Newton knows no bounds.
        """
        size = 2 * math.prod(self.optics.in_shape)
        return jnp.split(v, [size, size + len(self.units)])

    def cost(self, v: jax.Array) -> jax.Array:
        """Minus the log-likelihood of Poisson counts, less a constant, over its stiffest curvature.

        `v`: as `parts` takes it apart. Each LED has the brightness at which the likelihood is
        highest, in closed form.
        """
        o, microscope, roots = self.parts(v)
        leds, aberration = jnp.split(microscope * self.units, [_MISPLACED])
        offsets = _moved(self.places, leds) - self.optics.centres
        pupil = pupils(self.optics.low_shape, self.radii, offsets, aberration)
        optics = eqx.tree_at(lambda optics: optics.pupil, self.optics, pupil)
        field = optics(from_real(o, optics.in_shape, complex))
        light = field.real**2 + field.imag**2
        share = (jnp.square(roots) / (1 + jnp.square(roots)))[:, None, None] if len(roots) else 0.0
        brightness, background = _exposure(self.counts, light, share)
        expected = brightness * light + background + _FAINT
        # The differences are small beside the sums, which float32 rounds.
        surprise = expected - self.counts * (1 + jnp.log(expected / (self.counts + _FAINT)))
        # An image of n electrons a pixel bends by about 4 n where the amplitude is about 1.
        return jnp.sum(surprise) / (4 * jnp.max(jnp.mean(self.counts, axis=(1, 2))))


def _exposure(counts: ArrayLike, light: ArrayLike, share: ArrayLike) -> tuple:
    """Brightness of each LED and background of its image, (M, 1, 1).

    The background is this share of the image; with the best brightness the expected electrons of
    an image are those counted, whatever the share.
    """
    mean = counts.mean(axis=(1, 2), keepdims=True)
    return (1 - share) * mean / light.mean(axis=(1, 2), keepdims=True), share * mean


def _shares(counts: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Of each image (M,), the share of even background that makes its counts most probable.

    The log-likelihood of a mixture is concave in its shares: its slope is brought to 0 by halving.
    """
    shape = light / light.mean(axis=(1, 2), keepdims=True)
    low, high = np.zeros(len(counts)), np.ones(len(counts))
    for _ in range(_HALVINGS):
        share = (low + high) / 2
        at = share[:, None, None]
        slope = np.sum(counts * (1 - shape) / ((1 - at) * shape + at), axis=(1, 2))
        low, high = np.where(slope > 0, share, low), np.where(slope > 0, high, share)
    return low


def _dispersion(counts: np.ndarray, likelihood: IntensityLikelihood, o: np.ndarray) -> np.ndarray:
    expected = np.asarray(likelihood.expected(jnp.asarray(o)), float) * likelihood.camera.full_well
    free = 1 - 2 * likelihood.optics.frequencies() / counts.size
    if free <= 0:
        return np.full(len(expected), np.nan)
    squares = np.sum((counts - expected) ** 2, axis=(1, 2))
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
