"""The prior that is asked for: fitted to pictures, or trained weights."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from skimage import data as pictures

from ..images import fit_to, read_picture, to_grey, to_unit_range
from ..models.priors import EnergyPrior, GaussianField, Prior, ScorePrior
from ..models.priors.storage import card_of, shipped, shipped_names
from .applications import APPLICATIONS, DENOISING, PHASE_RETRIEVAL, PTYCHOGRAPHY
from .objects import complex_object
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
    return prior is not None and (prior in shipped_names() or prior.endswith(".safetensors"))


def prior_of(
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
    made_of = {Path(prior).name: card["sha256"]}
    if name == PHASE_RETRIEVAL and scout_of(prior) != prior:
        made_of[scout_of(prior)] = card_of(scout_of(prior))["sha256"]
    return found, made_of


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
