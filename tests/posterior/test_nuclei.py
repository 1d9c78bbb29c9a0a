"""Poisson denoising of nuclei that no network was trained on: is the stated uncertainty true?

A study: it needs the pictures (POSTERIOR_DATA), BM3D, and an hour or two. NUCLEI_PATCHES and
NUCLEI_DRAWS make it smaller; NUCLEI_PART=validation looks at the pictures that settings were chosen
on, and not at those of the test.
"""

import os
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from posterior import models, presets
from posterior.estimators import anscombe_denoised
from posterior.models.priors.storage import card_of
from posterior.train import Preparation, prepare
from posterior.training_report import mean_psnr

pytestmark = [
    pytest.mark.slow,
    pytest.mark.data,
    pytest.mark.skipif("POSTERIOR_DATA" not in os.environ, reason="no study data"),
]
PATCHES = int(os.environ.get("NUCLEI_PATCHES", 64))
DRAWS = int(os.environ.get("NUCLEI_DRAWS", 64))
PART = os.environ.get("NUCLEI_PART", "test")
SIDE, BLOCK, BATCH = 64, 8, 16


@pytest.fixture(scope="module")
def patches():
    """(n, 64, 64), one of each picture: of eight random places the one with the most contrast."""
    rng, found = np.random.default_rng(5), []
    card = card_of("nuclei")
    how = Preparation(**card["preparation"])
    for name in card["data"][PART][:PATCHES]:
        picture = prepare(os.path.join(os.environ["POSTERIOR_DATA"], "dsb2018_nuclei", name), how)
        corners = rng.integers(0, np.array(picture.shape[:2]) - SIDE + 1, (8, 2))
        crops = [picture[i : i + SIDE, j : j + SIDE, 0] for i, j in corners]
        found.append(max(crops, key=np.std))
    return np.stack(found)


def block_means(images):
    n = SIDE // BLOCK
    return images.reshape(*images.shape[:-2], n, BLOCK, n, BLOCK).mean((-3, -1))


def ranks(draws, truth):
    """Draws below the truth, of `DRAWS`: draws (n, DRAWS, ...), truth (n, ...)."""
    return (draws < truth[:, None]).sum(axis=1)


def coverage(draws, truth, level):
    """Share of the truths inside the central interval of ranks, and the share that is right."""
    tail = round((1 - level) / 2 * (DRAWS + 1))
    rank = ranks(draws, truth)
    return np.mean((rank >= tail) & (rank <= DRAWS - tail)), 1 - 2 * tail / (DRAWS + 1)


def mean_rank(draws, truth):
    """Mean of the ranks as fractions, and its standard error with pictures as the unit."""
    per_picture = (ranks(draws, truth) / DRAWS).reshape(len(truth), -1).mean(axis=1)
    return per_picture.mean(), per_picture.std(ddof=1) / np.sqrt(len(truth))


def drawn(truth, full_well):
    """Recordings, draws (n, DRAWS, 64, 64) and seconds a draw."""
    camera = models.Poisson(full_well)
    likelihood = models.LinearLikelihood(models.Identity((SIDE, SIDE)), camera)
    problem = ps.Problem(likelihood, models.ScorePrior.load("nuclei", (SIDE, SIDE)))
    y = np.stack([camera.sample(jax.random.key(i), jnp.asarray(x)) for i, x in enumerate(truth)])
    found, began = [], time.perf_counter()
    chains = min(BATCH, DRAWS)
    for i, recording in enumerate(y):
        posterior = problem.condition(recording)
        sampler = presets.learned_annealing(posterior)
        key, settings = jax.random.key(1000 + i), {"chains": chains, "draws": DRAWS // chains}
        run = ps.sample(posterior, sampler, key, progress=False, **settings)
        found.append(run.values.reshape(-1, SIDE, SIDE))
    return y, np.stack(found), (time.perf_counter() - began) / (len(y) * DRAWS)


@pytest.mark.parametrize("full_well", [100, 25])
def test_denoising_of_pictures_never_trained_on(patches, full_well):
    bm3d = pytest.importorskip("bm3d").bm3d
    y, draws, seconds = drawn(patches, full_well)
    mean = draws.mean(axis=1)
    camera = models.Poisson(full_well)
    classical = np.stack([anscombe_denoised(image, camera, bm3d) for image in y])
    quality = {
        "data": mean_psnr(y, patches),
        "draws": mean_psnr(draws[:, 0], patches),
        "mean": mean_psnr(mean, patches),
        "Anscombe + BM3D": mean_psnr(classical, patches),
    }
    print(f"\nnuclei, {PART}, full well {full_well}: {len(patches)} patches x {DRAWS} draws")
    print({k: round(v, 2) for k, v in quality.items()}, f"dB, {seconds:.2f} s a draw")
    # The mean of a few draws keeps a share 1/DRAWS of their variance.
    spread = np.mean(draws.var(axis=1, ddof=1)) * (1 + 1 / DRAWS)
    ratio = np.sqrt(spread / np.mean((mean - patches) ** 2))
    print(f"spread-skill ratio {ratio:.3f}")
    area = (draws > 0.3).mean((2, 3)), (patches > 0.3).mean((1, 2))
    for name, (d, t) in {
        "pixels": (draws, patches),
        "blocks": (block_means(draws), block_means(patches)),
        "area above 0.3": area,
        "image mean": (draws.mean((2, 3)), patches.mean((1, 2))),
    }.items():
        inside = [coverage(d, t, level) for level in (0.5, 0.9)]
        said = ", ".join(f"{found:.3f} ({right:.3f})" for found, right in inside)
        middle, error = mean_rank(d, t)
        print(
            f"{name}: inside 50 and 90 % (nominal): {said}; mean rank {middle:.3f} +- {error:.3f}"
        )
        if name == "pixels":
            assert all(abs(found - right) < 0.04 for found, right in inside)
    assert 0.9 < ratio < 1.1
    assert quality["mean"] > quality["Anscombe + BM3D"]


@pytest.mark.parametrize("kind", ["score", "energy"])
def test_the_network_alone_beats_bm3d(kind):
    """On its card's validation pictures: by 0.5 dB at sigma 0.1, by 1.3 dB at 0.2."""
    pytest.importorskip("bm3d")
    from posterior.training_report import central_patches, denoising

    card = card_of("nuclei", kind)
    how = Preparation(**card["preparation"])
    folder = os.path.join(os.environ["POSTERIOR_DATA"], "dsb2018_nuclei")
    pictures = [prepare(os.path.join(folder, n), how) for n in card["data"]["validation"]]
    load = {"score": models.ScorePrior, "energy": models.EnergyPrior}[kind].load
    table = denoising(load("nuclei", (SIDE, SIDE)), central_patches(pictures, 4))
    print(f"\nnuclei, {kind}:", table)
    assert all(row["network"] > row["bm3d"] for row in table.values())
    assert table["0.1"]["network"] > table["0.1"]["bm3d"] + 0.5
    assert table["0.2"]["network"] > table["0.2"]["bm3d"] + 1.3
