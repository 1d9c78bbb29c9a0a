"""The denoising study: recordings, figures that are known, the table, and the command."""

import dataclasses

import jax
import numpy as np
import pytest
from PIL import Image

from posterior import models
from posterior.diagnostics.fidelity import psnr
from posterior.models.priors.denoiser import Denoiser, Statistics
from posterior.models.priors.storage import build_network, card_of, save_weights
from posterior.studies import SYSTEMS, Answer, Denoising, as_table, held_out, judged
from posterior.studies.denoising import electrons
from posterior.train import Preparation
from studies_command import assert_refused, exit_code

SIDE = 16


@pytest.fixture(scope="module")
def truths():
    rows, columns = np.mgrid[:SIDE, :SIDE] / SIDE
    blob = np.exp(-((rows - 0.5) ** 2 + (columns - 0.4) ** 2) / 0.05)
    return np.stack([0.1 + 0.8 * blob, 0.1 + 0.6 * blob.T]).astype(np.float32)


def study(truths, bits=8):
    return Denoising(truths, "nuclei", bits, draws=3, seed=0)


def test_every_system_sees_the_same_recording(truths):
    """Counts of 1/sigma_0^2 electrons behind the ADC; another recording for another picture."""
    recording = study(truths).recording("0.1", 1)
    assert recording.camera == models.Poisson(100, 8)
    np.testing.assert_array_equal(study(truths).recording("0.1", 1).y, recording.y)
    key = recording.key
    assert not np.array_equal(key, study(truths).recording("0.1", 0).key)
    sd = np.sqrt(truths[1] * 0.1**2)
    assert 0.8 < np.std((recording.y - truths[1]) / sd) < 1.2
    np.testing.assert_array_equal(study(truths)("recording", "0.1", 1), recording.y[None])


def test_the_counts_network_answers_in_one_evaluation(truths):
    work = study(truths, bits=None)
    y = work.recording("0.1", 0).y
    prior = models.ScorePrior.load("nuclei", y.shape, "poisson")
    direct = prior.denoise(y, 0.1)
    np.testing.assert_allclose(work("MMSE", "0.1", 0)[0], direct, atol=2e-5)


def systems():
    quick = ("recording", "MMSE", "RED", "thickening")
    return [
        pytest.param(name, marks=[] if name in quick else [pytest.mark.slow])
        for name in SYSTEMS
        if name != "VST + BM3D by planes"  # these pictures have one
    ]


@pytest.mark.parametrize("name", systems())
def test_every_system_comes_closer_to_the_truth_than_the_recording(truths, name):
    """The mean of its draws does."""
    if "BM3D" in name:
        pytest.importorskip("bm3d")
    work = study(truths)
    images = work(name, "0.2", 0)
    assert images.shape == (3 if SYSTEMS[name].samples else 1, SIDE, SIDE)
    assert np.all(np.isfinite(images))
    recorded = psnr(work("recording", "0.2", 0)[0], truths[0])
    if name != "DPS":  # which may take a picture like no nucleus for an empty field
        assert psnr(images.mean(axis=0), truths[0]) >= recorded


def test_kawars_published_schedule_is_that_of_song_and_ermon(truths):
    """As many levels as theirs below the noise, to 0.01, steps of 3.3e-6 (sigma_t / 0.01)^2."""
    posterior = study(truths).recording("0.1", 0).posterior("gaussian")
    sampler = SYSTEMS["Kawar, published"].answer.keywords["build"](posterior)
    assert sampler.sigma_min == 0.01
    assert abs(sampler.levels - np.sum(np.geomspace(90, 0.01, 500) < 0.1)) <= 1
    assert sampler.step_size * 0.05**2 == pytest.approx(3.3e-6 * (0.05 / 0.01) ** 2)


def answer_of(rng, truths, spread=1.0, draws=20, sd=0.1):
    """Draws of exact posteriors about the means, `spread` times too wide."""
    means = truths + sd * rng.standard_normal(truths.shape)
    noise = sd * spread * rng.standard_normal((len(truths), draws, *truths.shape[1:]))
    return Answer(means[:, None] + noise, np.array([50.0, *[2.0] * (len(truths) - 1)]), 3 * 10**8)


@pytest.mark.parametrize("spread, right", [(1.0, True), (0.6, False)])
def test_figures_of_normal_posteriors(spread, right):
    """PSNR of a mean with error sd^2 (1 + spread^2/20) and of a draw, coverage, CRPS, medians."""
    rng = np.random.default_rng(0)
    truths = rng.uniform(size=(60, SIDE, SIDE))
    found = judged(answer_of(rng, truths, spread), truths)
    pixels = truths.size

    def near(name, mean_square):
        # The logarithm of a mean of `pixels` squares of normal errors.
        error = 10 / np.log(10) * np.sqrt(2 / pixels)
        assert abs(found[name] + 10 * np.log10(mean_square)) < 5 * error + 0.01, name

    near("psnr", 0.01 * (1 + spread**2 / 20))
    near("draw psnr", 0.01 * (1 + spread**2))
    assert abs(found["spread"] / spread - 1) < 0.03
    shares = np.array([found[name] for name in ("pixels", "blocks", "image mean")])
    off = np.abs(shares[:, [0, 2]] - [0.5, 0.9]) / shares[:, [1, 3]]
    assert (off.max() < 4) == right, shares
    assert found["seconds"] == 0.1 and found["memory"] == 300
    # Of a normal forecast s wide whose centre errs by sd: Gneiting and Raftery (2007), averaged.
    s = spread
    exact = 0.1 * (np.sqrt(2 * (1 + s**2) / np.pi) - s / np.sqrt(np.pi))
    assert abs(found["crps"] / exact - 1) < 0.02


def test_the_table_has_the_papers_figures_and_says_who_did_not_answer(truths):
    rng = np.random.default_rng(0)
    answers = {
        "MMSE": answer_of(rng, truths, draws=1),
        "annealed, printed": answer_of(rng, truths),
        "VST + BM3D": Answer(np.empty(0), np.empty(0), 0, "recording 0: BM3D is not installed"),
    }
    table = as_table("0.1", answers, truths)
    assert "| 34.5 |" in table and "| 32.8 |" in table
    assert table.count("| 0.98 |") == 2, "the paper's SSIM of both"
    assert "- VST + BM3D: no answer to recording 0: BM3D is not installed" in table
    assert "| 30.9 |" in as_table("0.20", answers, truths)
    assert "| 34.5 |" not in as_table("0.15", answers, truths)


@pytest.fixture
def folder(tmp_path):
    """Pictures under the names that the card of `nuclei` holds out."""
    rng = np.random.default_rng(0)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in card_of("nuclei")["data"]["test"][:3]:
        picture = np.kron(rng.integers(0, 255, (6, 8)), np.ones((4, 4))).astype(np.uint8)
        Image.fromarray(picture).save(pictures / name)
    return pictures


def test_patches_are_those_of_the_card_and_the_same_each_time(folder):
    found = held_out(card_of("nuclei"), folder, "test", 3, SIDE)
    assert found.shape == (3, SIDE, SIDE) and found.dtype == np.float32
    assert found.min() >= 0 and found.max() == 1
    np.testing.assert_array_equal(found[:2], held_out(card_of("nuclei"), folder, "test", 2, SIDE))
    with pytest.raises(ValueError, match=r"\(24, 32\): smaller than 25 x 25"):
        held_out(card_of("nuclei"), folder, "test", 3, 25)
    with pytest.raises(ValueError, match="lists 96 test pictures, not 97"):
        held_out(card_of("nuclei"), folder, "test", 97, SIDE)


@pytest.fixture
def coloured(tmp_path):
    """Weights of a small network in colour, and the two pictures that its card holds out."""
    network = {"type": "unet", "channels": 3, "widths": [4], "blocks": 1, "fine": 4}
    built = build_network(network, jax.random.key(0))
    rng = np.random.default_rng(0)
    names = ["a.png", "b.png"]
    for name in names:
        picture = rng.integers(0, 255, (SIDE, SIDE, 3)).astype(np.uint8)
        Image.fromarray(picture).save(tmp_path / name)
    how = Preparation("colour")
    card = {
        "kind": "score", "network": network, "data": {"test": names},
        "preparation": dataclasses.asdict(how),
    }  # fmt: skip
    for perturbation in ("gaussian", "poisson"):
        denoiser = Denoiser(built, Statistics(0.5, 0.3, 0.01, 5.0, perturbation, lowest=0.0))
        name = f"mine-{perturbation}-score"
        save_weights(tmp_path / f"{name}.safetensors", denoiser, {"name": name, **card})
    return tmp_path


def test_pictures_in_colour_are_studied_as_others_are(coloured, capsys):
    """Systems of the errors that the prior has answer; that of one it lacks says so."""
    systems = ("recording", "RED", "thickening", "annealed, signal")
    options = [word for name in systems for word in ("--system", name)]
    prior = str(coloured / "mine")
    assert not run(coloured, coloured / "out", *options, "--sigma", "0.1", "--prior", prior)
    table = capsys.readouterr().out
    assert "| RED |" in table and "| thickening |" in table
    assert "- annealed, signal: no answer to recording 0: no score weights" in table


def test_block_matching_sees_the_colours_together(truths):
    """It comes closer to a picture whose colours are shades of one than plane by plane."""
    pytest.importorskip("bm3d")
    study_of = lambda pictures: Denoising(pictures, "nuclei", None, draws=2, seed=0)  # noqa: E731
    coloured = truths[..., None] * np.array([1.0, 0.7, 0.4], np.float32)
    together = study_of(coloured)("VST + BM3D", "0.2", 0)[0]
    assert together.shape == coloured[0].shape
    apart = study_of(coloured)("VST + BM3D by planes", "0.2", 0)[0]
    alone = study_of(coloured).recording("0.2", 0)
    alone = SYSTEMS["VST + BM3D"].answer(alone._replace(y=alone.y[..., 1]))[0]
    np.testing.assert_array_equal(apart[..., 1], alone)
    assert psnr(together, coloured[0]) > psnr(apart, coloured[0]) + 0.5
    with pytest.raises(ValueError, match="one plane"):
        study_of(truths)("VST + BM3D by planes", "0.2", 0)


def test_figures_in_colour_are_those_of_the_planes():
    rng = np.random.default_rng(0)
    truths = rng.uniform(size=(6, SIDE, SIDE, 3))
    draws = truths[:, None] + 0.1 * rng.standard_normal((6, 5, *truths.shape[1:]))
    found = judged(Answer(draws, np.ones(6), 0), truths)
    planes = np.moveaxis(draws, -1, 2).reshape(6, 5, 3 * SIDE, SIDE)
    beside = np.moveaxis(truths, -1, 1).reshape(6, 3 * SIDE, SIDE)
    grey = judged(Answer(planes, np.ones(6), 0), beside)
    for name in ("psnr", "crps", "spread", "pixels", "blocks"):
        np.testing.assert_allclose(found[name], grey[name], rtol=1e-9)


def run(folder, out, *options):
    few = ("--pictures", 2, "--size", SIDE, "--draws", 2)
    return exit_code("denoising", out, "--data", folder, *few, *options)


def test_the_command_writes_the_table_and_the_picture(folder, tmp_path, capsys):
    options = ("--system", "recording", "--system", "RED", "--sigma", "0.1")
    assert not run(folder, tmp_path / "out", *options)
    table = (tmp_path / "out" / "study.md").read_text()
    assert (
        f"2 test pictures of the prior nuclei, {SIDE}x{SIDE}" in table and "- RED: Romano" in table
    )
    assert capsys.readouterr().out == table
    assert "| RED |" in table and "## sigma_0 = 0.1" in table
    with Image.open(tmp_path / "out" / "study.png") as picture:
        assert picture.size[0] > 300
    assert run(folder, tmp_path / "out", *options, "--seed", "1") == 2
    assert "is of another campaign" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options, words",
    [
        (("--system", "magic"), "unknown system 'magic'"),
        (("--sigma", "2"), "sigma_0 2"),
        (("--sigma", "dark"), "sigma_0 dark"),
        (("--pictures", "1"), "--pictures 1"),
        (("--part", "train"), "--part train"),
        (("--prior", "nowhere"), "nowhere"),
        (("--pictures", "4"), "no file"),
        (("--bits", "17"), "17"),
        (("--headroom", "-1"), "headroom -1"),
        (("--features", "inception"), "--features inception"),
    ],
)
def test_the_command_refuses_in_a_sentence(folder, tmp_path, capsys, options, words):
    out = tmp_path / "out"
    assert_refused(run(folder, out, *options), out, capsys, words)


def test_noise_levels_are_of_whole_electrons():
    assert [electrons(c) for c in ("0.025", "0.05", "0.1", "0.2")] == [1600, 400, 100, 25]


def test_a_well_with_headroom_does_not_clip_white():
    """White is 1 on average then; a well that white fills loses 0.4 of its noise's sd."""
    white = np.ones((1, 64, 64), np.float32)
    means = {
        headroom: float(
            Denoising(white, "nuclei", None, 2, 0, headroom).recording("0.2", 0).y.mean()
        )
        for headroom in (0.0, 3.0)
    }
    assert abs(means[3.0] - 1) < 4 * 0.2 / 64
    assert means[0.0] < 1 - 0.3 * 0.2


def test_the_table_tells_pictures_from_smooth_answers_and_says_by_what():
    """Exact draws are at the floor; their means, one a recording, are not."""
    rng = np.random.default_rng(0)
    means = rng.uniform(size=(16, 1, SIDE, SIDE))
    images = means + 0.2 * rng.standard_normal((16, 21, SIDE, SIDE))
    pictures, exact = images[:, 0], Answer(images[:, 1:], np.ones(16), 0)
    smooth = exact._replace(images=means)
    table = as_table("0.1", {"annealed": exact, "MMSE": smooth}, pictures)
    cells = [row.split("|")[8].split() for row in table.splitlines() if row.startswith("| ")][1:]
    (near, *_, p), (far, *_, small) = cells
    assert float(far) > 3 * float(near)
    assert float(small.strip("()")) < 0.05 < float(p.strip("()"))
    assert "Haar bands of 8x8 patches" in table and "Two halves of the truths" in table
