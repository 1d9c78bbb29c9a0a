"""From a picture or a recording to a question: problem, data, and the truth if it is known."""

import jax
import jax.numpy as jnp
import numpy as np

from ..estimators import calibrate
from ..estimators.calibration import NOMINAL
from ..models.camera import Poisson
from ..models.likelihood import IntensityLikelihood, LinearLikelihood
from ..models.optics import Identity, Optics
from ..models.priors import Prior
from ..problem import Problem
from ..stacks import Stack, dispersed, grid, in_electrons, least_upsampling
from .applications import DENOISING, PTYCHOGRAPHY, Question
from .colour import keeps_colour
from .exposure import full_exposure, irradiance_of, prior_scale
from .objects import object_of
from .optics import optics_of
from .prior import channels_of, of_complex_objects, prior_of
from .recordings import normalised, object_shape


def simulate(
    name: str,
    picture: np.ndarray,
    camera: Poisson,
    key: jax.Array,
    *,
    size: int | None = None,
    prior: str | None = None,
    irradiance: float | None = None,
    oversampling: int | None = None,
    leds: int | None = None,
    colour: str | None = None,
    needs: str = "annealed score",
) -> Question:
    """Record the object in `picture` with a simulated camera.

    `picture` is an array as `read_picture` gives it; for ptychography a complex one is the object
    itself, and a grey one becomes one by `complex_object`; for phase retrieval too, if the prior is
    of complex objects. Denoising takes (h, w, 3) under a prior in colour, and under a grey one as
    `colour` says: "planes", each channel by itself, or "luminance". `leds`: of simulated
    ptychography, a square grid of 9 to 225, None for 49. `size` None: the application's own, or
    the picture's if that is smaller. `prior`: a picture or a folder of them, None for those of
    scikit-image; or the name of trained weights ("nuclei"), or a .safetensors file. `needs`: what
    the sampler needs of trained weights (`Sampling`). `irradiance` None: the brightest expected
    pixel just meets the full well, with four standard deviations of its photon noise to spare.
    Raises ValueError on what does not fit.
    """
    in_colour = keeps_colour(name, picture, channels_of(prior, needs), colour)
    complex_valued = of_complex_objects(name, prior, needs, picture)
    truth = object_of(name, picture, size, complex_valued, in_colour)
    optics = optics_of(name, truth.shape, oversampling, leds)
    known, names = prior_of(name, truth.shape, prior, truth, needs, complex_valued)
    x = jnp.asarray(truth, known.dtype)
    if irradiance is None and name != DENOISING:
        irradiance = full_exposure(float(jnp.max(jnp.abs(optics(x)) ** 2)), camera)
    problem = _problem(optics, camera, known, irradiance)
    y = np.asarray(problem.likelihood.simulate(key, x))
    return Question(problem, y, truth, irradiance, names)


def record(
    name: str,
    data: np.ndarray,
    camera: Poisson,
    *,
    size: int | None = None,
    prior: str | None = None,
    irradiance: float | None = None,
    oversampling: int | None = None,
    leds: int | None = None,
    colour: str | None = None,
    needs: str = "annealed score",
) -> Question:
    """Take a recording: integer codes of the ADC, or floats in electrons / what the well holds.

    Denoising: (h, w), or (h, w, 3) in colour, under a grey prior by `colour="planes"`. Phase
    retrieval: (r h, r w), r the oversampling, zero frequency at index 0. Ptychography: (49, n, n),
    or another number of `leds`, the grid of `aperture_grid` row by row; `size` is the object's.
    `irradiance` None: from the energy in the data and that of the prior; for phase retrieval
    sum(y) / (pixels (mean^2 + variance)), by Parseval. Raises ValueError on what does not fit.
    """
    if colour == "luminance":
        raise ValueError("colour luminance: that of a recording is no count, say --colour planes")
    y = normalised(data, camera)
    in_colour = keeps_colour(name, y, channels_of(prior, needs), colour)
    shape = object_shape(name, y, size, oversampling, leds, in_colour)
    optics = optics_of(name, shape, oversampling, len(y) if name == PTYCHOGRAPHY else leds)
    camera.check(y)
    complex_valued = of_complex_objects(name, prior, needs)
    known, names = prior_of(name, optics.in_shape, prior, None, needs, complex_valued)
    if irradiance is None and name != DENOISING:
        irradiance = irradiance_of(y, optics, known)
    return Question(_problem(optics, camera, known, irradiance), y, None, irradiance, names)


def measured(
    stack: Stack,
    key: jax.Array,
    *,
    electrons: float | None = None,
    background: bool = False,
    prior: str | None = None,
    needs: str = "annealed score",
    progress: bool = False,
) -> Question:
    """A stack of Fourier ptychography, from the microscope whose numbers it holds.

    Electrons are counted by the noise of the images (`stacks.in_electrons`) unless given, those a
    unit of intensity, and the microscope is calibrated on them (`estimators.calibrate`), some
    minutes for hundreds of LEDs; with `background` for even light in each image too. What photon
    noise leaves unexplained then, is taken for more of it (`stacks.dispersed`, with `key`). The
    object has as many pixels as the band of the LEDs needs, a rim around the field of view, and the
    prior's mean energy. Chains under a learned prior are to start from `start_of(...,
    measured=True)`. `prior` and `needs` are as for `simulate`. Raises ValueError on what does not
    fit.

    Approximation: what is unexplained is independent from pixel to pixel, as photons are.
    """
    counts = in_electrons(stack, electrons)
    upsampling = least_upsampling(stack)
    shape = tuple(upsampling * n for n in grid(stack).shape)
    known, names = prior_of(PTYCHOGRAPHY, shape, prior, None, needs, True)
    start = NOMINAL._replace(background=background)
    found = calibrate(counts, upsampling, start, progress=progress)
    o = found.object * prior_scale(found.object, known)
    fewer = dispersed(counts, found.dispersion, key)
    likelihood, y = found.calibration.likelihood(fewer, upsampling, o)
    microscope = {
        "electrons": (
            counts.intensity.sum(axis=(1, 2)) / stack.intensity.sum(axis=(1, 2))
        ).tolist(),
        "dispersion": found.dispersion.tolist(),
        "background": found.background.tolist(),
        "leds": found.calibration.leds.tolist(),
        "aberration": found.calibration.aberration.tolist(),
    }
    return Question(Problem(likelihood, known), y, None, None, names, microscope)


def _problem(optics: Optics, camera: Poisson, prior: Prior, irradiance: float | None) -> Problem:
    if not isinstance(optics, Identity):
        return Problem(IntensityLikelihood(optics, camera, irradiance), prior)
    if irradiance is not None:
        raise ValueError(f"irradiance {irradiance}: {DENOISING} has none, leave it out")
    return Problem(LinearLikelihood(optics, camera), prior)
