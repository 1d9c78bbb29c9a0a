"""The command line from end to end: every result, every refusal, and the same draws again."""

import dataclasses
import functools
import json
import os
import re
from pathlib import Path

import jax
import numpy as np
import pytest
import tifffile
from PIL import Image

import posterior as ps
from posterior import cli, models, presets, starts
from posterior.cli.options import Options, study_data
from posterior.cli.run import _scout
from posterior.cli.words import doubts
from posterior.diagnostics.plots import overview
from posterior.images import read_picture
from posterior.models.priors.storage import FOLDER, card_of

RNG = np.random.default_rng(1)
SMALL = ["--draws", "6", "--warmup", "12", "--thin", "1", "--quiet"]
LEARNED = [
    ("denoising", "cells"),
    ("phase-retrieval", "natural"),
    ("ptychography", "complex-cells"),
]
NUCLEI = str(FOLDER / "nuclei-gaussian-score.safetensors")
SIGNAL = str(FOLDER / "nuclei-signal-score.safetensors")
FILES = {"draws.nc", "figure.png", "settings.json"}
REAL = FILES | {"mean.tif", "sd.tif"}
COMPLEX = FILES | {f"{a}_{b}.tif" for a in ("mean", "sd") for b in ("amplitude", "phase")}


@pytest.fixture(autouse=True, scope="module")
def _quick_to_compile():
    """The runs here are tiny: nearly all their time would go to XLA's optimizations."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture
def few_levels(monkeypatch):
    """Anneal in a hurry: these runs are about files, not about draws."""
    monkeypatch.setattr(presets.samplers, "_ANNEALED", {"levels": 5, "steps": 1})


def _smooth(size):
    """A random picture in 0.1..0.7 with the look of a blurred one."""
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(size)] * 2)) + 1 / size
    field = np.fft.ifft2(np.fft.fft2(RNG.standard_normal((size, size))) / frequency).real
    return 0.1 + 0.6 * (field - field.min()) / np.ptp(field)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Pictures, recordings and priors of 16x16."""
    path = tmp_path_factory.mktemp("input")
    Image.fromarray((255 * _smooth(16)).astype(np.uint8)).save(path / "picture.png")
    tifffile.imwrite(path / "deep.tif", (65535 * _smooth(16)).astype(np.uint16))
    pages = np.stack([(255 * _smooth(16)).astype(np.uint8) for _ in range(2)])
    tifffile.imwrite(path / "pages.tif", pages, photometric="minisblack")
    colours = np.stack([_smooth(16) for _ in range(3)], axis=-1)
    Image.fromarray((255 * colours).astype(np.uint8)).save(path / "colour.png")
    np.save(path / "specimen.npy", presets.complex_object(_smooth(16)))
    np.save(path / "counts.npy", RNG.poisson(60 * _smooth(16)) / 100)
    np.save(path / "codes.npy", RNG.poisson(60 * _smooth(16)).astype(np.uint8))
    (path / "prior").mkdir()
    for i in range(3):
        Image.fromarray((255 * _smooth(24)).astype(np.uint8)).save(path / "prior" / f"{i}.png")
    return path


def _main(*arguments):
    with pytest.raises(SystemExit) as caught:
        cli.main([str(a) for a in arguments])
    return caught.value.code or 0


def _run(folder, out, *arguments, problem="denoising", image="picture.png"):
    arguments = ("--image", folder / image, *arguments) if image else arguments
    status = _main(
        "sample", problem, "--out", out, "--prior", folder / "prior", "--bits", 0, *SMALL,
        *arguments,
    )  # fmt: skip
    assert status == 0
    return json.loads((out / "settings.json").read_text())


@pytest.fixture(scope="module")
def denoised(folder, tmp_path_factory):
    """A finished run, for all tests that only look at it."""
    out = tmp_path_factory.mktemp("run") / "new" / "denoised"
    _run(folder, out, "--seed", 3)
    return out


def _files(out):
    return {p.name for p in out.iterdir()}


# ---- runs ----------------------------------------------------------------------------------------


def test_a_run_writes_all_and_cleans_up(denoised, folder):
    assert _files(denoised) == REAL
    draws = ps.load(denoised / "draws.nc")
    assert draws.values.shape == (4, 6, 16, 16)
    mean = read_picture(denoised / "mean.tif")
    np.testing.assert_allclose(mean, draws.mean, atol=1e-5)
    settings = json.loads((denoised / "settings.json").read_text())
    assert settings["options"]["image"] == str(folder / "picture.png")
    assert settings["options"]["full_well"] == 100
    assert settings["input"]["file"] == "picture.png"
    assert sorted(settings["prior"]) == ["0.png", "1.png", "2.png"]
    assert {"psnr_data", "psnr_mean", "coverage", "rhat", "ess"} <= set(settings["results"])
    assert settings["versions"]["jax"] == jax.__version__
    # Six draws after twelve steps: the run has to say that it has not mixed.
    assert any("have not mixed" in w for w in settings["warnings"])


def test_the_same_seed_gives_the_same_draws_and_another_does_not(denoised, folder, tmp_path):
    for seed, same in ((3, True), (4, False)):
        out = tmp_path / str(seed)
        _run(folder, out, "--seed", seed)
        found = ps.load(out / "draws.nc"), ps.load(denoised / "draws.nc")
        assert np.array_equal(found[0].values, found[1].values) == same
        assert np.array_equal(found[0].data, found[1].data) == same


def test_repeat_makes_the_same_draws(denoised, tmp_path, capsys):
    out = tmp_path / "again"
    assert _main("repeat", denoised / "settings.json", "--out", out, "--quiet") == 0
    again, first = ps.load(out / "draws.nc"), ps.load(denoised / "draws.nc")
    np.testing.assert_array_equal(again.values, first.values)
    said = capsys.readouterr().out
    assert "truth inside the 90 % interval" in said
    assert "warning: the chains have not mixed" in said


def test_a_killed_run_goes_on(denoised, folder, tmp_path, monkeypatch, capsys):
    out = tmp_path / "killed"
    with monkeypatch.context() as patch:
        patch.setattr("posterior.checkpoint.Checkpoint.save", _interrupt_after(2))
        arguments = ("--image", folder / "picture.png", "--prior", folder / "prior")
        status = _main(
            "sample", "denoising", "--out", out, "--bits", 0, "--seed", 3, *SMALL, *arguments
        )
    assert status == 130
    assert f"what is done is in {out / 'checkpoint'}" in capsys.readouterr().err
    assert _files(out) == {"checkpoint"}
    _run(folder, out, "--seed", 3)
    assert _files(out) == REAL
    found = ps.load(out / "draws.nc"), ps.load(denoised / "draws.nc")
    np.testing.assert_array_equal(found[0].values, found[1].values)


def _interrupt_after(count):
    from posterior.checkpoint import Checkpoint

    whole, calls = Checkpoint.save, []

    def save(self, *arguments):
        whole(self, *arguments)
        calls.append(1)
        if len(calls) == count:
            raise KeyboardInterrupt

    return save


def test_a_finished_run_is_kept_unless_told(denoised, folder, tmp_path, capsys):
    before = (denoised / "draws.nc").read_bytes()
    assert _refused(capsys, "--image", folder / "picture.png", "--out", denoised).endswith(
        "give another --out, or --overwrite to replace it"
    )
    assert (denoised / "draws.nc").read_bytes() == before
    out = tmp_path / "kept"
    out.mkdir()
    (out / "mean_phase.tif").write_text("of an earlier run")
    _run(folder, out, "--overwrite", "--seed", 3)
    assert _files(out) == REAL


@pytest.mark.parametrize(("image", "page"), [("deep.tif", None), ("pages.tif", 1)])
def test_tiff_pictures(folder, tmp_path, image, page):
    extra = [] if page is None else ["--page", page]
    settings = _run(folder, tmp_path / "run", *extra, image=image)
    assert settings["options"]["page"] == page
    truth = read_picture(folder / image, page)
    data = ps.load(tmp_path / "run" / "draws.nc").data
    # A recording of 100 electrons follows its picture.
    assert np.corrcoef(truth.ravel(), data.ravel())[0, 1] > 0.8


@pytest.mark.slow
def test_a_picture_in_colour_by_planes(folder, tmp_path):
    out = tmp_path / "run"
    _run(folder, out, "--colour", "planes", image="colour.png")
    draws = ps.load(out / "draws.nc")
    assert draws.values.shape == (4, 6, 16, 16, 3)
    np.testing.assert_allclose(read_picture(out / "mean.tif"), draws.mean, atol=1e-5)


def test_a_figure_shows_colours(tmp_path):
    """Grey alone would leave the panels of the truth and the recording without any."""
    truth = np.stack([_smooth(16) for _ in range(3)], axis=-1)
    overview(tmp_path / "figure.png", truth, truth, [truth] * 2, truth, sd=truth, width=truth)
    shown = np.asarray(Image.open(tmp_path / "figure.png").convert("RGB")).astype(int)
    left = shown[:, : shown.shape[1] // 3]  # truth above, a draw below; no map of a spread
    assert np.mean(np.ptp(left, axis=-1) > 10) > 0.2


@pytest.mark.parametrize(
    "prior, colour, shape",
    [("faces", None, (16, 16, 3)), (None, "planes", (16, 16, 3)), (None, "luminance", (16, 16))],
)
def test_colours_are_kept_as_prior_and_user_say(prior, colour, shape):
    picture = np.stack([_smooth(16) for _ in range(3)], axis=-1)
    camera, given = models.Poisson(100), {"prior": prior, "colour": colour}
    question = presets.simulate("denoising", picture, camera, jax.random.key(0), **given)
    assert question.truth.shape == question.problem.prior.shape == shape
    if len(shape) == 3:
        np.testing.assert_array_equal(question.truth, picture)
        again = presets.record("denoising", question.y, camera, **given)
        assert again.problem.prior.shape == shape
    # Grey that was saved as colour is grey, and nothing is asked.
    if prior is None:
        grey = np.stack([picture[..., 0]] * 3, axis=-1)
        plain = presets.simulate("denoising", grey, camera, jax.random.key(0))
        assert plain.truth.shape == (16, 16)


def test_phase_retrieval_of_a_complex_object():
    """Under complex weights, of a complex picture or a grey one; or under a field of complex."""
    specimen = presets.complex_object(_smooth(16))
    camera, key = models.Poisson(10_000), jax.random.key(0)
    for picture, prior in (
        (specimen, "complex-cells"),
        (_smooth(16), "complex-cells"),
        (specimen, None),
    ):
        question = presets.simulate("phase-retrieval", picture, camera, key, prior=prior)
        assert np.iscomplexobj(question.truth) and question.problem.prior.complex_valued
    again = presets.record("phase-retrieval", question.y, camera, prior="complex-cells")
    assert again.problem.prior.complex_valued
    with pytest.raises(ValueError, match="give a prior of complex ones, as --prior complex-cells"):
        presets.simulate("phase-retrieval", specimen, camera, key, prior="natural")


def test_a_recording_has_no_truth(folder, tmp_path, capsys):
    out = tmp_path / "run"
    extra = ("--data", folder / "counts.npy", "--full-well", 100)
    settings = _run(folder, out, *extra, image=None)
    assert _files(out) == REAL
    assert set(settings["results"]) == {"rhat", "unmixed", "ess", "misfit"}
    assert "PSNR" not in capsys.readouterr().out
    counts = np.load(folder / "counts.npy")
    np.testing.assert_allclose(ps.load(out / "draws.nc").data, counts, atol=1e-6)


def test_a_scout_searches_where_phases_are_lost_and_is_remembered():
    """With its hash, so that a run is not repeated with another."""
    camera, picture = models.Poisson(1000), np.kron(np.eye(2), np.full((8, 8), 0.8)) + 0.1
    for problem, prior, searchers in (
        ("phase-retrieval", "natural-large", ["natural"]),
        ("phase-retrieval", "natural", []),
        ("denoising", "natural-large", []),
    ):
        given = {"size": 16, "prior": prior, "needs": "score"}
        question = presets.simulate(problem, picture, camera, jax.random.key(0), **given)
        names = [prior, *searchers]
        assert question.prior == {name: card_of(name)["sha256"] for name in names}
        scout = _scout(Options(problem, prior=prior), (16, 16))
        assert (scout is not None) == bool(searchers)


def test_phase_retrieval(folder, tmp_path, few_levels):
    settings = _run(folder, tmp_path / "run", problem="phase-retrieval")
    assert _files(tmp_path / "run") == REAL
    assert settings["options"]["sampler"] == "mala"
    assert ps.load(tmp_path / "run" / "draws.nc").data.shape == (32, 32)


@pytest.mark.slow
def test_ptychography_of_a_complex_specimen(folder, tmp_path, few_levels):
    extra = ("--sampler", "annealed", "--draws", 1, "--chains", 2)
    settings = _run(folder, tmp_path / "run", *extra, problem="ptychography", image="specimen.npy")
    assert _files(tmp_path / "run") == COMPLEX
    # Two draws hold a third of the truths between them: nothing is said of 90 %.
    assert set(settings["results"]) == {"psnr_mean", "misfit"}
    assert any("convergence is not checked" in w for w in settings["warnings"])
    assert any("annealed is approximate" in w for w in settings["warnings"])
    draws = ps.load(tmp_path / "run" / "draws.nc")
    assert draws.data.shape == (49, 8, 8)
    assert np.iscomplexobj(draws.values)


# ---- the three problems --------------------------------------------------------------------------


def test_white_below_the_full_well(folder, tmp_path, capsys):
    """500 electrons in the well, 100 of white: more than white is recorded, in units of white."""
    out = tmp_path / "run"
    arguments = ("--image", folder / "white.npy", "--full-well", 500, "--white", 100)
    np.save(folder / "white.npy", np.ones((16, 16)) - 1e-3 * np.eye(16))
    _run(folder, out, *arguments, image=None)
    recorded = ps.load(out / "draws.nc").data
    assert recorded.max() > 1.1
    assert abs(recorded.mean() - 1) < 4 * 0.1 / 16
    assert "reaches" not in capsys.readouterr().err
    np.save(folder / "shares.npy", recorded / 5)
    again = ("--data", folder / "shares.npy", "--full-well", 500, "--white", 100)
    _run(folder, tmp_path / "again", *again, image=None)
    np.testing.assert_allclose(ps.load(tmp_path / "again" / "draws.nc").data, recorded, rtol=1e-6)


@pytest.mark.parametrize("name", ["phase-retrieval", "ptychography"])
def test_the_brightest_pixel_just_meets_the_full_well(name):
    camera = models.Poisson(10_000)
    picture = (255 * _smooth(32)).astype(np.uint8)
    question = presets.simulate(name, picture, camera, jax.random.key(0), size=16)
    truth = np.asarray(question.truth, question.problem.prior.dtype)
    brightest = float(question.problem.likelihood.expected(jax.numpy.asarray(truth)).max())
    assert brightest + 4 * np.sqrt(brightest / 10_000) == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize("name", ["phase-retrieval", "ptychography"])
def test_irradiance_is_found_from_the_recording(name):
    """Over recordings of the prior itself, the estimate is right on average."""
    camera = models.Poisson(1_000_000)
    picture = (255 * _smooth(32)).astype(np.uint8)
    known = presets.simulate(name, picture, camera, jax.random.key(0), size=16)
    likelihood, prior = known.problem.likelihood, known.problem.prior
    keys = jax.random.split(jax.random.key(1), 16)
    recordings = jax.jit(jax.vmap(lambda k: likelihood.expected(prior.sample(k))))(keys)
    ratios = [
        presets.exposure.irradiance_of(y, likelihood.optics, prior) for y in np.asarray(recordings)
    ]
    ratios = np.array(ratios) / known.irradiance
    error = np.std(ratios) / np.sqrt(len(ratios))
    # For ptychography the expectation is itself a mean over 64 draws of the prior.
    assert np.mean(ratios) == pytest.approx(1, abs=4 * error * np.sqrt(1 + 16 / 64))


@pytest.mark.parametrize("name", ["denoising", "ptychography"])
def test_the_prior_never_sees_the_truth(name):
    from skimage import data

    dimmed = 0.1 + 0.5 * data.camera() / 255
    question = presets.simulate(name, dimmed, models.Poisson(100), jax.random.key(0), size=16)
    assert sorted({*presets.PRIOR_PICTURES} - {*question.prior}) == ["camera"]


@pytest.mark.parametrize(
    "size, leds",
    [*((size, 49) for size in (16, 32, 48, 64, 128, 256)), (16, 9), (64, 9), (32, 225), (128, 225)],
)
def test_the_aperture_grid_fits_and_overlaps(size, leds):
    centres, radius = presets.aperture_grid(size, leds)
    assert centres.shape == (leds, 2)
    upsampling = 4 if size >= 64 else 2
    models.FourierPtychography.from_radius((size, size), centres, radius, upsampling)
    half = (centres[1] - centres[0])[1] / radius / 2
    overlap = 2 / np.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))
    assert overlap == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize(
    "needs, sampler, kind",
    [
        ("score", "ula", models.ScorePrior),
        ("density", "nuts", models.EnergyPrior),
        ("counts", "thickening", models.ScorePrior),
    ],
)
def test_named_weights_are_those_that_the_sampler_needs(needs, sampler, kind):
    picture = (255 * _smooth(24)).astype(np.uint8)
    camera, key = models.Poisson(100), jax.random.key(0)
    settings = {"size": 16, "prior": "nuclei", "needs": needs}
    question = presets.simulate("denoising", picture, camera, key, **settings)
    assert isinstance(question.problem.prior, kind)
    assert presets.SAMPLERS[sampler].needs == needs
    presets.SAMPLERS[sampler].build(question.problem.condition(question.y))


@pytest.mark.parametrize(
    "problem, sampler, kind, chosen",
    [
        ("denoising", None, "poisson-score", "thickening"),
        ("denoising", "annealed", "gaussian-score", "annealed"),
        ("phase-retrieval", None, "gaussian-score", "annealed"),
        ("denoising", "mala", "gaussian-energy", "mala"),
    ],
)
def test_weights_may_be_named_by_what_their_paths_begin_with(
    tmp_path, problem, sampler, kind, chosen
):
    for weights in FOLDER.glob("nuclei-[gp]*"):
        (tmp_path / weights.name).symlink_to(weights)
    options = Options(problem, image="x.png", prior=str(tmp_path / "nuclei"), sampler=sampler)
    found = options.resolved()
    assert found.prior == str(tmp_path / f"nuclei-{kind}.safetensors")
    assert found.sampler == chosen
    assert found.resolved() == found


def test_weights_may_be_named_as_training_was_told_to_name_them(tmp_path):
    """`posterior train --out mine` writes mine.safetensors, whatever it is of."""
    name = str(tmp_path / "mine")
    assert presets.whole_path("denoising", name, None) == name
    (tmp_path / "mine.safetensors").touch()
    (tmp_path / "mine.training").mkdir()
    for sampler in (None, "mala"):
        assert presets.whole_path("denoising", name, sampler) == f"{name}.safetensors"


def test_weights_that_begin_so_but_are_not_what_the_sampler_needs(tmp_path):
    for weights in FOLDER.glob("nuclei-poisson*"):
        (tmp_path / weights.name).symlink_to(weights)
    options = Options("denoising", image="x.png", prior=str(tmp_path / "nuclei"), sampler="dps")
    wanted = "begins nuclei-poisson-score.safetensors; .* end in -gaussian-score.safetensors"
    with pytest.raises(ValueError, match=wanted):
        options.resolved()


def test_study_data_may_lie_where_posterior_data_says(tmp_path, monkeypatch):
    (tmp_path / "home" / "fmd").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("POSTERIOR_DATA", raising=False)
    assert study_data(Path("fmd")) == Path("fmd")
    monkeypatch.setenv("POSTERIOR_DATA", str(tmp_path / "home"))
    assert study_data(Path("fmd")) == tmp_path / "home" / "fmd"
    assert study_data(None) is None
    (tmp_path / "fmd").mkdir()
    assert study_data(Path("fmd")) == Path("fmd")


@pytest.mark.slow
@pytest.mark.parametrize("problem, prior", LEARNED)
def test_a_trained_prior_serves_each_application(
    problem, prior, folder, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(starts, "_LEARNED_SEARCH", (2, 1))
    arguments = ("--image", folder / "picture.png", "--prior", prior, "--out", tmp_path / "run")
    assert _main("sample", problem, *arguments, "--size", 16, "--chains", 1, "--draws", 1) == 0
    assert "annealed is approximate" in capsys.readouterr().out
    assert np.all(np.isfinite(ps.load(tmp_path / "run" / "draws.nc").values))


def test_several_modes_and_data_that_are_not_explained_are_told():
    found = {"rhat": 1.0, "ess": 400.0}
    assert doubts(found | {"modes": 1, "largest_mode": 1.0, "misfit": 1.02}, "mala") == []
    modes, misfit = doubts(found | {"modes": 3, "largest_mode": 0.6, "misfit": 12.0}, "mala")
    assert "fall into 3 modes, 60 % of them" in modes
    assert "12 times as far from them as its noise allows" in misfit


@pytest.mark.parametrize("prior", ["nuclei-signal-score", SIGNAL])
def test_the_signal_dependent_score_is_annealed(prior):
    options = Options("denoising", image="x.png", prior=prior)
    assert options.resolved().sampler == "annealed"
    dataclasses.replace(options, sampler="annealed-split").resolved()
    with pytest.raises(ValueError, match="needs a score of the gaussian error: use --sampler ann"):
        dataclasses.replace(options, sampler="ula").resolved()
    camera, picture = models.Poisson(100), _smooth(16)
    question = presets.simulate(
        "denoising", picture, camera, jax.random.key(0), prior=prior, needs="annealed score"
    )
    assert question.problem.prior.perturbation == "signal"
    sampler = presets.sampler_of("annealed", question.problem.condition(question.y))
    assert sampler.descent == 0


def test_nuclei_are_thickened_and_the_calibration_of_their_prior_is_told(folder, tmp_path, capsys):
    arguments = ("--image", folder / "picture.png", "--prior", "nuclei", "--out", tmp_path / "run")
    assert _main("sample", "denoising", *arguments, "--size", 16, "--draws", 2) == 0
    said = capsys.readouterr().out
    assert "that were held out its intervals held 85 % of pixels" in said.replace("\n", " ")
    settings = json.loads((tmp_path / "run" / "settings.json").read_text())
    assert settings["sampler"].startswith("Thickening")
    assert settings["results"]["ess"] == 8 and "rhat" not in settings["results"]
    assert "convergence" not in said


def test_a_stack_that_photons_do_not_explain_is_doubted():
    found = {"rhat": 1.0, "ess": 400.0}
    assert doubts(found | {"dispersion": 1.1}, "mala") == []
    (said,) = doubts(found | {"dispersion": 7.1}, "mala")
    assert "leaves 7.1 times its variance" in said
    (said,) = doubts(found | {"dispersion": np.nan}, "mala")
    assert "cannot be told" in said
    # Measured under a learnt prior alone, whose chains start from halves of the stack.
    phase = "the slow phase of a stack"
    assert phase not in " ".join(doubts(found | {"dispersion": 1.1}, "annealed"))
    assert phase in " ".join(doubts(found | {"dispersion": 1.1}, "annealed", {}))


def test_a_prior_without_a_calibration_is_told_as_such():
    (said,) = doubts({"rhat": 1.0}, "mala", {}, np.zeros((4, 4)))
    assert "holds no calibration" in said


def test_a_faint_picture_is_told_before_the_work(folder, tmp_path, capsys, monkeypatch):
    def no_work(*_):
        assert "of white, the prior's pictures 1" in capsys.readouterr().err
        raise ValueError("that is all")

    monkeypatch.setattr("posterior.cli.run._draw", no_work)
    np.save(folder / "faint.npy", RNG.poisson(5 * _smooth(16)) / 100)
    given = ("--data", folder / "faint.npy", "--full-well", 100, "--prior", "nuclei")
    assert _main("sample", "denoising", "--out", tmp_path / "run", *given) == 2
    assert "that is all" in capsys.readouterr().err


def test_a_picture_fainter_than_the_priors_is_told():
    card = {"validation": {}, "preparation": {"percentile": 99.5}}
    rng = np.random.default_rng(0)
    bright, faint = rng.random((2, 64, 64)) * np.array([1.0, 0.2]).reshape(2, 1, 1)
    assert len(doubts({"rhat": 1.0}, "mala", card, bright)) == 1
    assert "reaches 0.2 of white" in doubts({"rhat": 1.0}, "mala", card, faint)[1]


# ---- refusals ------------------------------------------------------------------------------------


def _refused(capsys, *arguments, problem="denoising"):
    status = _main("sample", problem, *SMALL, *arguments)
    said = capsys.readouterr()
    assert status == 2
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert said.err.startswith("posterior: ")
    return said.err.strip()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "give either --image"),
        (["--image", "{}/picture.png", "--data", "{}/counts.npy"], "give either --image"),
        (["--image", "{}/nowhere.png"], "nowhere.png: give the path of a picture"),
        (["--image", "{}/picture.png", "--sampler", "gibbs"], "use one of mala, annealed"),
        (["--image", "{}/picture.png", "--size", "99"], "size 99 .*: give 16 or less"),
        (["--image", "{}/picture.png", "--size", "3"], "--size 3: give a whole number, 4 or more"),
        (
            ["--image", "{}/picture.png", "--draws", "0"],
            "--draws 0: give a whole number, 1 or more",
        ),
        (["--image", "{}/picture.png", "--draws", "many"], "'--draws'"),
        (
            ["--image", "{}/picture.png", "--full-well", "0"],
            "--full-well 0: give a whole number, 1 to 8388607",
        ),
        (["--image", "{}/picture.png", "--full-well", "99999999"], "1 to 8388607"),
        (["--image", "{}/picture.png", "--white", "101"], "101 electrons are more than the full"),
        (["--image", "{}/picture.png", "--white", "0"], "--white 0: give a whole number, 1 to"),
        (["--image", "{}/picture.png", "--bits", "17"], "--bits 17: give a whole number, 0 to 16"),
        (["--image", "{}/picture.png", "--page", "4"], "page 4 .* it has one page"),
        (["--image", "{}/pages.tif"], "holds 2 pages: choose one with --page"),
        (["--image", "{}/specimen.npy"], "complex: denoising is of real objects"),
        (["--image", "{}/colour.png"], "say --colour planes .*, --colour luminance"),
        (["--image", "{}/picture.png", "--colour", "pink"], "unknown colour 'pink': use one of"),
        (["--image", "{}/picture.png", "--prior", "faces"], "the prior is in colour: give .h"),
        (["--image", "{}/colour.png", "--prior", "faces", "--colour", "planes"], "leave it out"),
        (["--image", "{}/picture.png", "--leds", "9"], "--leds 9: only ptychography takes it"),
        (["--image", "{}/picture.png", "--start", "hio"], "--start hio: only phase-retrieval"),
        (["--image", "{}/picture.png", "--irradiance", "2"], "irradiance 2.0: .* leave it out"),
        (["--image", "{}/picture.png", "--oversampling", "2"], "oversampling 2 is for phase"),
        (["--image", "{}/picture.png", "--prior", "{}/nowhere"], "nowhere: give the path"),
        (["--image", "{}/picture.png", "--prior", "{}/empty"], "holds no pictures"),
        (["--image", "{}/picture.png", "--prior", "{}/picture.png"], "give a prior of others"),
        (
            ["--image", "{}/picture.png", "--prior", NUCLEI] + ["--sampler", "mala"],
            "needs a density: use --sampler annealed",
        ),
        (
            ["--image", "{}/picture.png", "--prior", NUCLEI] + ["--sampler", "thickening"],
            "needs a denoiser of counts: use --sampler annealed",
        ),
        (["--image", "{}/picture.png", "--sampler", "ensemble"], "use samplers.MALA"),
        (["--image", "{}/truncated.png"], "damaged or truncated"),
        (["--image", "{}/nan.npy"], "holds NaN or infinity in 1 places"),
        (["--image", "{}/flat.npy"], "has the value 0.5 everywhere"),
        (["--image", "{}/loud.npy"], "the value 12, outside 0..1: divide it by its full scale"),
        (["--image", "{}"], "is a folder: give one picture|no file"),
        (["--data", "{}/codes.npy"], "--data needs --full-well"),
        (["--data", "{}/codes.npy", "--full-well", "100"], "how many bits with --bits"),
        (["--data", "{}/counts.npy", "--full-well", "70"], "not a whole number"),
        (["--data", "{}/loud.npy", "--full-well", "70"], "above the full well"),
        (["--data", "{}/counts.npy", "--full-well", "100", "--size", "8"], "leave out --size"),
        (["--data", "{}/pages.tif", "--full-well", "255", "--bits", "8"], "one grey page"),
        (["--data", "{}/specimen.npy", "--full-well", "100"], "complex data"),
        (["--nonsense"], "No such option"),
    ],
)
def test_refusals_are_one_sentence_and_write_nothing(folder, tmp_path, capsys, arguments, sentence):
    _bad_inputs(folder)
    out = tmp_path / "out"
    said = _refused(capsys, *[a.format(folder) for a in arguments], "--out", out)
    assert re.search(sentence, said), said
    assert not out.exists()


def _bad_inputs(folder):
    whole = (folder / "picture.png").read_bytes()
    (folder / "truncated.png").write_bytes(whole[: len(whole) // 2])
    (folder / "empty").mkdir(exist_ok=True)
    picture = _smooth(16)
    np.save(folder / "flat.npy", np.full((16, 16), 0.5))
    np.save(folder / "loud.npy", np.where(picture == picture.max(), 12.0, 0.5))
    np.save(folder / "nan.npy", np.where(picture == picture.max(), np.nan, 0.5))


@pytest.mark.parametrize("problem", ["phase-retrieval", "ptychography"])
def test_a_picture_in_colour_is_asked_for_its_luminance(folder, tmp_path, capsys, problem):
    image, out = folder / "colour.png", tmp_path / "out"
    said = _refused(capsys, "--image", image, "--out", out, problem=problem)
    assert "in colour and" in said and "say --colour luminance" in said
    picture, camera = read_picture(image), models.Poisson(10_000)
    asked = {"colour": "luminance", "size": 16, "leds": 9 if problem == "ptychography" else None}
    question = presets.simulate(problem, picture, camera, jax.random.key(0), **asked)
    assert question.truth.ndim == 2


@pytest.mark.parametrize(
    ("problem", "name", "array", "extra", "sentence"),
    [
        ("deblurring", "a.npy", _smooth(16), [], "unknown problem 'deblurring': use one of deno"),
        ("phase-retrieval", "a.npy", np.zeros((17, 16)), [], "oversampling 2 must divide it"),
        ("phase-retrieval", "a.npy", np.zeros((16, 16)), [], "dark everywhere"),
        ("ptychography", "a.npy", np.zeros((48, 8, 8)), [], r"give \(9 or 25 or 49 or .*, n, n\)"),
        ("ptychography", "a.npy", np.zeros((49, 8, 8)), ["--leds", "9"], r"give \(9, n, n\)"),
        ("ptychography", "a.npy", np.zeros((49, 8, 8)), ["--leds", "50"], "give one of 9, 25, 49"),
        ("ptychography", "a.npy", np.zeros((225, 8, 8)), ["--size", "16"], "give 20 or more"),
        ("ptychography", "a.npy", np.zeros((49, 8, 8)), ["--size", "24"], "4 times as wide"),
    ],
)
def test_recordings_that_do_not_fit(tmp_path, capsys, problem, name, array, extra, sentence):
    np.save(tmp_path / name, array)
    said = _refused(
        capsys, "--data", tmp_path / name, "--full-well", 100, "--out", tmp_path / "out", *extra,
        problem=problem,
    )  # fmt: skip
    assert re.search(sentence, said), said
    assert not (tmp_path / "out").exists()


def test_a_far_field_with_its_zero_in_the_middle_is_refused(tmp_path, capsys):
    y = np.zeros((16, 16))
    y[8, 8] = 1
    np.save(tmp_path / "y.npy", y)
    arguments = ("--data", tmp_path / "y.npy", "--full-well", 1, "--out", tmp_path / "out")
    said = _refused(capsys, *arguments, problem="phase-retrieval")
    assert "bring the zero frequency to index 0 with numpy.fft.ifftshift" in said


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is read-only to the superuser")
def test_a_read_only_folder_is_refused(folder, tmp_path, capsys):
    tmp_path.chmod(0o500)
    said = _refused(capsys, "--image", folder / "picture.png", "--out", tmp_path / "out")
    tmp_path.chmod(0o700)
    assert "cannot write to" in said


def test_a_file_in_place_of_the_folder_is_refused(folder, tmp_path, capsys):
    (tmp_path / "out").write_text("mine")
    said = _refused(capsys, "--image", folder / "picture.png", "--out", tmp_path / "out")
    assert "cannot write to" in said
    assert (tmp_path / "out").read_text() == "mine"


def _repeat_refused(capsys, *arguments):
    status = _main("repeat", *arguments)
    said = capsys.readouterr().err
    assert status == 2
    assert said.count("\n") == 1
    return said


def test_repeat_refuses_what_is_no_settings_file(tmp_path, capsys):
    path = tmp_path / "settings.json"
    assert "no file" in _repeat_refused(capsys, path, "--out", tmp_path / "out")
    for text in ("{", "[]", "{}", '{"options": {"problem": "denoising"}}'):
        path.write_text(text)
        assert "is not the settings.json" in _repeat_refused(capsys, path, "--out", tmp_path / "o")
    assert _files(tmp_path) == {"settings.json"}


def test_repeat_refuses_an_input_that_has_changed(denoised, folder, tmp_path, capsys):
    path = tmp_path / "settings.json"
    settings = json.loads((denoised / "settings.json").read_text())
    settings["options"]["image"] = str(folder / "deep.tif")
    path.write_text(json.dumps(settings))
    said = _repeat_refused(capsys, path, "--out", tmp_path / "out")
    assert "deep.tif has changed since the run" in said
    settings = json.loads((denoised / "settings.json").read_text())
    settings["prior"]["1.png"] = "0" * 64
    path.write_text(json.dumps(settings))
    said = _repeat_refused(capsys, path, "--out", tmp_path / "out")
    assert "prior picture 1.png has changed since the run" in said


# ---- measured stacks -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    """Nine LEDs of a microscope of NA 0.1, 16x16 camera pixels."""
    axis = 0.06 * np.arange(-1, 2)
    numbers = {"na": 0.1, "wavelength": 0.6e-6, "pixel_size": 1.4e-6}
    leds = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    optics = models.FourierPtychography.from_microscope(
        (48, 48), upsampling=3, led_na=leds, **numbers
    )
    o = presets.complex_object(_smooth(48)).astype(np.complex64)
    counts = RNG.poisson(200 * np.abs(np.asarray(optics(o))) ** 2)
    path = tmp_path_factory.mktemp("stack") / "stack.npz"
    np.savez(path, intensity=counts, led_na=leds, **numbers)
    return path


@pytest.mark.slow
def test_a_measured_stack(folder, stack, tmp_path, capsys, monkeypatch):
    """Drawn, said, and drawn again; calibrated in a hurry."""
    hurried = functools.partial(presets.questions.calibrate, rounds=1, iterations=10)
    monkeypatch.setattr(presets.questions, "calibrate", hurried)
    arguments = ("--prior", folder / "specimen.npy", "--electrons", 1, "--background", *SMALL)
    out = tmp_path / "run"
    assert _main("sample", "ptychography", "--stack", stack, "--out", out, *arguments) == 0
    assert {f.name for f in out.iterdir()} == COMPLEX
    said = capsys.readouterr().out
    assert said.startswith("ptychography of stack.npz: mala") and "squared residual" in said
    microscope = json.loads((out / "settings.json").read_text())["microscope"]
    assert {"electrons", "dispersion", "background", "leds", "aberration"} == set(microscope)
    assert any(light > 0 for light in microscope["background"])
    assert np.allclose(microscope["electrons"], 1)
    # The rim is drawn, and not shown.
    shown = tifffile.imread(out / "mean_amplitude.tif").shape
    drawn = ps.load(out / "draws.nc").values.shape[2:]
    assert shown == (32, 32) and min(drawn) > 32
    again = tmp_path / "again"
    assert _main("repeat", out / "settings.json", "--out", again, "--quiet") == 0
    first, second = (ps.load(path / "draws.nc").values for path in (out, again))
    np.testing.assert_array_equal(second, first)


@pytest.mark.parametrize(
    "problem, option, sentence",
    [
        ("ptychography", ("--full-well", 100), "--full-well 100: a stack says so itself"),
        ("ptychography", ("--size", 64), "--size 64: a stack says so itself"),
        ("ptychography", ("--oversampling", 3), "--oversampling 3: a stack says so itself"),
        ("ptychography", ("--colour", "luminance"), "--colour luminance: a stack says so itself"),
        ("ptychography", ("--data", "x.tif"), "give either --image"),
        ("ptychography", ("--electrons", 0), "electrons of shape (), the least 0"),
        ("denoising", (), "--stack is for ptychography"),
    ],
)
def test_what_cannot_go_with_a_stack(stack, tmp_path, capsys, problem, option, sentence):
    out = tmp_path / "run"
    assert _main("sample", problem, "--stack", stack, "--out", out, *option) == 2
    assert sentence in capsys.readouterr().err and not out.exists()
