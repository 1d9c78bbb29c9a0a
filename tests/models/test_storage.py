"""Weights on disk: what is read back, what is refused, and what the shipped ones are worth."""

import json
import pickle
import shutil

import jax
import numpy as np
import pytest
from skimage.restoration import denoise_tv_chambolle

from posterior.diagnostics import psnr
from posterior.estimators import anscombe_denoised
from posterior.models import Poisson
from posterior.models.priors import EnergyPrior, ScorePrior
from posterior.models.priors.denoiser import Denoiser, Statistics
from posterior.models.priors.storage import (
    FOLDER,
    build_network,
    load_denoiser,
    read_card,
    save_weights,
    shipped,
)

NETWORK = {"type": "unet", "channels": 1, "widths": [4], "blocks": 1, "fine": 4}
SHAPE = (4, 4)


@pytest.fixture
def weights(tmp_path):
    """The path of a small saved network."""
    network = build_network(NETWORK, jax.random.key(0))
    denoiser = Denoiser(network, Statistics(0.3, 0.2, 0.01, 5.0, lowest=0.0))
    path = tmp_path / "small.safetensors"
    save_weights(path, denoiser, {"kind": "score", "network": NETWORK}, dtype="float32")
    return path


def change_card(path, **changes):
    card = json.loads(path.with_suffix(".json").read_text())
    path.with_suffix(".json").write_text(json.dumps(card | changes))


def test_saved_weights_come_back(weights):
    found = load_denoiser(weights, "score", "gaussian")
    expected = build_network(NETWORK, jax.random.key(0))
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)
    assert found.statistics == Statistics(0.3, 0.2, 0.01, 5.0, lowest=0.0)
    assert ScorePrior.load(weights, SHAPE).shape == SHAPE


def test_half_precision_is_read_as_single(weights):
    denoiser = load_denoiser(weights, "score", "gaussian")
    save_weights(weights, denoiser, {"kind": "score", "network": NETWORK})
    for a in jax.tree.leaves(load_denoiser(weights, "score", "gaussian")):
        assert a.dtype == np.float32


def test_weights_are_found_by_what_their_path_begins_with(weights, tmp_path, monkeypatch):
    for ending in (".safetensors", ".json"):
        weights.with_suffix(ending).rename(tmp_path / f"mine-gaussian-score{ending}")
    for name in (tmp_path / "mine", str(tmp_path / "mine")):
        assert load_denoiser(name, "score", "gaussian").statistics.mean == 0.3
    monkeypatch.chdir(tmp_path)
    assert load_denoiser("mine", "score", "gaussian").statistics.mean == 0.3
    with pytest.raises(ValueError, match="before -signal-score.safetensors"):
        load_denoiser("mine", "score", "signal")


def test_truncated_file_is_refused(weights):
    weights.write_bytes(weights.read_bytes()[:-10])
    with pytest.raises(ValueError, match="SHA-256 differs"):
        ScorePrior.load(weights, SHAPE)


def test_other_weights_under_this_name_are_refused(weights, tmp_path):
    network = build_network(NETWORK, jax.random.key(1))
    other = tmp_path / "other.safetensors"
    denoiser = Denoiser(network, Statistics(0.3, 0.2, 0.01, 5.0))
    save_weights(other, denoiser, {"kind": "score", "network": NETWORK})
    shutil.copy(other, weights)
    with pytest.raises(ValueError, match="was exchanged"):
        ScorePrior.load(weights, SHAPE)


def test_renamed_file_without_its_card_is_refused(weights, tmp_path):
    moved = weights.rename(tmp_path / "moved.safetensors")
    with pytest.raises(FileNotFoundError, match=r"no card .*moved.json"):
        ScorePrior.load(moved, SHAPE)


def test_weights_renamed_with_their_card_are_refused(weights, tmp_path):
    change_card(weights, name="small")
    assert load_denoiser(weights, "score", "gaussian").statistics.mean == 0.3
    for ending in (".safetensors", ".json"):
        weights.with_suffix(ending).rename(tmp_path / f"large{ending}")
    with pytest.raises(ValueError, match=r"named 'small': call the two files small.safetensors"):
        ScorePrior.load(tmp_path / "large.safetensors", SHAPE)


def test_shipped_weights_are_found_by_their_whole_name():
    found = load_denoiser("nuclei-signal-score", "score", "signal")
    assert found.statistics.perturbation == "signal"


def test_pickles_are_never_opened(weights):
    class Trap:
        def __reduce__(self):
            return pytest.fail, ("unpickled",)

    raw = pickle.dumps(Trap())
    weights.write_bytes(raw)
    import hashlib

    change_card(weights, sha256=hashlib.sha256(raw).hexdigest())
    with pytest.raises(ValueError, match="no readable safetensors file"):
        ScorePrior.load(weights, SHAPE)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"network": NETWORK | {"widths": [6]}}, "does not fit its card"),
        ({"network": NETWORK | {"blocks": 2}}, "in one of them alone"),
        ({"network": {"type": "magic"}}, "describes no network"),
        ({"statistics": {"mean": 1.0}}, "trained for the None perturbation"),
        ({"statistics": 3}, "no statistics"),
        ({"format": 99}, "has format 99"),
        ({"kind": "energy"}, "EnergyPrior"),
    ],
)
def test_cards_that_do_not_fit_are_refused(weights, changes, words):
    change_card(weights, **changes)
    with pytest.raises(ValueError, match=words):
        ScorePrior.load(weights, SHAPE)


def test_damaged_card_is_refused(weights):
    weights.with_suffix(".json").write_text("{")
    with pytest.raises(ValueError, match="no model card"):
        ScorePrior.load(weights, SHAPE)
    weights.with_suffix(".json").write_text("{}")
    with pytest.raises(ValueError, match="lacks format"):
        ScorePrior.load(weights, SHAPE)


def test_weights_for_another_problem_are_refused(weights):
    with pytest.raises(ValueError, match="trained for the 'gaussian' perturbation, not 'signal'"):
        ScorePrior.load(weights, SHAPE, perturbation="signal")
    with pytest.raises(ValueError, match="for real objects, not for complex"):
        ScorePrior.load(weights, SHAPE, dtype=complex)
    with pytest.raises(ValueError, match="load it as ScorePrior"):
        EnergyPrior.load(weights, SHAPE)
    with pytest.raises(ValueError, match="3 channels"):
        ScorePrior.load(weights, (4, 4, 3))
    with pytest.raises(
        ValueError,
        match=r"'nothing' for the gaussian perturbation: use one of cells, cells-large, com",
    ):
        ScorePrior.load("nothing", SHAPE)
    with pytest.raises(FileNotFoundError, match="no file"):
        ScorePrior.load("nothing.safetensors", SHAPE)


# ---- the weights that come with the project ------------------------------------------------------


def load_shipped(stem):
    name, perturbation, kind = stem.rsplit("-", 2)
    prior = {"score": ScorePrior, "energy": EnergyPrior}[kind]
    in_colour = read_card(FOLDER / f"{stem}.safetensors")["network"]["channels"] == 3
    return prior.load(name, (64, 64, 3) if in_colour else (64, 64), perturbation)


def blobs(count, size=64):
    """Round bright patches on a dark ground: cells as a child draws them."""
    rng = np.random.default_rng(5)
    rows, columns = np.mgrid[:size, :size]
    pictures = np.full((count, size, size), 0.05)
    for picture in pictures:
        for _ in range(6):
            top, left = rng.uniform(0, size, 2)
            radius, height = rng.uniform(5, 9), rng.uniform(0.3, 0.9)
            distance = np.hypot(rows - top, columns - left)
            picture[:] = np.maximum(picture, height / (1 + np.exp(2 * (distance - radius))))
    return pictures.astype(np.float32)


@pytest.mark.parametrize("stem", shipped())
def test_shipped_weights_are_small_and_documented(stem):
    path = FOLDER / f"{stem}.safetensors"
    assert path.stat().st_size <= 16e6
    card = read_card(path)
    assert {"data", "normalisation", "training", "validation", "limits"} <= set(card)
    assert "command" in card["training"] and "seconds" in card["training"]
    assert {"source", "licence", "validation", "test"} <= set(card["data"])
    assert not set(card["data"]["validation"]) & set(card["data"]["test"])
    assert load_shipped(stem).shape[:2] == (64, 64)


@pytest.mark.parametrize("stem", [s for s in shipped() if "nuclei-gaussian" in s])
@pytest.mark.parametrize("sigma", [0.1, 0.2])
def test_shipped_nuclei_denoise_better_than_total_variation(stem, sigma):
    """On drawn cells, with the weight of total variation chosen by looking at the truth."""
    prior, truth = load_shipped(stem), blobs(4)
    noisy = truth + sigma * np.random.default_rng(1).standard_normal(truth.shape)
    found = jax.jit(jax.vmap(lambda x: prior.denoise(x, sigma)))(noisy.astype(np.float32))
    variation = max(
        psnr(np.stack([denoise_tv_chambolle(n, weight=w) for n in noisy]), truth)
        for w in sigma * np.array([0.5, 1, 1.5, 2, 3])
    )
    assert psnr(np.asarray(found), truth) > variation


@pytest.mark.parametrize("full_well", [100, 25])
def test_shipped_denoiser_of_counts_beats_total_variation(full_well):
    """On drawn cells, through Anscombe's transform, its weight chosen by looking at the truth."""
    prior, truth = load_shipped("nuclei-poisson-score"), blobs(4)
    camera = Poisson(full_well)
    y = np.asarray(camera.sample(jax.random.key(1), truth))
    found = jax.jit(jax.vmap(lambda y: prior.denoise(y, camera.sigma0)))(y)

    def smooth(y, share):
        return anscombe_denoised(y, camera, lambda a, s: denoise_tv_chambolle(a, weight=share * s))

    shares = (0.5, 1, 1.5, 2, 3)
    variation = max(psnr(np.stack([smooth(image, s) for image in y]), truth) for s in shares)
    assert psnr(np.asarray(found), truth) > variation
