"""The calibration in a card: right for right draws, and wrong for each way to be wrong."""

import json
import shutil

import numpy as np
import pytest
import scipy.stats
from PIL import Image

from posterior import cli, models, prior_calibration
from posterior.cli.words import doubts, missed
from posterior.diagnostics.coverage import coverage
from posterior.diagnostics.regions import bright_areas
from posterior.models.priors.storage import FOLDER
from posterior.prior_calibration import calibration, measured_by, worth

# How many truths each counts, of 400 pictures of 32 x 32, where pixels are independent.
UNITS = {"inside": 1024, "inside_8x8_means": 16, "inside_image_means": 1, "inside_bright_areas": 1}
KINDS = ("inside", "inside_8x8_means", "inside_image_means", "inside_bright_areas")


def centred(noise, seed=0):
    """Truths and draws (400, 17, 32, 32) that are exchangeable if `noise` is alike in all."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((400, 1, 32, 32)) + noise(rng)


def white(rng):
    return rng.standard_normal((400, 17, 32, 32))


def even(rng):
    """The same in all pixels of a picture."""
    return rng.standard_normal((400, 17, 1, 1))


def four_errors(truths):
    """Of a share of so many truths, and what rounding to three digits adds."""
    return 4 * np.sqrt(15 * 2) / 17 / np.sqrt(truths) + 0.0005


def check_exact(found, noise):
    """Shares, and spread over error: a ratio of two sds, of 15 degrees of freedom and of one."""
    assert found["nominal"] == 0.882
    for name in KINDS:
        assert abs(found[name] - 15 / 17) < four_errors(400 * units(noise, name)), name
    ratio = 4 * np.sqrt(1 / 2 + 1 / 30) / np.sqrt(400 * units(noise, "inside")) + 0.0005
    assert abs(found["spread_over_error"] - 1) < ratio


def units(noise, name):
    return UNITS[name] if noise is white else 1


@pytest.mark.parametrize("noise", [white, even, lambda rng: white(rng) + even(rng)])
def test_exact_draws_hold_as_many_truths_as_they_say(noise):
    """Within four standard errors of as many truths as are independent, or of 400 pictures."""
    images = centred(noise)
    check_exact(worth(images[:, 1:], images[:, 0], 0.5), noise)


def test_areas_of_no_pixel_are_held_as_often_as_others():
    """Dark pictures: every area is 0, and a truth lies where chance puts it among such draws."""
    images = centred(white) - 100
    found = worth(images[:, 1:], images[:, 0], 0.5)
    assert abs(found["inside_bright_areas"] - 15 / 17) < four_errors(400)


def test_areas_of_truths_in_grey_levels_are_those_of_the_light_behind():
    """Steps of a third of a sd, the threshold just above one: as they stand the area lacks 0.06,
    four of its own sds, and no interval holds it; of truths spread over their levels as many do as
    say so.
    """
    images = centred(white)
    truth, draws = np.round(3 * images[:, 0]) / 3, images[:, 1:]
    found = worth(draws, truth, 0.34)
    assert abs(found["inside_bright_areas"] - 15 / 17) < four_errors(400)
    rng = np.random.default_rng(0)
    areas = bright_areas(draws, 0.34), bright_areas(truth, 0.34)
    assert coverage(*areas, 15 / 17, rng).share < 0.2


def test_draws_ten_percent_too_narrow_are_known():
    """About a centre that knows nothing of the truth: in spread, pixels and blocks, by as much as
    one tenth is: a t of 15 degrees holds 0.853 of what it held 0.882 of.
    """
    rng = np.random.default_rng(0)
    centre = rng.standard_normal((400, 1, 32, 32))
    truth, draws = (centre + white(rng))[:, 0], (centre + 0.9 * white(rng))[:, 1:]
    found = worth(draws, truth, 0.5)
    assert found["spread_over_error"] < 0.95
    for name in ("inside", "inside_8x8_means"):
        assert found[name] < 15 / 17 - four_errors(400 * UNITS[name]), name
    with pytest.raises(AssertionError):
        check_exact(found, white)


def test_right_pixels_of_wrong_pictures_are_known():
    """Draws without the error that all pixels of a truth share, each pixel as wide as it is."""
    rng = np.random.default_rng(1)
    truth = white(rng)[:, 0] + even(rng)[:, 0]
    found = worth(np.sqrt(2) * white(rng)[:, 1:], truth, 0.5)
    assert abs(found["inside"] - 15 / 17) < four_errors(400)
    assert all(found[name] < 0.6 for name in KINDS[1:])


def test_colour_is_judged_by_planes():
    rng = np.random.default_rng(2)
    images = rng.standard_normal((200, 17, 16, 16, 3))
    found = worth(images[:, 1:], images[:, 0], 0.5)
    truths = {"inside": 256, "inside_8x8_means": 4, "inside_image_means": 1, KINDS[3]: 1}
    for name, count in truths.items():
        assert abs(found[name] - 15 / 17) < four_errors(200 * 3 * count), name


@pytest.mark.parametrize(
    "name, kind, words",
    [
        ("nuclei", models.EnergyPrior, "an energy takes hours"),
        ("complex-cells", models.ScorePrior, "of complex objects"),
    ],
)
def test_what_cannot_be_measured_is_refused(name, kind, words):
    with pytest.raises(ValueError, match=words):
        calibration(kind.load(name, (16, 16)), np.ones((2, 16, 16, 2)))


def test_the_sampler_is_that_of_a_run_that_asks_for_none():
    load = models.ScorePrior.load
    assert measured_by(load("nuclei", (16, 16), "poisson")) == "thickening"
    assert measured_by(load("nuclei", (16, 16))) == "annealed"
    assert measured_by(load("nuclei", (16, 16), "signal")) == "annealed"


def main(*arguments):
    with pytest.raises(SystemExit) as caught:
        cli.main(["prior", *map(str, arguments)])
    return caught.value.code or 0


@pytest.fixture
def weights(tmp_path):
    """Weights of one's own, two pictures held out, and the folder of these."""
    stem = "nuclei-poisson-score"
    shutil.copy(FOLDER / f"{stem}.safetensors", tmp_path / f"{stem}.safetensors")
    card = json.loads((FOLDER / f"{stem}.json").read_text())
    card["data"]["validation"] = ["a.png", "b.png"]
    del card["validation"]["calibration"]
    (tmp_path / f"{stem}.json").write_text(json.dumps(card))
    rng = np.random.default_rng(3)
    for name in ("a.png", "b.png"):
        Image.fromarray(rng.integers(0, 256, (16, 16), np.uint8)).save(tmp_path / name)
    return tmp_path / f"{stem}.safetensors"


def test_weights_are_calibrated_and_their_card_says_so(weights, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(prior_calibration, "FULL_WELLS", (100,))
    before = weights.read_bytes()
    assert main(tmp_path / "nuclei", "--calibrate", tmp_path, "--quiet") == 0
    said = " ".join(capsys.readouterr().out.split())
    card = json.loads(weights.with_suffix(".json").read_text())
    (found,) = card["validation"]["calibration"].values()
    assert found["sampler"] == "thickening" and set(KINDS) < set(found)
    assert f"{100 * found['inside_8x8_means']:.0f} % of 8x8 means" in said
    assert "denoising_psnr_db" in card["validation"] and weights.read_bytes() == before


def test_a_missing_picture_is_named_and_the_card_left_alone(weights, tmp_path, capsys):
    (tmp_path / "b.png").unlink()
    before = weights.with_suffix(".json").read_text()
    assert main(weights, "--calibrate", tmp_path) == 2
    said = capsys.readouterr().err
    assert "b.png" in said and said.count("\n") == 1
    assert weights.with_suffix(".json").read_text() == before


def test_a_card_without_its_pictures_is_refused(weights, tmp_path, capsys):
    path = weights.with_suffix(".json")
    card = json.loads(path.read_text())
    del card["data"]
    path.write_text(json.dumps(card))
    assert main(weights, "--calibrate", tmp_path) == 2
    said = capsys.readouterr().err
    assert "does not list the pictures held out" in said and said.count("\n") == 1


# ---- what a run says of it -----------------------------------------------------------------------


def told(sampler, picture=True, **row):
    """What stands against a denoising run under a card with that calibration, the rest being right.

    `picture`: whether the recording is of the object itself.
    """
    row = {"sampler": "annealed", "nominal": 0.882, "inside": 0.85} | row
    card = {"validation": {"calibration": {"100": row}}}
    return " ".join(doubts({"rhat": 1.0}, sampler, card, np.ones((4, 4)) if picture else None))


def test_a_run_tells_what_the_card_knows_of_its_sampler():
    assert "held 85 % of pixels at full well 100 (88 % is right)" in told("annealed")
    assert "do not state" not in told("annealed", inside_image_means=0.8)
    assert "do not state image means from it" in told("annealed", inside_image_means=0.7)
    both = told("annealed", inside_image_means=0.7, inside_bright_areas=0.5)
    assert "70 % of image means" in both and "do not state image means or bright areas" in both


def test_right_intervals_are_rarely_advised_against_and_wrong_ones_nearly_always():
    """Of 32 pictures, every count of truths that 16 draws may hold: at most 1 % of right ones, and
    not next to none; of those that hold 60 % of truths for 88 % the share that so few can find,
    94 %, and of those that hold half of what they say all but one in a thousand.
    """
    held = np.arange(33)
    advised = np.array([missed(round(k / 32, 3), 0.882, 32) for k in held])
    shares = (15 / 17, 0.6, 0.44)
    right, wrong, half = (scipy.stats.binom(32, p).pmf(held)[advised].sum() for p in shares)
    assert 0.001 < right <= 0.01
    assert abs(wrong - 0.9425) < 1e-4 and half > 0.999


def test_a_run_of_another_kind_is_told_that_the_card_knows_nothing():
    for said in (told("dps"), told("annealed", picture=False)):
        assert "of denoising by annealed alone" in said and "85 %" not in said
