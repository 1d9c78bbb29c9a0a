"""The phase-retrieval study: recordings, figures that are known, the table, and the command."""

import numpy as np
import pytest
from PIL import Image

from posterior.diagnostics.fidelity import psnr
from posterior.models.priors.storage import card_of
from posterior.studies import (
    PHASE_SYSTEMS,
    Answer,
    PhaseRetrieval,
    aligned,
    judged_phases,
    phase_table,
    pictures_of,
    variance_picture,
)
from posterior.studies.phase_retrieval import Condition
from studies_command import assert_refused, exit_code

SIDE = 16


@pytest.fixture(scope="module")
def truths():
    rows, columns = np.mgrid[:SIDE, :SIDE] / SIDE
    blob = np.exp(-((rows - 0.5) ** 2 + (columns - 0.3) ** 2) / 0.05)
    # Without blocks of their own they would look alike after a shift.
    blocks = np.kron(np.random.default_rng(0).random((2, 4, 4)), np.ones((4, 4)))
    return (0.4 * blocks + np.stack([0.1 + 0.5 * blob, 0.6 * blob.T * rows])).astype(np.float32)


def study(truths, draws=3):
    return PhaseRetrieval(truths, "natural", draws, seed=0, scout="natural")


def intensities(truth):
    return np.abs(np.fft.fft2(truth, s=(2 * SIDE, 2 * SIDE), norm="ortho")) ** 2


# ---- recordings ----------------------------------------------------------------------------------


@pytest.mark.parametrize("definition", ["prdeep", "poisson"])
@pytest.mark.parametrize("alpha", [0.5, 4])
def test_noise_is_that_of_the_definition(truths, definition, alpha):
    """Of prDeep's numbers, z = half the transform of 0..255: mean |z|^2 and sd alpha |z|."""
    work, found = study(truths), []
    for index in range(0, 20, 2):  # the first picture
        recording = work.recording(f"{alpha}-{definition}", index)
        counts = recording.y * recording.full_well
        np.testing.assert_allclose(counts, np.rint(counts), atol=0.25)
        square = recording.y / recording.irradiance * (255 / 2) ** 2
        z = 255 / 2 * np.sqrt(intensities(truths[0]))
        found.append((square - z**2) / (alpha * z))
    # Where there are ten electrons or more, prDeep's clipping at zero is rare.
    bright = intensities(truths[0]) > 10 * (2 * alpha / 255) ** 2
    off = np.array(found)[:, bright]
    assert abs(off.mean()) < 4 / np.sqrt(off.size)
    # Rounding adds a twelfth of an electron; a kurtosis of 3.1 at most.
    assert abs(off.var() - 1) < 4 * np.sqrt(2.1 / off.size) + 1 / 120


def test_an_adc_spans_the_brightest_pixel(truths):
    work = study(truths)
    whole, coded = (work.recording(f"2-poisson{bits}", 0) for bits in ("", "-8"))
    assert coded.full_well == whole.full_well and coded.y.max() == 1
    np.testing.assert_allclose(coded.y * 255, np.rint(coded.y * 255), atol=1e-4)
    assert np.abs(coded.y - whole.y).max() <= 0.5001 / 255
    assert np.mean(coded.y > 0) < np.mean(whole.y > 0)


def test_every_system_sees_the_same_recording(truths):
    work = study(truths)
    recording = work.recording("2-prdeep", 1)
    np.testing.assert_array_equal(work.recording("2-prdeep", 1).y, recording.y)
    # The third answer is of the first picture again, with noise of its own.
    again = work.recording("2-prdeep", 2)
    assert np.abs(again.y - work.recording("2-prdeep", 0).y).max() > 0
    np.testing.assert_array_equal(work.truth(2), truths[0])
    np.testing.assert_array_equal(recording.by_hio(), work("HIO", "2-prdeep", 1)[0])


@pytest.mark.parametrize("condition", ["0.5-prdeep", "0.5-poisson", "0.2-poisson-16"])
def test_the_misfit_of_the_truth_is_one_and_of_others_more(truths, condition):
    work, found = study(truths), []
    for index in range(0, 40, 2):
        found.append(work.recording(condition, index).misfit(truths[:1]))
    recording = work.recording(condition, 0)
    electrons = intensities(truths[0]) / Condition.of(condition).electron
    step = recording.full_well / (2**recording.bits - 1) if recording.bits else 0
    seen = 20 * np.sum(electrons >= max(10, step**2 / 12))
    # The root of a count of 10 has 5 % more than a quarter of variance, of more counts less.
    assert -4 * np.sqrt(2 / seen) - 0.01 < np.mean(found) - 1 < 4 * np.sqrt(2 / seen) + 0.06
    assert recording.misfit(truths[:1] + 0.1) > 2
    turned = truths[:1, ::-1, ::-1]
    np.testing.assert_allclose(recording.misfit(turned), recording.misfit(truths[:1]), rtol=1e-4)


def test_where_nothing_is_left_there_is_no_misfit(truths):
    assert np.isnan(study(truths).recording("2-poisson-8", 0).misfit(0 * truths))


@pytest.mark.parametrize(
    "text, words",
    [
        ("2", "definition ''"),
        ("2-magic", "definition 'magic'"),
        ("2-prdeep-8", "definition 'prdeep-8'"),
        ("2-poisson-x", "definition 'poisson-x'"),
        ("0-prdeep", "alpha 0"),
        ("2-poisson-40", "40"),
    ],
)
def test_conditions_that_say_nothing_are_refused(text, words):
    with pytest.raises(ValueError, match=words):
        Condition.of(text)


# ---- systems -------------------------------------------------------------------------------------


def systems():
    quick = ("HIO", "network-ADMM", "prDeep")
    return [
        pytest.param(name, marks=[] if name in quick else [pytest.mark.slow])
        for name in PHASE_SYSTEMS
    ]


@pytest.mark.parametrize("name", systems())
def test_every_system_explains_its_recording(truths, name):
    """Far better than a flat picture of the right brightness, and nearly to the noise."""
    if "BM3D" in name:
        pytest.importorskip("bm3d")
    work = study(truths)
    images = work(name, "2-prdeep", 0)
    assert images.shape == (3 if PHASE_SYSTEMS[name].samples else 1, SIDE, SIDE)
    assert images.dtype == np.float32 and np.all(np.isfinite(images))
    recording = work.recording("2-prdeep", 0)
    flat = np.full((1, SIDE, SIDE), truths[0].mean(), np.float32)
    assert recording.misfit(images) < 0.2 * recording.misfit(flat)


# ---- figures -------------------------------------------------------------------------------------


def answer_of(truths, seeds=1, spread=1.0, draws=30, sd=0.05):
    """Draws of normal posteriors, `spread` times too wide; each turned as the data allow."""
    rng = np.random.default_rng(0)
    x = np.concatenate([truths] * seeds)
    means = x + sd * rng.standard_normal(x.shape)
    images = means[:, None] + sd * spread * rng.standard_normal((len(x), draws, *x.shape[1:]))
    images[::2] = np.roll(images[::2, :, ::-1, ::-1], (3, 5), (-2, -1))
    return Answer(images, np.array([50.0, *[2.0] * (len(x) - 1)]), 3 * 10**8)


@pytest.mark.parametrize("spread", [1.0, 0.6])
def test_figures_of_normal_posteriors(truths, spread):
    work, sd, seeds = study(truths), 0.05, 6
    answer = answer_of(truths, seeds, spread)
    found = judged_phases(work, "2-prdeep", answer)
    pixels = seeds * truths.size
    error = 10 / np.log(10) * np.sqrt(2 / pixels)
    exact = {"psnr": sd**2 * (1 + spread**2 / 30), "draw psnr": sd**2 * (1 + spread**2)}
    for name, square in exact.items():
        # Seeds are averaged in decibels: the mean logarithm of 256 squares is 1 / 256 low.
        assert abs(found[name] + 10 * np.log10(square)) < 4 * error + 0.03, name
    assert abs(found["spread"] / spread - 1) < 4 * np.sqrt(0.5 / pixels) + 0.01
    half, half_error, most, most_error = found["pixels"]
    right = abs(half - 0.5) < 4 * half_error and abs(most - 0.9) < 4 * most_error
    assert right == (spread == 1.0)
    # A mean over pictures of means over seeds.
    images = aligned(work, answer).mean(axis=1)
    of_answers = [psnr(image, work.truth(i)) for i, image in enumerate(images)]
    each = np.reshape(of_answers, (seeds, 2))
    pictures = each.mean(axis=0)
    np.testing.assert_allclose(
        [found["psnr"], found["sd"]], [pictures.mean(), pictures.std(ddof=1)]
    )
    np.testing.assert_allclose(found["by seed"], each.mean(axis=1))
    np.testing.assert_allclose(found["moves"], (each.max(axis=0) - each.min(axis=0)).max())
    # All pictures have as many pixels: the spread over error of all is the harmonic mean of each.
    squares = np.square(found["each"]) ** -1.0
    assert len(squares) == 2 * seeds
    np.testing.assert_allclose(found["spread"], squares.mean() ** -0.5, rtol=0.01)
    assert found["seconds"] == 2 and found["memory"] == 300


def test_the_table_has_published_figures_and_says_who_did_not_answer(truths):
    answers = {
        "HIO": answer_of(truths, draws=1),
        "annealed": answer_of(truths),
        "BM3D-ADMM": Answer(np.empty(0), np.empty(0), 0, "recording 0: BM3D is not installed"),
    }
    work = study(truths)

    def table_of(condition):
        judged = {n: judged_phases(work, condition, answers[n]) for n in ("HIO", "annealed")}
        return phase_table(work, condition, judged, answers)

    table = table_of("3-prdeep")
    assert "| 19.9 |" in table and "| 32.6 |" in table
    assert "- BM3D-ADMM: no answer to recording 0: BM3D is not installed" in table
    assert "prDeep's normal noise" in table
    assert "- HIO:" not in table and "- annealed: spread over error of each answer" in table
    other = table_of("2.5-poisson-8")
    assert "| 19.9 |" not in other and "8 bits over the brightest" in other


def test_the_variance_is_shown_of_systems_that_sample(truths):
    answers = {"HIO": answer_of(truths, draws=1), "annealed": answer_of(truths)}
    figure = variance_picture({"2-prdeep": answers}, truths[0])
    assert len(figure.axes) == 6
    assert variance_picture({"2-prdeep": {"HIO": answers["HIO"]}}, truths[0]) is None


# ---- the command ---------------------------------------------------------------------------------


@pytest.fixture
def six(tmp_path, truths):
    path = tmp_path / "pictures.npz"
    np.savez(path, images_float=255 * truths, names=["a", "b"])
    return path


def test_pictures_are_those_of_the_file_or_the_validation_pictures_of_the_card(six, truths):
    np.testing.assert_allclose(pictures_of(six, "natural", None), truths, rtol=1e-6)
    assert len(pictures_of(six, "natural", 1)) == 1
    with pytest.raises(ValueError, match="holds 2 pictures, not 3"):
        pictures_of(six, "natural", 3)
    folder = six.parent / "folder"
    folder.mkdir()
    for name in card_of("natural")["data"]["validation"][:2]:
        noise = np.random.default_rng(0).integers(0, 255, (24, 32)).astype(np.uint8)
        Image.fromarray(noise).save(folder / name)
    assert pictures_of(folder, "natural", 2, SIDE).shape == (2, SIDE, SIDE)
    other = six.parent / "other.npz"
    np.savez(other, a=truths)
    with pytest.raises(ValueError, match="holds no images_float"):
        pictures_of(other, "natural", None)


def run(data, out, *options):
    return exit_code("phase-retrieval", out, "--data", data, *options)


def test_the_command_writes_tables_and_pictures(six, tmp_path, capsys):
    options = ("--system", "HIO", "--alpha", "2", "--definition", "prdeep")
    assert not run(six, tmp_path / "out", *options)
    table = (tmp_path / "out" / "study.md").read_text()
    assert capsys.readouterr().out == table
    assert "| HIO |" in table and "## alpha = 2, prdeep" in table and "- HIO: Fienup" in table
    with Image.open(tmp_path / "out" / "study.png") as picture:
        assert picture.size[0] > 300
    assert not (tmp_path / "out" / "variance.png").exists()
    for other in (("--seed", "1"), ("--scout", "natural-large")):
        assert run(six, tmp_path / "out", *options, *other) == 2
        assert "is of another campaign" in capsys.readouterr().err


@pytest.mark.slow
def test_a_study_with_draws_has_a_picture_of_their_variance(six, tmp_path):
    options = ("--system", "annealed from HIO", "--alpha", "2", "--definition", "prdeep")
    assert not run(six, tmp_path / "out", *options, "--draws", "2", "--seeds", "2")
    assert (tmp_path / "out" / "variance.png").exists()
    shards = list((tmp_path / "out" / "answers" / "2-prdeep-annealed from HIO").iterdir())
    assert len(shards) == 4


@pytest.mark.parametrize(
    "options, words",
    [
        (("--system", "magic"), "unknown system 'magic'"),
        (("--alpha", "bright"), "alpha bright"),
        (("--alpha", "-1"), "alpha -1"),
        (("--definition", "exact"), "definition 'exact'"),
        (("--draws", "1"), "--draws 1"),
        (("--pictures", "1"), "one answer has no spread"),
        (("--pictures", "3"), "not 3"),
        (("--prior", "nowhere"), "nowhere"),
        (("--scout", "elsewhere"), "elsewhere"),
        (("--alpha", "0.001"), "full_well"),
    ],
)
def test_the_command_refuses_in_a_sentence(six, tmp_path, capsys, options, words):
    out = tmp_path / "out"
    assert_refused(run(six, out, *options), out, capsys, words)
