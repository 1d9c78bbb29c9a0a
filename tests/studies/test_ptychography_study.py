"""The study of ptychography: its objects, microscopes, figures, and what its systems find."""

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from posterior.diagnostics import align, misfit
from posterior.models.priors.storage import card_of
from posterior.studies import (
    Answer,
    Condition,
    Ptychography,
    judged_objects,
    ptychography_table,
    specimens,
)
from posterior.studies.ptychography import led_optics
from posterior.studies.ptychography_plots import psnr_panels
from posterior.studies.specimens import reference
from studies_command import assert_refused, exit_code

SIDE = 32
CARD = {"name": "mine", "data": {"validation": ["red-r1c2.npy", "w2s-001.npy", "green-r0c0.npy"]}}


def smooth(rng, shape, band=4):
    """Complex noise without frequencies from `band` on, of sd 1 in Re and Im."""
    spectrum = np.fft.fft2(rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    radius = np.hypot(*np.meshgrid(*(n * np.fft.fftfreq(n) for n in shape[::-1])))
    rough = np.fft.ifft2(np.where(radius < band, spectrum, 0))
    return rough / np.sqrt(np.mean(np.abs(rough) ** 2) / 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """References of both colours whose values tell where they are from."""
    path = tmp_path_factory.mktemp("fpm")
    rng = np.random.default_rng(0)
    for colour in ("red", "green"):
        obj = 3 * np.exp(0.7j) * (1 + 0.1 * smooth(rng, (512, 512), 40))
        np.savez(path / f"bloodsmear_{colour}_epie_reference.npz", obj=obj.astype(np.complex64))
    return path


@pytest.fixture(scope="module")
def study():
    """Eight smooth objects of amplitude about 0.7."""
    rng = np.random.default_rng(1)
    truths = np.stack([0.7 + 0.07 * smooth(rng, (SIDE, SIDE)) for _ in range(8)])
    return Ptychography(truths.astype(np.complex64), "complex-cells", 8, draws=4, seed=0)


# ---- objects -------------------------------------------------------------------------------------


def places(objects, folder, columns):
    """(colour, row, column) of each object among the columns of the references."""
    found = []
    for o in objects:
        for colour in ("red", "green"):
            whole = reference(folder, colour)[:, columns]
            found += [(colour, *place) for place in np.argwhere(whole == o[0, 0])]
    return found


def test_objects_are_from_columns_that_training_leaves_out(folder):
    found = specimens(folder, CARD, "test", 16, 64)
    assert found.shape == (16, 64, 64) and found.dtype == np.complex64
    where = places(found, folder, slice(384, 512))
    # Every place once, in either colour.
    assert {(r, c) for _, r, c in where} == {(64 * i, 64 * j) for i in range(8) for j in range(2)}
    assert {colour for colour, _, _ in where} == {"red", "green"}
    np.testing.assert_array_equal(specimens(folder, CARD, "test", 3, 64), found[:3])
    # Then again in the other.
    assert len(set(places(specimens(folder, CARD, "test", 32, 64), folder, slice(384, 512)))) == 32
    with pytest.raises(ValueError, match="the test part has 32, take fewer"):
        specimens(folder, CARD, "test", 33, 64)


def test_validation_is_of_the_blocks_that_the_card_lists(folder):
    where = places(specimens(folder, CARD, "validation", 8, 64), folder, slice(0, 384))
    red = {("red", 128 + i, 256 + j) for i in (0, 64) for j in (0, 64)}
    assert set(where) == red | {("green", i, j) for i in (0, 64) for j in (0, 64)}
    with pytest.raises(ValueError, match="lists no validation blocks"):
        specimens(folder, card_of("nuclei"), "validation", 2, 64)


def test_objects_are_in_units_of_the_prior(folder):
    seen = reference(folder, "red")[:, :384]
    np.testing.assert_allclose(np.percentile(np.abs(seen), 99.5), 1, rtol=1e-5)
    assert abs(np.angle(seen.mean())) < 1e-5


# ---- microscopes ---------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [32, 64, 96, 128])
def test_leds_are_those_nearest_to_the_axis(side):
    for leds in (9, 25, 49, 89):
        optics = led_optics(side, leds)
        assert optics.out_shape == (leds, side // 4, side // 4)
        reach = np.linalg.norm(np.asarray(optics.centres), axis=1).max()
        assert (reach < 15.9 * side / 128) == (leds == 9)


def test_what_is_no_microscope_is_refused():
    with pytest.raises(ValueError, match="10 LEDs: use one of 9, 25, 49, 89"):
        led_optics(64, 10)
    with pytest.raises(ValueError, match="48 x 48: give --size"):
        led_optics(48, 9)
    assert Condition.of(Condition(9, "0.1").name) == Condition(9, "0.1")
    assert Condition(9, "0.05").camera_electrons == 400


def test_a_recording_is_one_for_all_systems_and_has_the_noise_it_says(study):
    name = Condition(9, "0.1").name
    recording, again = study.recording(name, 0), study.recording(name, 0)
    np.testing.assert_array_equal(recording.y, again.y)
    truth = jnp.asarray(study.truths[0])
    assert 0.6 < float(recording.likelihood.expected(truth).max()) < 0.8
    recordings = [study.recording(name, i) for i in range(4)]
    found = [misfit(r.likelihood, r.y, study.truths[i][None]) for i, r in enumerate(recordings)]
    # 9 x 64 values each, whose squares have an error of sqrt(2 / n); counts have a little more.
    assert abs(np.mean(found) - 1) < 4 * np.sqrt(2.2 / (4 * 9 * 64))
    other = study.recording(Condition(9, "0.05").name, 0)
    assert not np.array_equal(other.y, recording.y)


# ---- figures -------------------------------------------------------------------------------------


def drawn_about(truths, width, count=40, sd=0.03):
    """Draws exchangeable with the truths where `width` is 1; each turned by a phase of its own."""
    rng = np.random.default_rng(2)

    def noise(*shape):
        return sd * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))

    centre = truths + noise(*truths.shape)
    draws = centre[:, None] + width * noise(len(truths), count, *truths.shape[1:])
    turns = np.exp(2j * np.pi * rng.random((len(truths), count, 1, 1)))
    return Answer(draws * turns, np.array([9.0, *[2.0] * (len(truths) - 1)]), 3_000_000)


def test_figures_of_draws_that_are_right_and_of_too_narrow_ones(study):
    name, count = Condition(9, "0.1").name, study.truths.size
    found = judged_objects(study, name, drawn_about(study.truths, 1.0))
    assert abs(found.spread - 1) < 4 / np.sqrt(2 * count)
    for half, _, most, _ in (found.amplitudes, found.phases):
        assert abs(half - 0.5) < 4 * 0.5 / np.sqrt(count)
        assert abs(most - 0.9) < 4 * 0.3 / np.sqrt(count)
    # The error of the mean is 0.03 in amplitude, and 0.03 over the amplitude in phase.
    mean_square = 0.03**2 * (1 + 1 / 40)
    assert abs(found.amplitude.mean() + 10 * np.log10(mean_square)) < 0.2
    inverse = np.mean(1 / np.abs(study.truths) ** 2)
    expected = 10 * np.log10((2 * np.pi) ** 2 / (mean_square * inverse))
    assert abs(found.phase.mean() - expected) < 0.2
    assert abs(found.draw_amplitude.mean() - found.amplitude.mean() + 10 * np.log10(2)) < 0.3
    assert found.seconds == 2 / 40 and found.memory == 3
    narrow = judged_objects(study, name, drawn_about(study.truths, 0.5))
    assert abs(narrow.spread - 0.5) < 0.05
    assert narrow.amplitudes[0] < 0.35 and narrow.phases[2] < 0.7


def test_the_table_has_a_row_for_each_answer_and_the_figure_a_line(study):
    name = Condition(89, "0.1").name
    one = Answer(drawn_about(study.truths[:3], 1.0).images[:, :1], np.ones(3), 10**6)
    refused = Answer(np.empty(0), np.empty(0), 0, "recording 0: no weights")
    answers = {"estimate": one, "lacking": refused, "draws": drawn_about(study.truths[:3], 1.0)}
    judged = {s: judged_objects(study, name, a) for s, a in answers.items() if not a.refusal}
    table = ptychography_table(name, judged, answers)
    assert "## 89 LEDs, sigma_0 0.1" in table and "- lacking: no answer to recording 0" in table
    rows = [line for line in table.splitlines() if line.startswith("| ")]
    assert len(rows) == 3 and len({row.count("|") for row in rows}) == 1
    figure = psnr_panels({name: {"draws": judged["draws"]}}, [name], [name])
    assert [axis.get_xlabel() for axis in figure.axes] == ["sigma_0", "sigma_0", "LEDs", "LEDs"]
    line = figure.axes[1].containers[0].lines[0]
    shown = np.asarray(line.get_ydata(), float)
    np.testing.assert_allclose(shown, [judged["draws"].phase.mean()])


# ---- systems -------------------------------------------------------------------------------------


def test_the_bright_field_has_the_mean_amplitude_and_no_phase(study):
    found = study("bright field", Condition(9, "0.005").name, 0)
    assert found.shape == (1, SIDE, SIDE)
    assert abs(np.abs(found).mean() / np.abs(study.truths[0]).mean() - 1) < 0.02
    # But for the outermost frequency of a camera image, which has no partner.
    assert np.abs(np.angle(found)).max() < 0.01


@pytest.mark.slow
def test_without_a_prior_the_mean_of_draws_is_the_likeliest_object(study):
    """At low noise the flat posterior is normal about its maximum, where frequencies are seen.

    The mean of L draws is off by 1/L of their variance then; a quarter of their sd, squared, is
    left to quasi-Newton's end and to the levels that are finite.
    """
    study = study._replace(draws=16, truths=study.truths[:1], bits=None)
    name = Condition(89, "0.005").name
    climbed, drawn = (study(system, name, 0) for system in ("quasi-Newton", "no prior"))
    radius = np.hypot(*np.meshgrid(*[SIDE * np.fft.fftfreq(SIDE)] * 2))
    drawn = np.fft.fft2(align(drawn, climbed[0], ["global_phase"]))[:, radius < 10]
    off = np.mean(np.abs(drawn.mean(axis=0) - np.fft.fft2(climbed[0])[radius < 10]) ** 2)
    bias = off / drawn.var(axis=0, ddof=1).mean() - 1 / len(drawn)
    assert -1 / 32 < bias < 1 / 16, bias


def run(folder, out, *options):
    few = ("--objects", 2, "--size", SIDE, "--draws", 2)
    return exit_code("ptychography", out, "--data", folder, *few, *options)


def test_the_command_writes_tables_and_figures(folder, tmp_path, capsys):
    options = ("--system", "bright field", "--sigma", "0.1", "--leds", "89")
    assert not run(folder, tmp_path / "out", *options)
    table = (tmp_path / "out" / "study.md").read_text()
    assert capsys.readouterr().out == table
    assert table.count("## 89 LEDs, sigma_0 0.1") == 1 and "| bright field |" in table
    for name in ("psnr", "scatter", "maps"):
        with Image.open(tmp_path / "out" / f"{name}.png") as picture:
            assert picture.size[0] > 300
    assert run(folder, tmp_path / "out", *options, "--seed", "1") == 2
    assert "is of another campaign" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options, words",
    [
        (("--system", "magic"), "unknown system 'magic'"),
        (("--sigma", "2"), "sigma_0 2"),
        (("--leds", "10"), "10 LEDs"),
        (("--objects", "1"), "--objects 1"),
        (("--objects", "129"), "take fewer"),
        (("--part", "train"), "--part train"),
        (("--size", "40"), "40 x 40"),
        (("--prior", "nowhere"), "nowhere"),
        (("--bits", "17"), "17"),
        (("--stack", "stack.npz"), "either --data"),
    ],
)
def test_the_command_refuses_in_a_sentence(folder, tmp_path, capsys, options, words):
    out = tmp_path / "out"
    assert_refused(run(folder, out, *options), out, capsys, words)
