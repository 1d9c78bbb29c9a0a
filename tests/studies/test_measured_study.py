"""The study of captures: what is cut, foretold and left over, on cameras that are known."""

import numpy as np
import pytest
from PIL import Image

from posterior.estimators import PhotonTransfer
from posterior.studies import (
    Answer,
    Captures,
    Measured,
    judged_capture,
    left_halves_of,
    left_over,
    measured_table,
    read_captures,
)
from studies_command import assert_refused, exit_code

GAIN, OFFSET, FRAMES, SIDE, PATCHES = 5, 5, 50, 32, 12
SHAPE, RATE = 4.0, 0.4  # of the gamma distribution that photons are drawn from


def field_of(rng, light, frames=FRAMES):
    """Of `light` (h, w) photons: gain and offset whole, so that grey levels round nothing."""
    counts = np.minimum(rng.poisson(light, (frames, *light.shape)), (255 - OFFSET) // GAIN)
    grey = OFFSET + GAIN * counts
    return Captures(
        grey[:4].astype(np.uint8), grey.mean(axis=0), frames, PhotonTransfer(GAIN, OFFSET, 0, 0)
    )


@pytest.fixture(scope="module")
def fields():
    rng = np.random.default_rng(0)
    return {f"field{i}": field_of(rng, rng.gamma(SHAPE, 1 / RATE, (96, 96))) for i in range(2)}


def study_of(fields, draws=8):
    return Measured(fields, "cells", SIDE, draws, seed=0)


def exact(study, name, spread=1.0, draws=30):
    """Draws of the posterior of each patch: gamma, as its pixels are; `spread` times as wide."""
    rng, images = np.random.default_rng(1), []
    for i in range(PATCHES):
        recording = study.recording(name, i)
        well = recording.camera.full_well
        counts = np.asarray(recording.y, float) * well
        x = rng.gamma(SHAPE + counts, 1 / (RATE + 1), (draws, *counts.shape))
        mean = (SHAPE + counts) / (RATE + 1)
        images.append((mean + spread * (x - mean)) / well)
    return Answer(np.stack(images), np.ones(PATCHES), 0)


def test_a_patch_is_cut_from_capture_and_average_alike(fields):
    study = study_of(fields)
    for i in (0, 5):
        y = np.asarray(study.recording("field0", i).y, float)
        well = study.recording("field0", i).camera.full_well
        assert well == (255 - OFFSET) // GAIN
        truth = study.truth("field0", i, scaled=False) * 255
        noise = OFFSET + GAIN * y * well - truth
        # Photon noise of the patch, and nothing else: another place would add the scene's.
        expected = GAIN * (truth - OFFSET).mean()
        error = expected * np.sqrt(2 / noise.size)
        assert abs((noise**2).mean() / (1 - 1 / FRAMES) - expected) < 5 * error
    first, fifth = (study.recording("field0", i).y for i in (0, 4))
    assert not np.array_equal(first, fifth)
    np.testing.assert_array_equal(first, study_of(fields).recording("field0", 0).y)


@pytest.mark.parametrize("spread, right", [(1.0, True), (0.8, False)])
def test_averages_that_exact_draws_foretell_cover_the_average(fields, spread, right):
    """Its own error, and the capture's share in it, included: 50 and 90 % are 50 and 90 %."""
    study = study_of(fields)
    found = judged_capture(study, "field0", exact(study, "field0", spread), scaled=False)
    half, half_error, most, most_error = found["pixels"]
    assert max(abs(half - 0.5) / half_error, abs(most - 0.9) / most_error) < 4 or not right
    assert right or abs(half - 0.5) > 8 * half_error
    assert right == (abs(found["spread"] - 1) < 0.05)


def test_draws_that_are_taken_for_the_average_miss_it(fields):
    """What the average's own error and the capture's share in it are worth: 3 % of the spread."""
    study = study_of(fields)
    answer = exact(study, "field0", draws=60)
    truths = np.stack([study.truth("field0", i, False) for i in range(PATCHES)])
    grey = study.fields["field0"].to_grey(answer.images)
    foretold = np.stack([study.predicted("field0", i, answer.images[i]) for i in range(PATCHES)])
    assert foretold.shape == grey.shape
    # Given the object: the capture is 1 of 50, the sum of the others has their photon noise.
    light = np.maximum(answer.images, 0) * study.fields["field0"].camera.full_well
    added = (GAIN / 255) ** 2 * ((FRAMES - 1) * light / FRAMES**2).mean()
    shrunk = ((FRAMES - 1) / FRAMES) ** 2 * grey.var(axis=1, ddof=1).mean()
    assert foretold.var(axis=1, ddof=1).mean() == pytest.approx(shrunk + added, rel=0.01)
    assert abs((foretold.mean(axis=1) - truths).mean()) < 5 * grey.std() / np.sqrt(truths.size)


def test_a_control_is_of_the_average_and_of_the_cameras_own_noise(fields):
    study = study_of(fields)._replace(simulated=True)
    total, error = 0.0, 0.0
    for i in range(PATCHES):
        recording = study.recording("field0", i)
        truth = study.truth("field0", i, scaled=True)
        np.testing.assert_array_equal(truth, study.truth("field0", i, scaled=False))
        field, well = study.fields["field0"], recording.camera.full_well
        light = field.to_object(truth) * well
        np.testing.assert_allclose(field.to_grey(light / well), truth)
        total += ((np.asarray(recording.y) * well - light) ** 2 - light).sum()
        error += (2 * light**2 + light).sum()
        recording.camera.check(np.asarray(recording.y))
    assert abs(total) < 4 * np.sqrt(error)
    images = np.asarray(recording.y)[None]
    np.testing.assert_array_equal(study.predicted("field0", 0, images), field.to_grey(images))


def test_halves_to_learn_from_and_to_be_tested_on_have_no_pixel_in_common(fields):
    """The right half is brighter; the units are the camera's."""
    rng = np.random.default_rng(3)
    places = np.hstack([rng.integers(20, 100, (96, 48)), rng.integers(150, 240, (96, 48))])
    field = fields["field0"]._replace(average=places.astype(float))
    study = study_of({"field": field})._replace(right=True)
    for i in range(PATCHES):
        found = np.rint(study.truth("field", i, scaled=False) * 255)
        assert found.min() >= 150
    parts = left_halves_of(field)
    assert [part.shape for part in parts] == [(24, 48)] * 4
    np.testing.assert_allclose(255 * field.to_grey(np.vstack(parts)), places[:, :48], atol=1e-4)
    with pytest.raises(
        ValueError, match=r"right half of \(96, 96\) field is smaller than --size 64"
    ):
        study._replace(side=64).truth("field", 0, scaled=False)


def test_the_light_of_a_capture_is_found_and_taken_out():
    rng = np.random.default_rng(2)
    light = 3 + 9 * np.kron(rng.uniform(size=(12, 12)), np.ones((8, 8)))
    field = field_of(rng, light)
    dimmer = rng.poisson(0.8 * light) * GAIN + OFFSET
    field = field._replace(captures=np.stack([dimmer, *field.captures[1:]]).astype(np.uint8))
    error = 1 / np.sqrt(light.sum())
    assert abs(field.light(0) - 0.8) < 5 * error and abs(field.light(1) - 1) < 5 * error
    assert abs(field.expected(0, scaled=True).mean() - dimmer.mean()) < 1e-6
    np.testing.assert_array_equal(field.expected(0, scaled=False), field.average)


def test_the_noise_model_holds_where_it_is_true_and_not_where_it_is_not(fields):
    """For the truth, and with draws in its place: their residuals need no truth."""
    found = fields["field0"].residuals(1)
    assert min(check.p for check in found) > 0.001
    mixed = fields["field0"].captures.astype(float)
    mixed = (mixed + 0.1 * np.roll(mixed, 1, axis=2)) / 1.1
    slow = fields["field0"]._replace(captures=np.round(mixed).astype(np.uint8))
    assert slow.residuals(1).rows.p < 1e-6
    study = study_of(fields)
    answer = exact(study, "field0")
    for name, nominal in (("square", 1), ("rows", 0), ("blocks", 1)):
        value, error = left_over(study, "field0", answer, name)
        assert abs(value - nominal) < 4 * error, name
    value, error = left_over(study, "field0", exact(study, "field0", spread=0.0), "square")
    assert value < 1 - 10 * error


def test_the_table_says_both_lights_and_who_did_not_answer(fields):
    study = study_of(fields)
    once = exact(study, "field0", draws=1)
    answers = {
        "recording": once,
        "annealed": exact(study, "field0"),
        "MMSE": Answer(np.empty(0), np.empty(0), 0, "recording 0: no weights"),
    }
    table = measured_table(study, "field0", answers)
    rows = [line for line in table.splitlines() if line.startswith("|")]
    assert len(rows) == 4 and len({row.count("|") for row in rows}) == 1
    assert "- MMSE: no answer to recording 0: no weights" in table


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:64, :64] * (2 * np.pi / 64)
    light = 6.5 + 5.5 * np.sin(3 * rows) * np.cos(2 * columns)
    field = field_of(rng, light)
    for name in ("raw", "gt"):
        (tmp_path / "fmd" / name).mkdir(parents=True)
    for i, capture in enumerate(field.captures):
        Image.fromarray(capture).save(tmp_path / f"fmd/raw/Wide_A_{i + 1}.png")
    average = np.round(field.average).astype(np.uint8)
    Image.fromarray(average).save(tmp_path / "fmd/gt/Wide_A_1.png")
    return tmp_path / "fmd"


def run(folder, out, *options):
    few = ("--pictures", 2, "--size", 16, "--draws", 2)
    return exit_code("measured", out, "--data", folder, *few, *options)


def test_the_command_writes_the_table_and_the_picture(folder, tmp_path, capsys):
    options = ("--system", "recording", "--system", "RED")
    assert not run(folder, tmp_path / "out", *options)
    table = (tmp_path / "out" / "study.md").read_text()
    assert capsys.readouterr().out == table
    assert "## Does the noise model hold?" in table and "## Wide_A" in table and "| RED |" in table
    transfer = read_captures(folder, "Wide_A").transfer
    assert f"| {transfer.gain:.2f} ± {transfer.gain_error:.2f} |" in table
    with Image.open(tmp_path / "out" / "study.png") as picture:
        assert picture.size[0] > 300
    assert run(folder, tmp_path / "out", *options, "--seed", "1") == 2
    assert "is of another campaign" in capsys.readouterr().err
    parts = tmp_path / "parts"
    assert not run(folder, parts, "--left-halves")
    assert "left halves of 1 average(s) written" in capsys.readouterr().out
    assert sorted(path.name for path in parts.iterdir()) == [f"Wide_A_{i}.npy" for i in range(4)]


@pytest.mark.parametrize(
    "options, words",
    [
        (("--system", "magic"), "unknown system 'magic'"),
        (("--pictures", "1"), "--pictures 1"),
        (("--prior", "nowhere"), "nowhere"),
        (("--field", "Wide_B"), "no file raw/Wide_B_*.png"),
        (("--size", "65"), "smaller than --size 65"),
        (("--frames", "3"), "frames 3"),
    ],
)
def test_the_command_refuses_in_a_sentence(folder, tmp_path, capsys, options, words):
    out = tmp_path / "out"
    assert_refused(run(folder, out, *options), out, capsys, words)


def test_a_folder_or_a_picture_that_is_none_is_refused(folder, tmp_path, capsys):
    assert run(tmp_path, tmp_path / "out") == 2
    assert "no file raw/FIELD_*.png" in capsys.readouterr().err
    Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(folder / "raw" / "Wide_A_2.png")
    assert run(folder, tmp_path / "out") == 2
    assert "a capture is 8-bit grey" in capsys.readouterr().err
    Image.fromarray(np.zeros((64, 60), np.uint8)).save(folder / "raw" / "Wide_A_2.png")
    assert run(folder, tmp_path / "out") == 2
    assert "the average of its field" in capsys.readouterr().err
