"""`posterior prior`: what trained weights know, by their card, and draws of them alone."""

import textwrap
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import typer
from rich.progress import track

from ..diagnostics.prior_plot import plot_prior
from ..diagnostics.shared_errors import knows_means, shared_errors
from ..files import replace_whole, save_array
from ..models.priors import EnergyPrior, ScorePrior
from ..models.priors.learned import LearnedPrior
from ..models.priors.storage import load_denoiser, located, save_card
from ..presets import DENOISING, SAMPLERS, best_sampler, weights_card, whole_path
from ..prior_calibration import calibration
from ..train import Preparation, prepare
from ..training_report import SIGMAS, on_patches
from .options import Overwrite, Quiet, study_data
from .words import held_shares

_FILES = ("draws.npy", "draws.png")
_ERRORS = {
    "gaussian": "additive Gaussian noise",
    "signal": "the signal-dependent error x + sqrt(x) e",
    "poisson": "photon counts",
}


def command(
    name: Annotated[str, typer.Argument(help="Trained weights by name or path.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for draws.npy and draws.png; unsaid: none are made.")
    ] = None,
    size: Annotated[int, typer.Option(help="Side of a draw, in pixels.")] = 64,
    draws: Annotated[int, typer.Option(help="How many.")] = 16,
    steps: Annotated[int, typer.Option(help="Levels from noise to a picture, 2 or more.")] = 100,
    seed: Annotated[int, typer.Option(help="Same seed, same draws.")] = 0,
    calibrate: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the pictures it was trained on: draws from counts of those that its "
            "card holds out, and writes into the card how many its intervals hold (10 minutes)."
        ),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Tell what a learnt prior was trained on and where it ends, and draw from it without data."""
    for option, value, least in (("size", size, 4), ("draws", draws, 1), ("steps", steps, 2)):
        if value < least:
            raise ValueError(f"--{option} {value}: give {least} or more")
    # The weights that denoising takes: counts, whose draws are best, if there are such.
    name = whole_path(DENOISING, name, None)
    card = weights_card(name, SAMPLERS[best_sampler(DENOISING, name)].needs)
    if calibrate is not None:
        card = _calibrated(name, card, study_data(calibrate), quiet)
    print("\n".join(_told(card)))
    if out is None:
        return
    prior = _prior(name, card, size, steps)
    _make_folder(out, overwrite)
    keys = jax.random.split(jax.random.key(seed), draws)
    draw = jax.jit(lambda key: prior.sample(key))
    drawn = np.stack([draw(key) for key in track(keys, "draws", disable=quiet)])
    save_array(out / "draws.npy", drawn)
    figure = plot_prior(drawn)
    replace_whole(out / "draws.png", lambda part: figure.savefig(part, dpi=150, format="png"))
    print(f"draws in {out}")


def _calibrated(name: str, card: dict[str, Any], folder: Path, quiet: bool) -> dict[str, Any]:
    """The card, with what the intervals of its weights are worth; on disk too."""
    asked = name, card["kind"], card["statistics"]["perturbation"]
    held_out = card.get("data", {}).get("validation")
    if not isinstance(held_out, list) or "preparation" not in card:
        raise ValueError(
            f"the card of {name} does not list the pictures held out, or how they were prepared: "
            "train it anew with `posterior train`"
        )
    how = Preparation(**card["preparation"])
    pictures = [prepare(folder / file, how) for file in held_out]
    prior, patches = on_patches(load_denoiser(*asked), card["kind"], pictures)
    found = {"calibration": calibration(prior, patches, quiet=quiet)}
    if knows_means(prior):
        found["shared_errors"] = shared_errors(prior, patches, SIGMAS)
    card = card | {"validation": card.get("validation", {}) | found}
    save_card(located(*asked), card)
    return card


def _told(card: dict[str, Any]) -> list[str]:
    """The card in words, a paragraph a line."""
    about, data, validation = card["statistics"], card.get("data", {}), card.get("validation", {})
    channels = card["network"].get("channels", 1)
    kind = "complex" if about.get("complex_valued") else "colour" if channels == 3 else "grey"
    said = [
        f"{card.get('name', 'weights')}: {card['kind']} network of {kind} pictures under "
        f"{_ERRORS[about['perturbation']]}, {card.get('parameters', 0) / 1e6:.2f} million "
        "parameters",
        f"pictures: {data.get('source', 'not stated')} ({data.get('licence', 'not stated')}); "
        + ", ".join(f"{count} for {part}" for part, count in data.get("pictures", {}).items()),
        f"units: {card.get('normalisation', 'not stated')}",
        f"levels: sigma {about['sigma_min']:.3g} to {about['sigma_max']:.3g}",
    ]
    for sigma, row in validation.get("denoising_psnr_db", {}).items():
        others = "" if row.get("bm3d") is None else f", BM3D {row['bm3d']} dB"
        shared = validation.get("shared_errors", {}).get(sigma)
        means = (
            ""
            if shared is None
            else f", errors of means share {100 * max(shared, 0):.0f} % of noise"
        )
        said.append(f"held out, sigma {sigma}: {row['network']} dB{others}{means}")
    for well, found in validation.get("calibration", {}).items():
        said.append(
            f"held out, {well} electrons: spread over error {found['spread_over_error']}, inside "
            f"intervals of {100 * found['nominal']:.0f} %: {', '.join(held_shares(found))}"
        )
    said += [f"limit: {limit}" for limit in card.get("limits", [])]
    said.append(f"trained by: {card.get('training', {}).get('command', 'not stated')}")
    return [textwrap.fill(line, 100, subsequent_indent="  ") for line in said]


def _make_folder(out: Path, overwrite: bool) -> None:
    found = [name for name in _FILES if (out / name).exists()]
    if found and not overwrite:
        raise ValueError(
            f"{out} already holds {found[0]}: give another --out, or --overwrite to replace it"
        )
    out.mkdir(parents=True, exist_ok=True)


def _prior(name: str, card: dict[str, Any], size: int, steps: int) -> LearnedPrior:
    perturbation = card["statistics"]["perturbation"]
    if perturbation == "signal":
        raise ValueError(
            f"{card.get('name', name)} knows harmonic means, and its own draws come out far too "
            "dark: ask weights of the gaussian error or of counts for draws"
        )
    kind = {"score": ScorePrior, "energy": EnergyPrior}[card["kind"]]
    shape = (size, size, 3) if card["network"]["channels"] == 3 else (size, size)
    return kind.load(name, shape, perturbation, sampling_steps=steps)
