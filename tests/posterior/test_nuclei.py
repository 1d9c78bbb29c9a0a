"""Poisson denoising of nuclei that no network was trained on: is the stated uncertainty true?

A study: it needs the pictures (POSTERIOR_DATA), BM3D, and an hour. NUCLEI_PATCHES and NUCLEI_DRAWS
make it smaller; NUCLEI_PART=validation looks at the pictures that settings were chosen on, and not
at those of the test, NUCLEI_PART=prior at draws of each sampler's own prior, where what is wrong is
the sampler's; NUCLEI_SAMPLERS, names of `SAMPLERS` with commas between, makes the table;
NUCLEI_PRIOR=nuclei-large asks the larger networks.
"""

import os
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from posterior import models, presets
from posterior.diagnostics import (
    longer_exposure,
    randomised_ranks,
    spread_over_error,
    uniformity,
)
from posterior.diagnostics.regions import (
    block_means,
    bright_areas,
    image_means,
    within_grey_levels,
)
from posterior.diagnostics.shared_errors import shared_errors
from posterior.estimators import anscombe_denoised
from posterior.models.priors.losses import signal_score_loss
from posterior.models.priors.perturbation import perturbed
from posterior.models.priors.storage import card_of
from posterior.studies import held_out
from posterior.studies.systems import published_kawar
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
PRIOR = os.environ.get("NUCLEI_PRIOR", "nuclei")
ASKED = os.environ.get("NUCLEI_SAMPLERS", "thickening").split(",")
SIDE, BATCH = 64, 16


class Asked(NamedTuple):
    """A sampler by its name, the error and kind of its prior, and settings that are not its own."""

    sampler: str
    perturbation: str = "gaussian"
    kind: type = models.ScorePrior
    build: Callable | None = None


SAMPLERS = {
    "thickening": Asked("thickening", "poisson"),
    "annealed": Asked("annealed"),
    "annealed-signal": Asked("annealed", "signal"),
    # The command line polishes under an energy by MALA, which the study of systems has.
    "signal-energy": Asked("annealed", "signal", models.EnergyPrior, presets.learned_annealing),
    "split-signal": Asked("annealed-split", "signal"),
    "split-gibbs": Asked("split-gibbs"),
    "daps": Asked("daps"),
    "dps": Asked("dps"),
    "kawar": Asked("kawar"),
    "kawar-published": Asked("kawar", build=published_kawar),
}


@pytest.fixture
def patches(sampler):
    """(n, 64, 64), one of each picture: of eight random places the one with the most contrast."""
    if PART == "prior":
        return own_draws(sampler)
    folder = os.path.join(os.environ["POSTERIOR_DATA"], "dsb2018_nuclei")
    return held_out(card_of(PRIOR), folder, PART, PATCHES, SIDE)


def own_draws(sampler):
    """(n, 64, 64) of the sampler's prior, by many more levels than a look at it needs."""
    asked = SAMPLERS[sampler]
    assert asked.perturbation != "signal", "its prior's own draws are far too dark"
    prior = asked.kind.load(PRIOR, (SIDE, SIDE), asked.perturbation, sampling_steps=400)
    draw = jax.jit(lambda key: prior.sample(key))
    return np.stack([draw(key) for key in jax.random.split(jax.random.key(5), PATCHES)])


def ranks(draws, truth):
    """How many of the draws (n, draws, ...) are below the truth (n, ...), ties at random."""
    fractions = randomised_ranks(truth, draws, np.random.default_rng(8))
    return np.floor(fractions * (draws.shape[1] + 1))


def coverage(draws, truth, level):
    """Share of the truths inside the central interval of ranks, its error, and what is right.

    The error has pictures as its unit: what is inside one of them is not independent.
    """
    count = draws.shape[1]
    tail = round((1 - level) / 2 * (count + 1))
    rank = ranks(draws, truth).reshape(len(truth), -1)
    inside = ((rank >= tail) & (rank <= count - tail)).mean(axis=1)
    nominal = 1 - 2 * tail / (count + 1)
    # At least that of so many independent ones.
    error = max(inside.std(ddof=1), np.sqrt(nominal * (1 - nominal) / rank.shape[1]))
    return inside.mean(), error / np.sqrt(len(truth)), nominal


def mean_rank(draws, truth):
    """Mean of the ranks as fractions, and its standard error with pictures as the unit."""
    fractions = ranks(draws, truth).reshape(len(truth), -1) / draws.shape[1]
    per_picture = fractions.mean(axis=1)
    return per_picture.mean(), per_picture.std(ddof=1) / np.sqrt(len(truth))


def uniform_p(draws, truth):
    """p-value of uniform ranks; of pixels and blocks one of each picture, at a place of its own."""
    rng, n = np.random.default_rng(7), len(truth)
    draws, truth = draws.reshape(*draws.shape[:2], -1), truth.reshape(n, -1)
    place = rng.integers(truth.shape[1], size=n)
    truth = np.take_along_axis(truth, place[:, None], 1)[:, 0]
    draws = np.take_along_axis(draws, place[:, None, None], 2)[..., 0]
    return uniformity(randomised_ranks(truth, draws, rng))


def drawn(truth, full_well, sampler):
    """Recordings, draws (n, draws, 64, 64), and seconds a draw."""
    camera = models.Poisson(full_well)
    likelihood = models.LinearLikelihood(models.Identity((SIDE, SIDE)), camera)
    asked = SAMPLERS[sampler]
    build = asked.build or presets.SAMPLERS[asked.sampler].build
    prior = asked.kind.load(PRIOR, (SIDE, SIDE), asked.perturbation)
    problem = ps.Problem(likelihood, prior)
    y = np.stack([camera.sample(jax.random.key(i), jnp.asarray(x)) for i, x in enumerate(truth)])
    found, began = [], time.perf_counter()
    chains = min(BATCH, DRAWS)
    for i, recording in enumerate(y):
        posterior = problem.condition(recording)
        key, settings = jax.random.key(1000 + i), {"chains": chains, "draws": DRAWS // chains}
        settings["start"] = presets.start_of(asked.sampler, posterior, key, chains)
        run = ps.sample(posterior, build(posterior), key, progress=False, **settings)
        found.append(run.values.reshape(-1, SIDE, SIDE))
    seconds = (time.perf_counter() - began) / (len(y) * len(found[0]))
    return y, np.stack(found), seconds


def summaries(images):
    """What is asked of pictures (..., 64, 64): pixels, block means, bright area, total light."""
    return {
        "pixels": images,
        "blocks": block_means(images),
        "area above 0.3": bright_areas(images, 0.3),
        "image mean": image_means(images),
    }


@pytest.mark.parametrize("full_well", [100, 25])
@pytest.mark.parametrize("sampler", ASKED)
def test_denoising_of_pictures_never_trained_on(patches, full_well, sampler):
    """Every sampler is measured; thickening, the default, must be calibrated."""
    bm3d = pytest.importorskip("bm3d").bm3d
    y, draws, seconds = drawn(patches, full_well, sampler)
    camera = models.Poisson(full_well)
    counts = models.ScorePrior.load(PRIOR, (SIDE, SIDE), "poisson")
    direct = jax.jit(jax.vmap(lambda z: counts.denoise(z, camera.sigma0)))
    quality = {
        "data": y,
        "draws": draws[:, 0],
        "mean": draws.mean(axis=1),
        "Anscombe + BM3D": np.stack([anscombe_denoised(image, camera, bm3d) for image in y]),
        "network of counts": np.asarray(direct(y)),
    }
    quality = {name: mean_psnr(found, patches) for name, found in quality.items()}
    print(f"\n{PRIOR}, {PART}, {sampler}, full well {full_well}: {draws.shape[:2]} patches, draws")
    print({k: round(v, 2) for k, v in quality.items()}, f"dB, {seconds:.2f} s a draw")
    ratio = spread_over_error(draws, patches)
    print(f"spread over error {ratio:.3f}")
    found, truth = summaries(draws), summaries(patches)
    found["area, grey levels spread"] = found["area above 0.3"]
    spread = within_grey_levels(patches, np.random.default_rng(6))
    truth["area, grey levels spread"] = summaries(spread)["area above 0.3"]
    inside = {
        name: [coverage(found[name], truth[name], level) for level in (0.5, 0.9)] for name in found
    }
    for name, shares in inside.items():
        said = ", ".join(f"{s:.3f} +- {e:.3f} ({right:.3f})" for s, e, right in shares)
        middle, error = mean_rank(found[name], truth[name])
        p = uniform_p(found[name], truth[name])
        off = np.sqrt(np.mean((found[name].mean(axis=1) - truth[name]) ** 2))
        sd = np.sqrt(np.mean(found[name].var(axis=1, ddof=1)))
        print(
            f"{name}: inside 50, 90 % (nominal): {said}; mean rank {middle:.3f} +- {error:.3f}; "
            f"ranks uniform p {p:.2g}; mean of draws off by {off:.2g}, draws' sd {sd:.2g}"
        )
    if sampler == "thickening":
        assert 0.9 < ratio < 1.1
        assert all(abs(share - right) < 0.04 for share, _, right in inside["pixels"])
        for name in ("blocks", "image mean"):
            assert all(abs(share - right) < 3 * error for share, error, right in inside[name])
        assert quality["mean"] > quality["Anscombe + BM3D"]
        assert quality["mean"] > quality["network of counts"] - 0.3


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


@pytest.mark.parametrize("sigma", [0.025, 0.05, 0.1, 0.2, 0.4, 0.8])
def test_the_loss_of_scores_of_the_signal_dependent_error(sigma):
    """The energy is trained by it, the score network as a denoiser, and for longer: it is less."""
    folder = os.path.join(os.environ["POSTERIOR_DATA"], "dsb2018_nuclei")
    card = card_of("nuclei", "score", "signal")
    clean = jnp.asarray(held_out(card, folder, "validation", 32, SIDE))
    keys = jax.random.split(jax.random.key(0), len(clean))
    z = jax.vmap(lambda key, x: perturbed(key, x, sigma, "signal", False))(keys, clean)
    losses = []
    for kind in (models.ScorePrior, models.EnergyPrior):
        prior = kind.load("nuclei", (SIDE, SIDE), "signal")
        score = jax.jit(lambda z, prior=prior: jax.lax.map(lambda z: prior.score(z, sigma), z))(z)
        losses.append(float(signal_score_loss(score, clean, z, sigma, prior.statistics.lowest)))
    print(f"\nsigma {sigma}: score {losses[0]:.4f}, energy {losses[1]:.4f}")
    assert losses[0] < losses[1]


def shared_by_means(perturbation, levels, noises):
    """`shared_errors` of 24 pictures of the prior's validation."""
    folder = os.path.join(os.environ["POSTERIOR_DATA"], "dsb2018_nuclei")
    prior = models.ScorePrior.load(PRIOR, (SIDE, SIDE), perturbation)
    clean = held_out(card_of(PRIOR), folder, "validation", 24, SIDE)[..., None]
    found = shared_errors(prior, clean, levels, noises=noises)
    print(f"\n{PRIOR}, {perturbation}: {found}")
    return np.array(list(found.values()))


def test_the_gaussian_score_knows_image_means_at_every_level():
    """A twentieth of the noise at most; where nothing is shared its error is as below."""
    found = shared_by_means("gaussian", (0.005, 0.01, 0.02, 0.04, 0.08, 0.16), 24)
    assert found.max() < 0.05 + 3 * np.sqrt(2 / 24) / 24


def test_image_means_of_thickening_are_not_much_too_narrow():
    """By what the score of counts shares, at worst: a bias adds up over exposures, those at sigma
    with sigma over the recording's level for their weight. 1.15 times, which would take 6 points
    from 50 % and 5 from 90 %, is as much as 64 patches cannot tell.
    """
    sigmas = np.array([0.2, 0.1, 0.05, 0.025, 0.0125])
    shared = shared_by_means("poisson", sigmas, 96)
    for full_well in (100, 25):
        later = sigmas <= 1 / np.sqrt(full_well)
        bias = np.sqrt(np.maximum(shared[later], 0)) * sigmas[later] * np.sqrt(full_well)
        off = -2 * np.trapezoid(bias, np.log(sigmas[later]))
        narrow = np.sqrt(1 + off**2)
        print(f"from {full_well} electrons: off by {off:.2f} of their sd, {narrow:.2f} too narrow")
        assert narrow < 1.15


def times_too_narrow(draws, truth):
    """Root mean square of errors (n,) over the spread of draws (n, draws), 1 if that is right, and
    its standard error; pictures of whose draws none differs are left out.
    """
    count, sd = draws.shape[1], draws.std(axis=1, ddof=1)
    known = sd > 0
    error = (draws.mean(axis=1) - truth)[known] / sd[known]
    # Student's t with count - 1 degrees of freedom, but for the mean's own error.
    squares = error**2 / ((1 + 1 / count) * (count - 1) / (count - 3))
    ratio = np.sqrt(squares.mean())
    return ratio, squares.std(ddof=1) / np.sqrt(known.sum()) / (2 * ratio)


@pytest.mark.parametrize("sigma", [0.2, 0.1, 0.05, 0.025])
def test_thickening_foretells_an_exposure_four_times_as_long(sigma):
    """Of pictures that no network was trained on, level by level: image means at most 1.15 times
    too narrow, areas, which are not calibrated, 1.3 times, as far as so many pictures tell.
    """
    folder = os.path.join(os.environ["POSTERIOR_DATA"], "dsb2018_nuclei")
    prior = models.ScorePrior.load(PRIOR, (SIDE, SIDE), "poisson")
    truth = held_out(card_of(PRIOR), folder, PART, PATCHES, SIDE)[..., None]
    found = longer_exposure(prior, truth, sigma, sigma / 2)
    asked = {"image mean": image_means} | {
        f"area above {t}": lambda images, t=t: bright_areas(images, t) for t in (0.2, 0.3, 0.4, 0.5)
    }
    print(
        f"\n{PRIOR}, {PART}, sigma {sigma} to {sigma / 2}, {found.draws.shape[:2]} patches, draws"
    )
    for name, summary in asked.items():
        drawn, shown = summary(found.draws), summary(found.truth)
        ratio, error = times_too_narrow(drawn, shown)
        p = uniform_p(drawn, shown)
        print(f"{name}: {ratio:.2f} +- {error:.2f} times too narrow, ranks uniform p {p:.2g}")
        assert ratio < (1.15 if name == "image mean" else 1.3) + 3 * error
