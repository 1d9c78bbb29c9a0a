"""Three applications, ready to ask: denoising, phase retrieval, Fourier ptychography.

Each takes a picture of the object, which a simulated camera records, or a recording, and gives the
`Problem`, the data and, if it is known, the truth. The prior is a Gaussian field fitted to pictures
of other things, or a network that was trained on them. At the end, the samplers by name.
"""

import hashlib
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
from skimage import data as pictures

from .estimators import calibrate
from .images import fit_to, read_picture, to_grey, to_unit_range
from .models.annealing import component_sd
from .models.camera import Poisson
from .models.likelihood import IntensityLikelihood, LinearLikelihood
from .models.optics import Fourier, FourierPtychography, Identity, Optics
from .models.priors import EnergyPrior, GaussianField, Prior, ScorePrior
from .models.priors.learned import LearnedPrior
from .models.priors.storage import card_of, shipped, shipped_names
from .problem import Posterior, Problem
from .samplers import (
    DPS,
    MALA,
    ULA,
    AnnealedLangevin,
    BlackJAX,
    Ensemble,
    Kawar,
    Sampler,
    SplitGibbs,
    TemperedSMC,
    Thickening,
)
from .stacks import Stack, dispersed, grid, in_electrons, least_upsampling
from .starts import annealed, from_magnitudes, from_quasi_newton, has_magnitudes

DENOISING, PHASE_RETRIEVAL, PTYCHOGRAPHY = "denoising", "phase-retrieval", "ptychography"

# Those that scikit-image carries in itself, and reads without a download.
PRIOR_PICTURES = ("astronaut", "brick", "camera", "cell", "chelsea", "coffee") + (
    "coins", "grass", "gravel", "moon", "rocket",
)  # fmt: skip

_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy", ".npz")
_GRID = 7
_PITCH = 0.64  # of the pupil's radius: neighbouring pupils share 60 % of their area
_HEADROOM = 4  # standard deviations of photon noise below the full well
_LEAST_SIDE = 4
_LEAST_FIT = 8  # the smallest picture a spectrum is fitted to
_SAME_PICTURE = 0.99  # correlation


class Application(NamedTuple):
    """What an application takes where the user says nothing; `size` in pixels, 0 bits: no ADC."""

    size: int
    full_well: int
    bits: int
    sampler: str


APPLICATIONS = {
    DENOISING: Application(128, 100, 8, "mala"),
    PHASE_RETRIEVAL: Application(64, 1_000_000, 16, "mala"),
    PTYCHOGRAPHY: Application(64, 1000, 10, "mala"),
}


class Question(NamedTuple):
    """A problem and its recording `y`; `truth` is the object, where it is known.

    `irradiance` is None for denoising and measured stacks; `prior` names the pictures that the
    prior was fitted to, each with the SHA-256 of what was fitted; `microscope` is what the images
    of a measured stack told of theirs, None otherwise.
    """

    problem: Problem
    y: np.ndarray
    truth: np.ndarray | None
    irradiance: float | None
    prior: dict[str, str]
    microscope: dict[str, Any] | None = None


# ---- from a picture, or from a recording ---------------------------------------------------------


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
    needs: str = "score",
) -> Question:
    """Record the object in `picture` with a simulated camera.

    `picture` is an array as `read_picture` gives it; for ptychography a complex one is the object
    itself, and a grey one becomes one by `complex_object`. `size` None: the application's own, or
    the picture's if that is smaller. `prior`: a picture or a folder of them, None for those of
    scikit-image; or the name of trained weights ("nuclei"), or a .safetensors file. `needs`: what
    the sampler needs of trained weights (`Sampling`). `irradiance` None: the brightest expected
    pixel just meets the full well, with four standard deviations of its photon noise to spare.
    Raises ValueError on what does not fit.
    """
    truth = _object(name, picture, size)
    optics = _optics(name, truth.shape, oversampling)
    known, names = _prior(name, truth.shape, prior, truth, needs)
    x = jnp.asarray(truth, known.dtype)
    if irradiance is None and name != DENOISING:
        irradiance = _full_exposure(float(jnp.max(jnp.abs(optics(x)) ** 2)), camera)
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
    needs: str = "score",
) -> Question:
    """Take a recording: integer codes of the ADC, or floats in electrons / full well.

    Denoising: (h, w). Phase retrieval: (r h, r w), r the oversampling, zero frequency at index 0.
    Ptychography: (49, n, n), the grid of `aperture_grid` row by row; `size` is the object's.
    `irradiance` None: from the energy in the data and that of the prior; for phase retrieval
    sum(y) / (pixels (mean^2 + variance)), by Parseval. Raises ValueError on what does not fit.
    """
    y = _normalised(data, camera)
    optics = _optics(name, _object_shape(name, y, size, oversampling), oversampling)
    camera.check(y)
    known, names = _prior(name, optics.in_shape, prior, None, needs)
    if irradiance is None and name != DENOISING:
        irradiance = _irradiance_of(y, optics, known)
    return Question(_problem(optics, camera, known, irradiance), y, None, irradiance, names)


def measured(
    stack: Stack,
    key: jax.Array,
    *,
    electrons: float | None = None,
    prior: str | None = None,
    needs: str = "score",
    progress: bool = False,
) -> Question:
    """A stack of Fourier ptychography, from the microscope whose numbers it holds.

    Electrons are counted by the noise of the images (`stacks.in_electrons`) unless given, those a
    unit of intensity, and the microscope is calibrated on them (`estimators.calibrate`), some
    minutes for hundreds of LEDs. What photon noise leaves unexplained then, is taken for more of it
    (`stacks.dispersed`, with `key`). The object has as many pixels as the band of the LEDs needs, a
    rim around the field of view, and the prior's mean energy. `prior` and `needs` are as for
    `simulate`. Raises ValueError on what does not fit.

    Approximation: what is unexplained is independent from pixel to pixel, as photons are.
    """
    counts = in_electrons(stack, electrons)
    upsampling = least_upsampling(stack)
    shape = tuple(upsampling * n for n in grid(stack).shape)
    known, names = _prior(PTYCHOGRAPHY, shape, prior, None, needs)
    found = calibrate(counts, upsampling, progress=progress)
    o = found.object * prior_scale(found.object, known)
    fewer = dispersed(counts, found.dispersion, key)
    likelihood, y = found.calibration.likelihood(fewer, upsampling, o)
    microscope = {
        "electrons": (
            counts.intensity.sum(axis=(1, 2)) / stack.intensity.sum(axis=(1, 2))
        ).tolist(),
        "dispersion": found.dispersion.tolist(),
        "leds": found.calibration.leds.tolist(),
        "aberration": found.calibration.aberration.tolist(),
    }
    return Question(Problem(likelihood, known), y, None, None, names, microscope)


def prior_scale(o: np.ndarray, prior: GaussianField | LearnedPrior) -> float:
    """By what to multiply an object (*shape), so that its energy is the mean of the prior's."""
    return (_mean_energy(prior) / float(np.sum(np.abs(o) ** 2, dtype=float))) ** 0.5


def _problem(optics: Optics, camera: Poisson, prior: Prior, irradiance: float | None) -> Problem:
    if not isinstance(optics, Identity):
        return Problem(IntensityLikelihood(optics, camera, irradiance), prior)
    if irradiance is not None:
        raise ValueError(f"irradiance {irradiance}: {DENOISING} has none, leave it out")
    return Problem(LinearLikelihood(optics, camera), prior)


# ---- the object ----------------------------------------------------------------------------------


def complex_object(grey: np.ndarray) -> np.ndarray:
    """A thin specimen from a grey picture p in 0..1: amplitude 0.3 + 0.7 p, phase of its mirror.

    phase = pi/2 (p mirrored left-right - 1/2), from -pi/4 to pi/4.
    """
    phase = np.pi / 2 * (grey[:, ::-1] - 0.5)
    return (0.3 + 0.7 * grey) * np.exp(1j * phase)


def _object(name: str, picture: np.ndarray, size: int | None) -> np.ndarray:
    if size is not None and size < _LEAST_SIDE:
        raise ValueError(f"size {size}: give {_LEAST_SIDE} or more")
    if not np.iscomplexobj(picture):
        return _object_of_grey(name, to_grey(to_unit_range(picture)), size)
    if name != PTYCHOGRAPHY:
        raise ValueError(f"the picture is complex: {name} is of real objects, save its modulus")
    if picture.ndim != 2:
        raise ValueError(f"a complex object of shape {picture.shape}: give (height, width)")
    return picture if size is None else fit_to(picture, size)


def _object_of_grey(name: str, grey: np.ndarray, size: int | None) -> np.ndarray:
    if grey.min() == grey.max():
        raise ValueError(f"the picture has the value {grey.max():.3g} everywhere: give another")
    grey = fit_to(grey, min(APPLICATIONS[name].size, *grey.shape) if size is None else size)
    return complex_object(grey) if name == PTYCHOGRAPHY else grey


# ---- the recording -------------------------------------------------------------------------------


def _normalised(data: np.ndarray, camera: Poisson) -> np.ndarray:
    if data.dtype == bool:
        data = data.astype(np.uint8)
    if not np.issubdtype(data.dtype, np.integer):
        return data
    if camera.bits is None:
        raise ValueError(f"the recording holds {data.dtype} codes: say how many bits with --bits")
    return np.asarray(camera.from_codes(data))


def _object_shape(
    name: str, y: np.ndarray, size: int | None, oversampling: int | None
) -> tuple[int, int]:
    if name == PTYCHOGRAPHY:
        return _shape_from_stack(y, size)
    if size is not None:
        raise ValueError(f"size {size}: a recording has its own size, leave out --size")
    if y.ndim != 2:
        raise ValueError(f"a recording of shape {y.shape}: give (height, width), one grey page")
    if min(y.shape) < _LEAST_SIDE:
        raise ValueError(f"a recording of shape {y.shape}: give {_LEAST_SIDE} pixels a side")
    if name == DENOISING:
        return y.shape
    factor = oversampling or 2
    if any(n % factor for n in y.shape):
        raise ValueError(f"a recording of shape {y.shape}: oversampling {factor} must divide it")
    _refuse_centred(y)
    return tuple(n // factor for n in y.shape)


def _refuse_centred(y: np.ndarray) -> None:
    brightest = tuple(int(i) for i in np.unravel_index(np.argmax(y), y.shape))
    if all(n / 4 < i < 3 * n / 4 for i, n in zip(brightest, y.shape)):
        raise ValueError(
            f"the brightest pixel is at {brightest}, in the middle: bring the zero frequency to "
            "index 0 with numpy.fft.ifftshift"
        )


def _shape_from_stack(y: np.ndarray, size: int | None) -> tuple[int, int]:
    if y.ndim != 3 or len(y) != _GRID**2 or y.shape[1] != y.shape[2]:
        raise ValueError(
            f"a recording of shape {y.shape}: give ({_GRID**2}, n, n), one square page a LED"
        )
    low = y.shape[1]
    size = 4 * low if size is None else size
    if size != _upsampling(size) * low:
        raise ValueError(
            f"size {size} from pages of {low}x{low}: the object is 4 times as wide, or twice if "
            "that is under 64; give --size"
        )
    return size, size


def picture_of(name: str, y: np.ndarray) -> tuple[np.ndarray, str]:
    """A recording (h, w) to look at, and its heading: logarithm, or mosaic of amplitudes."""
    if name == PHASE_RETRIEVAL:
        faintest = np.min(y[y > 0], initial=1.0)
        return np.log10(np.maximum(np.fft.fftshift(y), faintest)), "recording (log)"
    if name == PTYCHOGRAPHY:
        side = min(_GRID, math.isqrt(len(y)))
        rows = np.sqrt(y[: side**2]).reshape(side, side, *y.shape[1:])
        # Every LED on its own scale: the outer ones are dark fields.
        rows = rows / np.maximum(rows.max(axis=(2, 3), keepdims=True), 1e-12)
        framed = np.pad(rows, ((0, 0), (0, 0), (0, 1), (0, 1)), constant_values=1.0)
        shown = np.block([list(row) for row in framed])[:-1, :-1]
        return shown, f"recordings, {side}x{side} of {len(y)} LEDs"
    return y, "recording"


# ---- optics and exposure -------------------------------------------------------------------------


def aperture_grid(size: int) -> tuple[np.ndarray, float]:
    """Centres (49, 2) and radius, in Fourier samples, of the largest synthetic aperture.

    A 7x7 grid of pupils whose neighbours share about 60 % of their area, inside the band of an
    object of `size` and of its camera (upsampling 4; 2 under 64). Raises ValueError for a size that
    is too small, or that the upsampling does not divide.
    """
    upsampling = _upsampling(size)
    if size < 16 or size % upsampling:
        raise ValueError(f"size {size}: {PTYCHOGRAPHY} needs a multiple of {upsampling}, from 16")
    reach = _GRID // 2
    largest = min((size // 2 - 1) / (1 + reach * _PITCH), size / upsampling / 2 - 0.1)
    pitch = max(1, math.floor(_PITCH * largest))
    offsets = pitch * (np.arange(_GRID) - reach)
    centres = np.stack(np.meshgrid(offsets, offsets, indexing="ij"), -1).reshape(-1, 2)
    return centres, pitch / _PITCH


def _upsampling(size: int) -> int:
    return 4 if size >= 64 else 2


def _optics(name: str, shape: tuple[int, int], oversampling: int | None) -> Optics:
    if oversampling is not None and name != PHASE_RETRIEVAL:
        raise ValueError(f"oversampling {oversampling} is for {PHASE_RETRIEVAL}: leave it out")
    if name == DENOISING:
        return Identity(shape)
    if name == PHASE_RETRIEVAL:
        return Fourier(shape, oversampling=2 if oversampling is None else oversampling)
    if shape[0] != shape[1]:
        raise ValueError(f"an object of shape {shape}: {PTYCHOGRAPHY} needs a square, give --size")
    centres, radius = aperture_grid(shape[0])
    return FourierPtychography.from_radius(shape, centres, radius, _upsampling(shape[0]))


def _full_exposure(brightest: float, camera: Poisson) -> float:
    """Irradiance at which the brightest pixel (at irradiance 1) is expected just below full."""
    # e + k sigma0 sqrt(e) = 1 is quadratic in sqrt(e).
    half = _HEADROOM * camera.sigma0 / 2
    return (math.sqrt(half**2 + 1) - half) ** 2 / brightest


def _irradiance_of(y: np.ndarray, optics: Optics, prior: Prior) -> float:
    """The energy of the data over the energy expected of the prior at irradiance 1."""
    total = float(np.sum(y, dtype=float))
    if total <= 0:
        raise ValueError("the recording is dark everywhere: there is nothing to reconstruct from")
    if isinstance(optics, Fourier) and isinstance(prior, GaussianField | LearnedPrior):
        return total / _mean_energy(prior)
    draws = jax.vmap(prior.sample)(jax.random.split(jax.random.key(0), 64))
    energy = jnp.sum(jnp.abs(jax.vmap(optics)(draws)) ** 2) / len(draws)
    return total / float(energy)


def _mean_energy(prior: GaussianField | LearnedPrior) -> float:
    """Expected sum of |object|^2."""
    channels = 2 if prior.complex_valued else 1
    if isinstance(prior, LearnedPrior):
        per_pixel = channels * (prior.statistics.mean**2 + prior.statistics.sd**2)
        return math.prod(prior.shape) * per_pixel
    return float(jnp.sum(jnp.abs(prior.mean) ** 2 + channels * prior.scale**2))


# ---- the prior -----------------------------------------------------------------------------------


def is_trained(prior: str | None) -> bool:
    """Whether `prior` names trained weights and not pictures."""
    return prior is not None and (prior in shipped_names() or prior.endswith(".safetensors"))


def _prior(
    name: str,
    shape: tuple[int, int],
    prior: str | None,
    truth: np.ndarray | None,
    needs: str,
) -> tuple[Prior, dict[str, str]]:
    """The prior that is asked for, and what it was made from, with hashes."""
    if not is_trained(prior):
        return _fitted_prior(name, shape, prior, truth)
    card = weights_card(prior, needs)
    kind = EnergyPrior if card["kind"] == "energy" else ScorePrior
    dtype = complex if name == PTYCHOGRAPHY else float
    found = kind.load(prior, shape, card["statistics"]["perturbation"], dtype)
    return found, {Path(prior).name: card["sha256"]}


# What a sampler needs, and the kind and perturbation of the weights that have it.
_NEEDS = {"score": "score", "density": "density", "counts": "denoiser of counts"}
_WEIGHTS = {
    "score": ("score", "gaussian"),
    "density": ("energy", "gaussian"),
    "counts": ("score", "poisson"),
}


def weights_card(prior: str, needs: str) -> dict[str, Any]:
    """The model card of trained weights; refuses those that have not what a sampler needs."""
    kind, perturbation = _WEIGHTS[needs]
    if f"{prior}-{perturbation}-{kind}" in shipped():
        return card_of(prior, kind, perturbation)
    card = card_of(prior)
    found = card["kind"], card["statistics"]["perturbation"]
    has = [need for need, weights in _WEIGHTS.items() if weights == found]
    has += ["score"] if "density" in has else []
    if needs not in has:
        fit = [name for name, sampling in SAMPLERS.items() if sampling.needs in has]
        remedy = f"use --sampler {' or '.join(fit)}, or " if fit else ""
        raise ValueError(
            f"{Path(prior).name} has kind {found[0]} and perturbation {found[1]}, and the sampler "
            f"needs a {_NEEDS[needs]}: {remedy}give weights trained with --kind {kind} "
            f"--perturbation {perturbation}"
        )
    return card


def best_sampler(name: str, prior: str | None) -> str:
    """The sampler of an application where none is asked for."""
    if not is_trained(prior):
        return APPLICATIONS[name].sampler
    counts = f"{prior}-poisson-score" in shipped() or (
        prior not in shipped_names() and card_of(prior)["statistics"]["perturbation"] == "poisson"
    )
    return "thickening" if counts and name == DENOISING else "annealed"


def _fitted_prior(
    name: str, shape: tuple[int, int], path: str | None, truth: np.ndarray | None
) -> tuple[GaussianField, dict[str, str]]:
    """A Gaussian field fitted to pictures, the truth itself left out; their names and hashes."""
    found = _shipped_pictures() if path is None else _pictures_at(path)
    side = max(*shape, _LEAST_FIT)
    objects = {}
    for label, picture in found.items():
        fitted = _prior_object(name, label, picture, side)
        if truth is None or not _same_picture(fitted, truth):
            objects[label] = fitted
    if not objects:
        raise ValueError(f"{path} holds only the picture that is asked for: give a prior of others")
    kind = complex if name == PTYCHOGRAPHY else float
    field = GaussianField.fit(list(objects.values()), shape, kind)
    return field, {k: hashlib.sha256(v.tobytes()).hexdigest() for k, v in objects.items()}


def _shipped_pictures() -> dict[str, np.ndarray]:
    return {name: getattr(pictures, name)() for name in PRIOR_PICTURES}


def _pictures_at(path: str) -> dict[str, np.ndarray]:
    folder = Path(path)
    if not folder.is_dir():
        return {folder.name: read_picture(path)}
    files = sorted(f for f in folder.iterdir() if f.suffix.lower() in _SUFFIXES)
    if not files:
        raise ValueError(f"prior {path} holds no pictures: give PNG, JPEG, TIFF, NPY or NPZ files")
    return {f.name: read_picture(f) for f in files}


def _prior_object(name: str, label: str, picture: np.ndarray, side: int) -> np.ndarray:
    """A prior picture brought to the scale of the object, and to its kind."""
    try:
        if not np.iscomplexobj(picture):
            picture = to_grey(to_unit_range(picture))
        elif name != PTYCHOGRAPHY:
            raise ValueError(f"it is complex: {name} is of real objects, save its modulus")
        fitted = fit_to(picture, min(side, *picture.shape))
    except ValueError as error:
        raise ValueError(f"prior picture {label}: {error}") from error
    compose = name == PTYCHOGRAPHY and not np.iscomplexobj(fitted)
    return complex_object(fitted) if compose else fitted


def _same_picture(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the two differ by brightness and contrast only, as objects or as amplitudes."""
    side = min(*a.shape, *b.shape)
    a, b = fit_to(a, side), fit_to(b, side)
    return any(_correlation(f(a), f(b)) > _SAME_PICTURE for f in (np.asarray, np.abs))


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    norm = np.linalg.norm(a) * np.linalg.norm(b)
    return float(np.abs(np.vdot(a, b)) / norm) if norm > 0 else 0.0


# ---- samplers by name ----------------------------------------------------------------------------


class Sampling(NamedTuple):
    """How a named sampler is built for a posterior, and how much it draws if nothing is said.

    `needs`, of the prior: its "density", its "score" alone, or the denoiser of "counts".
    """

    build: Callable[[Posterior], Sampler]
    draws: int
    thin: int
    needs: str = "density"


def _ula(posterior: Posterior) -> ULA:
    # A fifth of the stiffest variance: the step's own bias is then 10 % of it at most.
    complex_object = jnp.issubdtype(posterior.dtype, jnp.complexfloating)
    data = posterior.likelihood.curvature(complex_object, posterior.y, 0.0, "convolved")
    return ULA(step_size=0.2 / float(jnp.max(data) + _stiffest(posterior.prior)))


def _stiffest(prior: Prior) -> jax.Array | float:
    """Largest curvature of the log-density, which a learned prior's finest level bounds."""
    if isinstance(prior, GaussianField):
        return jnp.max(1 / prior.power)
    return 1 / component_sd(prior.finest, prior.complex_valued) ** 2


_ANNEALED = {"levels": 200, "steps": 5}


def learned_annealing(posterior: Posterior, path: str = "convolved") -> AnnealedLangevin:
    """Annealing for score networks, with settings chosen on held-out pictures.

    It ends in a descent by the prior: for a picture itself from twice the network's finest level,
    for an object behind a field from where its annealing error is 0.4 of the noise. There it begins
    where a start is not forgotten, but its errors are: far-field magnitudes at half the sd of a
    channel, other fields at 15 times the noise, for in the lowest frequencies quasi-Newton is that
    far off: 12 of 16384 held 76 % of its draws' error at sigma_0 = 0.2.
    """
    prior, steps = posterior.prior, {"steps": 4, "path": path, "descent": 6}
    if isinstance(posterior.likelihood, LinearLikelihood):
        return AnnealedLangevin(levels=45, sigma_min=2 * prior.finest, **steps)
    noise = float(posterior.data_level())
    finest = max(0.4 * noise, prior.finest)
    if has_magnitudes(posterior.likelihood.optics):
        broadest = float(prior.scale) / 2
    else:
        broadest = min(max(float(prior.scale), 15 * noise), prior.statistics.sigma_max)
    return AnnealedLangevin(levels=60, sigma_max=max(broadest, finest), sigma_min=finest, **steps)


def _annealed_sampler(posterior: Posterior, path: str = "convolved") -> AnnealedLangevin:
    if isinstance(posterior.prior, ScorePrior):
        return learned_annealing(posterior, path)
    return AnnealedLangevin(**_ANNEALED, path=path, polish=200)


SAMPLERS = {
    "mala": Sampling(lambda _: MALA(), 500, 25),
    "annealed": Sampling(_annealed_sampler, 25, 1, needs="score"),
    "annealed-split": Sampling(partial(_annealed_sampler, path="split"), 25, 1, needs="score"),
    "ula": Sampling(_ula, 500, 10, needs="score"),
    "split-gibbs": Sampling(lambda _: SplitGibbs(), 25, 1, needs="score"),
    "dps": Sampling(lambda _: DPS(), 25, 1, needs="score"),
    "kawar": Sampling(lambda _: Kawar(), 25, 1, needs="score"),
    "thickening": Sampling(lambda _: Thickening(), 25, 1, needs="counts"),
    "nuts": Sampling(lambda _: BlackJAX(blackjax.nuts), 250, 1),
    "smc": Sampling(lambda _: TemperedSMC(), 250, 1),
    "ensemble": Sampling(lambda _: Ensemble(), 4000, 1),
}


def start_of(
    sampler: str,
    posterior: Posterior,
    key: jax.Array,
    chains: int,
    progress: bool = False,
    measured: bool = False,
) -> np.ndarray | None:
    """Where the chains of a named sampler start, (chains, *shape); None: at its own choice.

    From intensities of a field, a chain that starts at random stays in the wrong valley, so each
    starts at the end of an annealing run of its own; behind a Fourier transform, of the best of
    several, which start from hybrid input-output. Under a learned prior ptychography starts from
    quasi-Newton, a `measured` stack from halves of itself. "split" cannot travel at all.
    """
    magnitudes = has_magnitudes(posterior.likelihood.optics)
    if isinstance(posterior.likelihood, LinearLikelihood):
        return np.stack([posterior.y] * chains) if sampler == "annealed-split" else None
    if isinstance(posterior.prior, LearnedPrior):
        if not magnitudes:
            return from_quasi_newton(posterior, key, chains, measured, progress)
        return from_magnitudes(posterior, learned_annealing(posterior), key, chains, progress)
    if sampler not in ("mala", "ula", "nuts", "annealed-split"):
        return None
    search = from_magnitudes if magnitudes else annealed
    return search(posterior, AnnealedLangevin(**_ANNEALED), key, chains, progress=progress)
