"""Weights on disk: a safetensors file and, beside it, a model card in JSON that vouches for it.

The card says what network the file holds, what it was trained on, in which units, how well it does
and where it fails, and carries the file's SHA-256. Nothing is ever unpickled. Weights may be stored
in float16; they are computed with in float32.
"""

import dataclasses
import hashlib
import json
import os
import struct
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .base import is_complex_kind
from .denoiser import Denoiser, Statistics
from .ncsn import NCSNv2
from .perturbation import check_perturbation
from .unet import UNet

FORMAT = 1
FOLDER = Path(__file__).parent / "weights"
NETWORKS = {"unet": UNet, "ncsnv2": NCSNv2}


def build_network(description: dict[str, Any], key: jax.Array) -> eqx.Module:
    """A fresh network from its entry in a card: its type and the arguments it was built with."""
    arguments = {k: tuple(v) if isinstance(v, list) else v for k, v in description.items()}
    kind = arguments.pop("type", None)
    if kind not in NETWORKS:
        raise ValueError(f"unknown network {kind!r}: use {' or '.join(NETWORKS)}")
    try:
        return NETWORKS[kind](key=key, **arguments)
    except TypeError as error:
        raise ValueError(f"network {description}: {error}") from None


def save_weights(
    path: str | os.PathLike, denoiser: Denoiser, card: dict[str, Any], dtype: str = "float16"
) -> dict[str, Any]:
    """Write `path` (.safetensors) and its card; returns the card completed.

    `card` must name the network (`build_network`), the kind, and whatever a reader should know.
    """
    from safetensors.numpy import save_file

    path = Path(path)
    arrays = {name: np.asarray(a).astype(dtype) for name, a in _named_arrays(denoiser).items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    save_file(arrays, partial)
    digest = hashlib.sha256(partial.read_bytes()).hexdigest()
    card = {
        "format": FORMAT,
        **card,
        "statistics": dataclasses.asdict(denoiser.statistics),
        "parameters": sum(a.size for a in arrays.values()),
        "sha256": digest,
    }
    partial_card = _partial_card(path, card)
    os.replace(partial, path)
    os.replace(partial_card, card_path(path))
    return card


def save_card(path: Path, card: dict[str, Any]) -> None:
    """Replace the card of the weights at `path`, which stay as they are."""
    os.replace(_partial_card(path, card), card_path(path))


def _partial_card(path: Path, card: dict[str, Any]) -> Path:
    partial = card_path(path).with_name(card_path(path).name + ".part")
    partial.write_text(json.dumps(card, indent=1, ensure_ascii=False) + "\n")
    return partial


def card_path(path: Path) -> Path:
    """Where the card of a weights file is."""
    return path.with_suffix(".json")


def shipped() -> list[str]:
    """Names of the weights that come with the project, as name-perturbation-kind."""
    return sorted(p.stem for p in FOLDER.glob("*.safetensors"))


def shipped_names() -> list[str]:
    """Their short names, as `ScorePrior.load` takes them."""
    return sorted({stem.rsplit("-", 2)[0] for stem in shipped()})


def card_of(
    name: str | os.PathLike, kind: str = "score", perturbation: str = "gaussian"
) -> dict[str, Any]:
    """The model card of a shipped name or a .safetensors path; raises as `load_denoiser`."""
    return read_card(located(name, kind, perturbation))


def load_denoiser(
    name: str | os.PathLike, kind: str, perturbation: str, dtype: type | None = None
) -> Denoiser:
    """The denoiser of a shipped name ("nuclei", or the whole "nuclei-gaussian-score") or a
    .safetensors path, checked against what is asked for.

    Raises FileNotFoundError, or ValueError in one sentence: damaged file or card, hash or shapes
    that do not fit, another kind, perturbation or object dtype.
    """
    path = located(name, kind, perturbation)
    card = read_card(path)
    _check_asked(path, card, kind, perturbation, dtype)
    raw = path.read_bytes()
    if hashlib.sha256(raw).hexdigest() != card["sha256"]:
        raise ValueError(
            f"{path.name} is not the file that its card describes (SHA-256 differs): "
            "it is damaged or was exchanged, copy both anew"
        )
    arrays = _read_arrays(path, raw)
    try:
        statistics = Statistics(**card["statistics"])
        skeleton = eqx.filter_eval_shape(
            lambda key: Denoiser(build_network(card["network"], key), statistics), jax.random.key(0)
        )
    except (TypeError, ValueError) as error:
        raise ValueError(f"the card of {path.name} describes no network: {error}") from None
    return _filled(path, skeleton, arrays)


def read_card(path: Path) -> dict[str, Any]:
    """The model card of a weights file."""
    card_file = card_path(path)
    if not card_file.exists():
        raise FileNotFoundError(f"no card {card_file}: keep the .json beside its .safetensors")
    try:
        card = json.loads(card_file.read_text())
        missing = {"format", "kind", "network", "statistics", "sha256"} - set(card)
    except (ValueError, TypeError):
        raise ValueError(f"{card_file} is no model card: copy it anew") from None
    if missing:
        raise ValueError(f"{card_file} lacks {', '.join(sorted(missing))}: copy it anew")
    named = card.get("name", path.stem)
    if named != path.stem:
        raise ValueError(
            f"{path.name} has a card named {named!r}: call the two files {named}.safetensors and "
            f"{named}.json again, or set the card's name to {path.stem!r} if they belong together"
        )
    if card["format"] != FORMAT:
        raise ValueError(f"{card_file} has format {card['format']}: this version reads {FORMAT}")
    return card


def located(name: str | os.PathLike, kind: str, perturbation: str) -> Path:
    path = Path(name)
    if path.suffix == ".safetensors":
        if not path.is_file():
            raise FileNotFoundError(f"no file {path}: give the path of a .safetensors file")
        return path
    file = f"{name}-{perturbation}-{kind}.safetensors"
    for path in (FOLDER / file, Path(file), FOLDER / f"{name}.safetensors"):
        if path.exists():
            return path
    ending = f"-{perturbation}-{kind}"
    fitting = [stem.removesuffix(ending) for stem in shipped() if stem.endswith(ending)]
    raise ValueError(
        f"no {kind} weights {str(name)!r} for the {perturbation} perturbation: use one of "
        f"{', '.join(fitting) or '(none)'}, or the path of a .safetensors file, or what such "
        f"paths begin with, before {ending}.safetensors"
    )


def _check_asked(
    path: Path, card: dict[str, Any], kind: str, perturbation: str, dtype: type | None
) -> None:
    statistics = card["statistics"]
    if not isinstance(statistics, dict):
        raise ValueError(f"the card of {path.name} has no statistics: copy it anew")
    complex_valued = statistics.get("complex_valued", False)
    check_perturbation(perturbation, complex_valued)
    if card["kind"] != kind:
        raise ValueError(
            f"{path.name} holds a network of kind {card['kind']!r}, not {kind!r}: "
            f"load it as {card['kind'].capitalize()}Prior"
        )
    if statistics.get("perturbation") != perturbation:
        raise ValueError(
            f"{path.name} was trained for the {statistics.get('perturbation')!r} perturbation, "
            f"not {perturbation!r}: ask for that one, or load other weights"
        )
    if dtype is not None and is_complex_kind(dtype) != complex_valued:
        kinds = {True: "complex", False: "real"}
        raise ValueError(
            f"{path.name} is for {kinds[complex_valued]} objects, not for "
            f"{kinds[not complex_valued]} ones: load other weights"
        )


def _read_arrays(path: Path, raw: bytes) -> dict[str, np.ndarray]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        return load(raw)
    except (SafetensorError, ValueError, KeyError, struct.error) as error:
        raise ValueError(f"{path.name} is no readable safetensors file: {error}") from None


def _named_arrays(tree: Any) -> dict[str, Any]:
    """Arrays of a module by their path, as in network.down[0][0].first.kernel."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path).lstrip("."): leaf for path, leaf in leaves}


def _filled(path: Path, skeleton: Denoiser, arrays: dict[str, np.ndarray]) -> Denoiser:
    expected = _named_arrays(skeleton)
    odd = sorted(set(expected) ^ set(arrays))
    if odd:
        raise ValueError(f"{path.name} does not fit its card: {odd[0]} is in one of them alone")
    for name, leaf in expected.items():
        if arrays[name].shape != leaf.shape:
            raise ValueError(
                f"{path.name} does not fit its card: {name} has shape {arrays[name].shape}, "
                f"the network {leaf.shape}"
            )
        if not np.all(np.isfinite(arrays[name])):
            raise ValueError(f"{path.name} holds NaN or infinity in {name}: train it anew")
    structure = jax.tree.structure(skeleton)
    return jax.tree.unflatten(structure, [jnp.asarray(arrays[n], jnp.float32) for n in expected])
