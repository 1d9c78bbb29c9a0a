"""What a training reports: losses, denoising against BM3D on held-out pictures, draws."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .models.priors.denoiser import Denoiser
from .models.priors.learned import EnergyPrior, LearnedPrior, ScorePrior
from .models.priors.perturbation import perturbed

SIGMAS = (0.025, 0.05, 0.1, 0.2)
PATCHES, SIDE, DRAWS = 32, 64, 8
# Means of so many losses; one this many times the median of the ten before it is a jump. Two right
# trainings of 8000 steps stay below 1.1; one that a bad step spoilt for good had 27.
_STRETCH, _BEFORE, _JUMP = 50, 10, 3.0
_SHARED = 0.1  # makes image means of thickening at most 1.18 times too narrow (`shared_errors`)


def central_patches(pictures: list[np.ndarray], stride: int, side: int = SIDE) -> np.ndarray:
    """One patch (n, side, side, channels) from the middle of each of the first pictures.

    The side is brought down to what the smallest picture and the network's stride allow.
    """
    chosen = pictures[:PATCHES]
    side = min(side, *(min(p.shape[:2]) for p in chosen)) // stride * stride
    patches = []
    for p in chosen:
        top, left = (p.shape[0] - side) // 2, (p.shape[1] - side) // 2
        patches.append(p[top : top + side, left : left + side])
    return np.stack(patches)


def on_patches(
    denoiser: Denoiser, kind: str, pictures: list[np.ndarray]
) -> tuple[LearnedPrior, np.ndarray]:
    """The prior for those patches (n, h, w, channels) of pictures, and they."""
    patches = central_patches(pictures, denoiser.network.stride)
    colour = denoiser.network.channels == 3
    shape = patches.shape[1:] if colour else patches.shape[1:3]
    return (EnergyPrior if kind == "energy" else ScorePrior)(denoiser, shape), patches


def denoising(
    prior: LearnedPrior, patches: np.ndarray, seed: int = 0, sigmas: tuple[float, ...] = SIGMAS
) -> dict[str, dict[str, float | None]]:
    """PSNR in dB (peak 1, mean over patches) by sigma: noisy, network, and BM3D if installed.

    `patches` (n, h, w, channels) in the prior's units, disturbed as it was trained. BM3D is told
    the noise; the signal-dependent one it gets through a square root that makes it uniform.
    """
    table = {}
    for i, sigma in enumerate(sigmas):
        key = jax.random.fold_in(jax.random.key(seed), i)
        kind = prior.perturbation, prior.complex_valued
        noisy = np.asarray(perturbed(key, jnp.asarray(patches), sigma, *kind))
        found = {"noisy": noisy, "network": denoised(prior, noisy, sigma), "bm3d": None}
        block_matching = _bm3d(*kind)
        if block_matching is not None:
            found["bm3d"] = np.stack([block_matching(image, sigma) for image in noisy])
        table[f"{sigma:g}"] = {
            name: None if value is None else round(mean_psnr(value, patches), 2)
            for name, value in found.items()
        }
    return table


def denoised(prior: LearnedPrior, noisy: np.ndarray, sigma: float) -> np.ndarray:
    """The network's estimate of each of (n, h, w, channels)."""
    objects = jnp.asarray(noisy)
    if prior.complex_valued:
        objects = jax.lax.complex(objects[..., 0], objects[..., 1])
    objects = objects.reshape(-1, *prior.shape)
    clean = jax.jit(jax.vmap(lambda x: prior.denoise(x, sigma)))(objects)
    if prior.complex_valued:
        clean = jnp.stack([clean.real, clean.imag], axis=-1)
    return np.asarray(clean).reshape(noisy.shape)


def mean_psnr(found: np.ndarray, truth: np.ndarray) -> float:
    """Mean over pictures (n, ...) of 10 log10(1/mean squared error)."""
    error = np.mean((found - truth) ** 2, axis=tuple(range(1, truth.ndim)))
    return float(np.mean(-10 * np.log10(np.maximum(error, 1e-12))))


def doubts(
    losses: np.ndarray, table: dict[str, dict[str, float | None]], shared: dict[str, float]
) -> list[str]:
    """What stands against the weights: a jump of the losses (steps,), levels where BM3D is better,
    and where means are not known.

    `table`: of `denoising`; `shared`: of `shared_errors`, empty where there are none. A sentence
    each.
    """
    said, found = [], _jump(losses)
    if found is not None:
        step, times = found
        said.append(
            f"the loss jumped to {times:.0f} times its value about step {step}, and weights may "
            "not recover from that: train anew with a smaller --rate or --clip"
        )
    worse = [
        f"{sigma} ({row['network']} dB, BM3D {row['bm3d']})"
        for sigma, row in table.items()
        if row["bm3d"] is not None and row["network"] < row["bm3d"]
    ]
    if worse:
        said.append(
            f"BM3D, which learnt nothing, denoises better at sigma {', '.join(worse)}: train for "
            "longer or on more pictures"
        )
    if any(share > _SHARED for share in shared.values()):
        sigma, share = max(shared.items(), key=lambda pair: pair[1])
        said.append(
            f"errors of a picture's mean share up to {100 * share:.0f} % of its noise (sigma "
            f"{sigma}), and image means of draws may come out too narrow: train on from these "
            "weights (--init) with --averages 0.004, or for longer"
        )
    return said


def _jump(losses: np.ndarray) -> tuple[int, float] | None:
    """The step at which the loss first jumps, and to how many times its recent value."""
    whole = len(losses) // _STRETCH * _STRETCH
    means = np.asarray(losses, float)[:whole].reshape(-1, _STRETCH).mean(axis=1)
    for i in range(_BEFORE, len(means)):
        times = means[i] / np.median(means[i - _BEFORE : i])
        if times > _JUMP:
            return i * _STRETCH, float(times)
    return None


def write_report(
    folder: Path,
    prior: LearnedPrior,
    losses: np.ndarray,
    table: dict[str, dict[str, float | None]],
    seed: int = 0,
) -> None:
    """report.json and report.png: losses, PSNR by sigma, draws of the prior."""
    keys = jax.random.split(jax.random.key(seed), DRAWS)
    draws = np.asarray(jax.jit(jax.vmap(prior.sample))(keys))
    report = {"denoising_psnr_db": table, "loss": [round(float(v), 5) for v in _thinned(losses)]}
    (folder / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    shown = np.abs(draws) if prior.complex_valued else draws
    _figure(folder / "report.png", losses, table, shown)


def _thinned(losses: np.ndarray, points: int = 200) -> np.ndarray:
    return np.array([part.mean() for part in np.array_split(losses, min(points, len(losses)))])


def _figure(path: Path, losses: np.ndarray, table: dict[str, Any], draws: np.ndarray) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=(3, 2))
    left, right = top.subplots(1, 2)
    curve = _thinned(losses)
    left.semilogy(np.linspace(0, len(losses), len(curve)), curve, color="black")
    left.set(xlabel="step", ylabel="loss", title="Training loss, 1: nothing learnt")
    sigmas = [float(s) for s in table]
    for name, style in (("network", "ko-"), ("bm3d", "ks--"), ("noisy", "k:")):
        values = [row[name] for row in table.values()]
        if None not in values:
            right.semilogx(sigmas, values, style, label=name, markersize=4)
    right.set(xlabel="sigma", ylabel="PSNR in dB", title="Denoising pictures held out")
    right.set_xticks(sigmas, [f"{s:g}" for s in sigmas])
    right.minorticks_off()
    right.legend()
    for axes, draw in zip(bottom.subplots(1, len(draws)), draws):
        axes.imshow(np.clip(draw, 0, 1), cmap="gray", vmin=0, vmax=1)
        axes.set_axis_off()
    bottom.suptitle("Draws of the prior")
    figure.savefig(path, dpi=120)


def _bm3d(
    perturbation: str, complex_valued: bool
) -> Callable[[np.ndarray, float], np.ndarray] | None:
    """BM3D for images (h, w, channels), channel by channel; None where it is not installed."""
    try:
        from bm3d import bm3d
    except ImportError:
        return None

    def gaussian(image: np.ndarray, sigma: float) -> np.ndarray:
        sd = sigma / 2 if complex_valued else sigma
        return np.stack([bm3d(channel, sd) for channel in np.moveaxis(image, -1, 0)], axis=-1)

    def signal(image: np.ndarray, sigma: float) -> np.ndarray:
        # The root of a value of variance sigma^2 x has sd sigma/2; squared back it is
        # sigma^2/4 low.
        root = np.sqrt(np.maximum(image, 0))
        return np.maximum(gaussian(root, sigma / 2), 0) ** 2 + sigma**2 / 4

    return gaussian if perturbation == "gaussian" else signal
