"""Simulated Fourier ptychography, the paper's section 4.4: its systems and ours."""

from typing import NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from ..models.camera import Poisson
from ..models.likelihood import IntensityLikelihood
from ..models.optics import FourierPtychography
from .denoising import electrons
from .ptychography_systems import PTYCHOGRAPHY_SYSTEMS, Recording

# LEDs of a square grid within this squared distance, in pitches, of its middle.
DISCS = {9: 2, 25: 8, 49: 16, 89: 26}
# At 128 pixels, in Fourier samples; smaller fields of view have as many fewer.
_SIDE, _PITCH, _RADIUS = 128, 9, 15.9
_UPSAMPLING = 4


class Condition(NamedTuple):
    """How many LEDs, and the noise sigma_0 at full light, as text."""

    leds: int
    sigma: str

    @property
    def name(self) -> str:
        """For people and for folders; `of` reads it."""
        return f"{self.leds} LEDs, sigma_0 {self.sigma}"

    @classmethod
    def of(cls, name: str) -> Self:
        """Of a name."""
        leds, sigma = name.split(" LEDs, sigma_0 ")
        return cls(int(leds), sigma)

    @property
    def camera_electrons(self) -> int:
        """Full well; raises ValueError for a noise that is none."""
        return electrons(self.sigma)


class Ptychography(NamedTuple):
    """The study: `truths` (n, side, side) complex, and how each is recorded and answered.

    A condition is the name of a `Condition`: a camera of 1/sigma_0^2 electrons, true Poisson
    counts, an ADC of `bits` (None: whole counts). The light is such that the brightest pixel of all
    images is expected just below the full well. Callable as the harness wants it.
    """

    truths: np.ndarray
    prior: str
    bits: int | None
    draws: int
    seed: int

    def __call__(self, system: str, condition: str, index: int) -> np.ndarray:
        answer = PTYCHOGRAPHY_SYSTEMS[system].answer(self.recording(condition, index))
        return np.asarray(answer)

    def recording(self, condition: str, index: int) -> Recording:
        """Of one truth: the same for every system, another for every condition and truth."""
        asked, truth = Condition.of(condition), jnp.asarray(self.truths[index])
        camera = Poisson(asked.camera_electrons, self.bits)
        key = jax.random.fold_in(jax.random.key(self.seed), index)
        key = jax.random.fold_in(jax.random.fold_in(key, camera.full_well), asked.leds)
        key_data, key_draws = jax.random.split(key)
        likelihood = microscope(truth, asked.leds, camera)
        y = likelihood.simulate(key_data, truth)
        return Recording(likelihood, y, self.prior, key_draws, self.draws)


def microscope(truth: jax.Array, leds: int, camera: Poisson) -> IntensityLikelihood:
    """What records the object `truth` (side, side) with the `leds` nearest to the axis."""
    optics = led_optics(len(truth), leds)
    brightest = float(jnp.max(jnp.abs(optics(truth)) ** 2))
    # Four standard deviations of photon noise to spare, to first order.
    return IntensityLikelihood(optics, camera, 1 / brightest / (1 + 4 * camera.sigma0))


def led_optics(side: int, leds: int) -> FourierPtychography:
    """The microscope of an object (side, side): camera images are a quarter as wide.

    A grid of LEDs whose pupils share about 60 % of their area with the next; 9 LEDs are all bright
    fields, 89 fill the band of the object but for its corners. Raises ValueError for another number
    of LEDs, and sides that are not 32, 64, 96 or 128.
    """
    if leds not in DISCS:
        raise ValueError(f"{leds} LEDs: use one of {', '.join(map(str, DISCS))}")
    if side not in range(32, _SIDE + 1, 32):
        raise ValueError(f"objects of {side} x {side}: give --size 32, 64, 96 or 128")
    grid = np.arange(-5, 6)
    places = np.stack(np.meshgrid(grid, grid, indexing="ij"), -1).reshape(-1, 2)
    inner = places[np.sum(places**2, axis=1) <= DISCS[leds]]
    pitch, radius = _PITCH * side // _SIDE, _RADIUS * side / _SIDE
    return FourierPtychography.from_radius((side, side), pitch * inner, radius, _UPSAMPLING)
