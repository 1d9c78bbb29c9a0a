"""`posterior prior`: the card in words, and draws of the prior alone."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from posterior import cli, models
from posterior.diagnostics.prior_plot import plot_prior
from posterior.models.priors.storage import FOLDER, card_of
from posterior.train import Preparation, picture_files, prepare

FEW = ("--size", "16", "--draws", "3", "--steps", "3", "--quiet")


def main(*arguments):
    with pytest.raises(SystemExit) as caught:
        cli.main(["prior", *map(str, arguments)])
    return caught.value.code or 0


@pytest.mark.parametrize(
    "name, words",
    [
        ("nuclei", "nuclei-poisson-score: score network of grey pictures under photon counts"),
        ("complex-cells", "score network of complex pictures under additive Gaussian noise"),
        ("nuclei-gaussian-energy", "energy network of grey"),
        (FOLDER / "nuclei-signal-score.safetensors", "signal-dependent error x + sqrt(x) e"),
    ],
)
def test_the_card_is_told(name, words, capsys):
    assert main(name) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert words in said
    assert "held out, sigma 0.1: " in said and "BM3D" in said and "-0 %" not in said
    assert "trained by: posterior train" in said and "limit: Trained on patches" in said


@pytest.mark.parametrize(
    "name, shape",
    [
        ("nuclei", (3, 16, 16)),
        ("complex-cells", (3, 16, 16)),
        pytest.param("faces", (3, 16, 16, 3), marks=pytest.mark.slow),
    ],
)
def test_draws_are_the_priors(name, shape, tmp_path):
    assert main(name, "--out", tmp_path, *FEW) == 0
    found = np.load(tmp_path / "draws.npy")
    assert found.shape == shape and np.iscomplexobj(found) == (name == "complex-cells")
    assert np.all(np.isfinite(found)) and len(np.unique(found.reshape(3, -1), axis=0)) == 3
    with Image.open(tmp_path / "draws.png") as picture:
        assert picture.size[0] > 200


def test_the_same_seed_gives_the_same_draws_and_another_does_not(tmp_path):
    found = []
    for i, seed in enumerate((0, 0, 1)):
        assert main("nuclei", "--out", tmp_path / str(i), *FEW, "--seed", seed) == 0
        found.append(np.load(tmp_path / str(i) / "draws.npy"))
    np.testing.assert_array_equal(found[0], found[1])
    assert not np.array_equal(found[0], found[2])


def training_pixels(name):
    """Of all pictures that the weights of counts were trained on."""
    card = card_of(name, "score", "poisson")
    held_out = {*card["data"]["validation"], *card["data"]["test"]}
    folder = Path(os.environ["POSTERIOR_DATA"]) / card["data"]["folder"]
    files = [file for file in picture_files(folder) if file.name not in held_out]
    how = Preparation(**card["preparation"])
    return np.concatenate([prepare(file, how).ravel() for file in files])


@pytest.mark.slow
def test_draws_are_as_bright_as_the_pictures_and_as_differently(tmp_path):
    """Means of 128 draws of nuclei by counts at 400 levels, beside those of training patches: their
    mean and their sd within three errors, of the sd that of a gamma variable. Of draws that begin
    from one brightness the sd was 0.08.
    """
    assert main("nuclei", "--out", tmp_path, "--draws", "128", "--steps", "400", "--quiet") == 0
    stats = models.ScorePrior.load("nuclei", (64, 64), "poisson").statistics
    drawn = np.load(tmp_path / "draws.npy")
    means = drawn.mean((1, 2))
    sd, ratio = means.std(ddof=1), stats.brightness_sd / stats.mean
    error, error_sd = sd / np.sqrt(128), sd * np.sqrt((2 + 6 * ratio**2) / 128) / 2
    print(f"\nmeans {means.mean():.3f} +- {error:.3f}, of the pictures {stats.mean}")
    print(f"their sd {sd:.3f} +- {error_sd:.3f}, of the pictures {stats.brightness_sd}")
    print(f"above 0.6: {100 * np.mean(drawn > 0.6):.1f} % of the pixels")
    if "POSTERIOR_DATA" in os.environ:
        print(f"of those of the pictures: {100 * np.mean(training_pixels('nuclei') > 0.6):.1f} %")
    assert abs(means.mean() - stats.mean) < 3 * error
    assert abs(sd - stats.brightness_sd) < 3 * error_sd


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        (("nowhere",), "no score weights 'nowhere'"),
        (("nuclei-signal-score", "--out", "{}/new"), "come out far too dark"),
        (("nuclei", "--out", "{}/new", "--size", "17"), "multiples of"),
        (("nuclei", "--out", "{}/new", "--draws", "0"), "--draws 0: give 1 or more"),
        (("nuclei", "--out", "{}/new", "--steps", "1"), "--steps 1: give 2 or more"),
        (("nuclei", "--out", "{}"), "already holds draws.npy"),
    ],
)
def test_refusals_are_one_sentence(arguments, sentence, tmp_path, capsys):
    (tmp_path / "draws.npy").write_bytes(b"mine")
    assert main(*[a.format(tmp_path) for a in arguments]) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1
    assert not (tmp_path / "new").exists()
    assert (tmp_path / "draws.npy").read_bytes() == b"mine"


def test_what_is_no_picture_is_not_drawn():
    with pytest.raises(ValueError, match=r"draws of shape \(3, 4\): give"):
        plot_prior(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="shape"):
        plot_prior(np.zeros((2, 4, 4, 2)))
    assert len([axes for axes in plot_prior(np.ones((5, 4, 4, 3))).axes if axes.images]) == 5
    grey = plot_prior(np.linspace(0, 2, 80).reshape(5, 4, 4))
    assert len([axes for axes in grey.axes if axes.images]) == 5
    assert grey.axes[0].images[0].norm.vmax > 1.9
    assert len([a for a in plot_prior(1j * np.ones((5, 4, 4))).axes if a.images]) == 10
