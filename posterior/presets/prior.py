"""The prior that is asked for: fitted to pictures, or trained weights."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from skimage import data as pictures

from ..images import fit_to, read_picture, to_grey, to_unit_range
from ..models.priors import EnergyPrior, GaussianField, Prior, ScorePrior
from ..models.priors.planes import by_planes
from ..models.priors.storage import card_of, shipped, shipped_names
from .applications import APPLICATIONS, DENOISING, PHASE_RETRIEVAL, PTYCHOGRAPHY
from .objects import complex_object, refuse_complex
from .samplers import SAMPLERS

# Those that scikit-image carries in itself, and reads without a download.
PRIOR_PICTURES = ("astronaut", "brick", "camera", "cell", "chelsea", "coffee") + (
    "coins", "grass", "gravel", "moon", "rocket",
)  # fmt: skip

_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy", ".npz")
_LEAST_FIT = 8  # the smallest picture a spectrum is fitted to
_SAME_PICTURE = 0.99  # correlation


def is_trained(prior: str | None) -> bool:
    """Whether `prior` names trained weights and not pictures."""
    return prior is not None and (is_shipped(prior) or prior.endswith(".safetensors"))


def is_shipped(prior: str | None) -> bool:
    """Whether weights of this name, short or whole, come with the project."""
    return prior in shipped_names() or prior in shipped()


def whole_path(name: str, prior: str | None, sampler: str | None) -> str | None:
    """The .safetensors file whose path `prior` begins, before ".safetensors", or before
    "-gaussian-score.safetensors" and the like if the sampler takes it; anything else as it is.

    Raises ValueError if weights begin so, but none that the sampler takes.
    """
    if prior is None or is_trained(prior) or Path(prior).exists():
        return prior
    if Path(f"{prior}.safetensors").is_file():
        return f"{prior}.safetensors"
    found = sorted(Path(prior).parent.glob(f"{Path(prior).name}-*.safetensors"))
    counts_first = ["counts", "annealed score"] if name == DENOISING else ["annealed score"]
    for needs in counts_first if sampler is None else [SAMPLERS[sampler].needs]:
        kind, perturbation = _WEIGHTS[needs]
        path = Path(f"{prior}-{perturbation}-{kind}.safetensors")
        if path in found:
            return str(path)
    if found:
        raise ValueError(
            f"--prior {prior}: it begins {', '.join(path.name for path in found)}; give the whole "
            f"path of one, or weights that end in -{perturbation}-{kind}.safetensors"
        )
    return prior


def channels_of(prior: str | None, needs: str) -> int:
    """Channels of a picture that the prior takes together: 3 in colour; complex ones have 2."""
    return weights_card(prior, needs)["network"]["channels"] if is_trained(prior) else 1


def of_complex_objects(
    name: str, prior: str | None, needs: str, picture: np.ndarray | None = None
) -> bool:
    """Whether the objects are complex: of phase retrieval where the weights' or the pictures' are.

    `picture`: of the object itself, where it is known; it tells of a prior that is fitted.
    """
    if name != PHASE_RETRIEVAL:
        return name == PTYCHOGRAPHY
    if is_trained(prior):
        return weights_card(prior, needs)["statistics"].get("complex_valued", False)
    if picture is not None and np.iscomplexobj(picture):
        return True
    return prior is not None and any(map(np.iscomplexobj, _pictures_at(prior).values()))


def prior_of(
    name: str,
    shape: tuple[int, ...],
    prior: str | None,
    truth: np.ndarray | None,
    needs: str,
    complex_valued: bool,
) -> tuple[Prior, dict[str, str]]:
    """The prior that is asked for, and what it was made from, with hashes.

    Of an object (h, w, 3) a grey one is taken by planes.
    """
    planes = len(shape) == 3 and channels_of(prior, needs) == 1
    own = shape[:2] if planes else shape
    if is_trained(prior):
        found, made_of = _trained_prior(name, own, prior, needs, complex_valued)
    else:
        found, made_of = _fitted_prior(name, own, prior, truth, complex_valued)
    return by_planes(found) if planes else found, made_of


def _trained_prior(
    name: str, shape: tuple[int, ...], prior: str, needs: str, complex_valued: bool
) -> tuple[Prior, dict[str, str]]:
    card = weights_card(prior, needs)
    kind = EnergyPrior if card["kind"] == "energy" else ScorePrior
    dtype = complex if complex_valued else float
    found = kind.load(prior, shape, card["statistics"]["perturbation"], dtype)
    made_of = {Path(prior).name: card["sha256"]}
    if name == PHASE_RETRIEVAL and scout_of(prior) != prior:
        made_of[scout_of(prior)] = card_of(scout_of(prior))["sha256"]
    return found, made_of


# What a sampler needs, and the kind and perturbation of the weights that have it; annealing takes
# the score of the signal-dependent error too.
_NEEDS = {
    "annealed score": "score",
    "score": "score of the gaussian error",
    "density": "density",
    "counts": "denoiser of counts",
}
_WEIGHTS = {
    "annealed score": ("score", "gaussian"),
    "score": ("score", "gaussian"),
    "density": ("energy", "gaussian"),
    "counts": ("score", "poisson"),
}
_HAVE = {
    ("score", "gaussian"): ("annealed score", "score"),
    ("energy", "gaussian"): ("annealed score", "score", "density"),
    ("score", "signal"): ("annealed score",),
    ("energy", "signal"): ("annealed score", "density"),
    ("score", "poisson"): ("counts",),
}


def weights_card(prior: str, needs: str) -> dict[str, Any]:
    """The model card of trained weights; refuses those that have not what a sampler needs."""
    kind, perturbation = _WEIGHTS[needs]
    if f"{prior}-{perturbation}-{kind}" in shipped():
        return card_of(prior, kind, perturbation)
    card = card_of(prior)
    found = card["kind"], card["statistics"]["perturbation"]
    has = _HAVE.get(found, ())
    if needs not in has:
        fit = [name for name, sampling in SAMPLERS.items() if sampling.needs in has]
        remedy = f"use --sampler {' or '.join(fit)}, or " if fit else ""
        raise ValueError(
            f"{Path(prior).name} has kind {found[0]} and perturbation {found[1]}, and the sampler "
            f"needs a {_NEEDS[needs]}: {remedy}give weights trained with --kind {kind} "
            f"--perturbation {perturbation}"
        )
    return card


def scout_of(prior: str) -> str:
    """The weights whose denoiser finds where phase retrieval under `prior` starts.

    Of shipped weights NAME-large the small network NAME, if there is one; else the prior itself.
    `starts.by_admm` tells what was measured of `natural`; of other pictures it is not known.
    """
    small = prior.removesuffix("-large")
    return small if f"{small}-gaussian-score" in shipped() else prior


def best_sampler(name: str, prior: str | None) -> str:
    """The sampler of an application where none is asked for."""
    if not is_trained(prior):
        return APPLICATIONS[name].sampler
    counts = f"{prior}-poisson-score" in shipped() or (
        prior not in shipped_names() and card_of(prior)["statistics"]["perturbation"] == "poisson"
    )
    return denoising_sampler("poisson") if counts and name == DENOISING else "annealed"


def denoising_sampler(perturbation: str) -> str:
    """The sampler of denoising under a score of that perturbation, where none is asked for."""
    return "thickening" if perturbation == "poisson" else "annealed"


def _fitted_prior(
    name: str,
    shape: tuple[int, ...],
    path: str | None,
    truth: np.ndarray | None,
    complex_valued: bool,
) -> tuple[GaussianField, dict[str, str]]:
    """A Gaussian field fitted to pictures, the truth itself left out; their names and hashes."""
    found = _shipped_pictures() if path is None else _pictures_at(path)
    if truth is not None and truth.ndim == 3:
        truth = to_grey(truth)
    side = max(*shape, _LEAST_FIT)
    objects = {}
    for label, picture in found.items():
        fitted = _prior_object(name, label, picture, side, complex_valued)
        if truth is None or not _same_picture(fitted, truth):
            objects[label] = fitted
    if not objects:
        raise ValueError(f"{path} holds only the picture that is asked for: give a prior of others")
    kind = complex if complex_valued else float
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


def _prior_object(
    name: str, label: str, picture: np.ndarray, side: int, complex_valued: bool
) -> np.ndarray:
    """A prior picture brought to the scale of the object, and to its kind."""
    try:
        if not np.iscomplexobj(picture):
            picture = to_grey(to_unit_range(picture))
        else:
            refuse_complex(name, complex_valued)
        fitted = fit_to(picture, min(side, *picture.shape))
    except ValueError as error:
        raise ValueError(f"prior picture {label}: {error}") from error
    compose = complex_valued and not np.iscomplexobj(fitted)
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
