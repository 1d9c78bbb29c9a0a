"""Stored moments of the gallery, and their errors: against closed forms and draws made anew."""

import jax
import numpy as np
import pytest
import scipy.stats

from posterior import cli
from posterior.models import reference
from posterior.models.gallery import GALLERY, file_name
from posterior.models.realview import real_size

QUICK = "mixture, 8 dimensions"


@pytest.mark.parametrize("name", ["linear Gaussian", "linear Gaussian, 4 rows of 32"])
def test_of_a_gaussian_they_are_the_closed_form(name):
    """By a solve of the normal equations, not by the gain that the gallery uses."""
    known, found = GALLERY[name](), reference.load(name)
    h = np.asarray(known.likelihood.optics.matrix, float)
    noise, prior = known.likelihood.camera.sigma, known.prior
    prior_precision = np.linalg.inv(np.asarray(prior.covariance, float))
    precision = prior_precision + h.T @ h / noise**2
    right = prior_precision @ np.asarray(prior.mean, float) + h.T @ found.recording / noise**2
    mean, sd = np.linalg.solve(precision, right), np.sqrt(np.diag(np.linalg.inv(precision)))
    z = np.concatenate([(found.mean - mean) / found.mean_error, (found.sd - sd) / found.sd_error])
    assert 2 * scipy.stats.t(found.sets - 1).sf(np.abs(z).max()) * z.size > 1e-3
    # The errors too are right: each is known to 1 / sqrt(2 x 49), their squares add up.
    size = np.sqrt(np.mean((found.mean_error / sd) ** 2) * found.sets * found.draws)
    assert abs(size - 1) < 4 * np.sqrt(1 / (2 * 49 * 12))


def test_of_counts_they_are_the_gamma_posterior():
    found = reference.load("gamma and Poisson")
    exact = scipy.stats.gamma(3 + 50 * found.recording, scale=1 / 70)
    assert np.abs((found.mean - exact.mean()) / found.mean_error).max() < 4
    assert np.abs((found.sd - exact.std()) / found.sd_error).max() < 4


@pytest.mark.parametrize(
    "name", [QUICK, *(pytest.param(n, marks=pytest.mark.slow) for n in GALLERY if n != QUICK)]
)
def test_they_are_found_again(name):
    """By another seed; draws 5 % too wide, or moved by 5 % of their sd, are not taken for it."""
    with jax.enable_x64(True):
        known, found = GALLERY[name](), reference.load(name)
        y = np.asarray(found.recording)
        anew = reference.make(known, y, jax.random.key(9))
        z, p = reference.apart(anew, found)
        print(f"\n{name}: {z:.1f} standard errors, p {p:.2g}")
        assert p > 1e-3 / len(GALLERY)
        wide = anew._replace(sd=1.05 * anew.sd)
        moved = anew._replace(mean=anew.mean + 0.05 * anew.sd)
        assert reference.apart(wide, found)[1] < 1e-3
        assert reference.apart(moved, found)[1] < 1e-3


def test_references_of_exact_draws_agree_at_the_nominal_rate():
    """Of 200 pairs, at 5 %: not more than 99.5 % of binomial counts; Bonferroni errs downwards."""
    known, found = GALLERY["gamma and Poisson"](), reference.load("gamma and Poisson")
    made = [
        reference.make(known, found.recording, jax.random.key(i), sets=20, draws=100)
        for i in range(400)
    ]
    pairs = list(zip(made[:200], made[200:]))
    alarms = sum(reference.apart(a, b)[1] < 0.05 for a, b in pairs)
    assert alarms <= scipy.stats.binom(200, 0.05).isf(0.005)
    # In square, beside Student's t of about twice 19 degrees: errors 10 % off are 21 % here.
    freedom = 38
    for name in ("mean", "sd"):
        z = [
            (getattr(a, name) - getattr(b, name))
            / np.hypot(getattr(a, f"{name}_error"), getattr(b, f"{name}_error"))
            for a, b in pairs
        ]
        squares = np.asarray(z) ** 2
        t = scipy.stats.t(freedom)
        error = np.sqrt((t.moment(4) - t.var() ** 2) / squares.size)
        assert abs(squares.mean() - t.var()) < 4 * error < 0.12


def test_every_problem_has_one_that_fits_it():
    for name, build in GALLERY.items():
        found, known = reference.load(name), build()
        assert found.basis == known.basis
        assert found.recording.shape == known.likelihood.data_shape
        assert found.mean.size == real_size(known.prior.shape, known.prior.dtype)
        assert found.masses.size == (0 if known.modes is None else len(known.modes))
        assert (found.sets, found.draws) == (50, 4000)
        assert found.mean.shape == found.sd.shape == found.mean_error.shape
        assert np.all(found.sd > 0) and np.all(found.mean_error > 0)
        # By importance not all draws count; of few the errors would not be known either.
        assert found.worth() > (140_000 if "importance" not in found.basis else 40_000)
        assert all(np.isfinite(part).all() for part in found[1:7])
        if found.masses.size:
            assert abs(found.masses.sum() - 1) < 1e-12


def test_bad_files_names_and_recordings_are_one_sentence(tmp_path):
    with pytest.raises(ValueError, match="unknown problem 'x'"):
        reference.load("x")
    with pytest.raises(FileNotFoundError):
        reference.load(QUICK, tmp_path)
    whole = (reference.STORED / f"{file_name(QUICK)}.npz").read_bytes()
    place = whole.index(b"mean.npy") + 100  # among the numbers, compressed
    flipped = whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :]
    for damaged in (b"", whole[:500], whole[: len(whole) // 2], flipped):
        (tmp_path / f"{file_name(QUICK)}.npz").write_bytes(damaged)
        with pytest.raises(ValueError, match="is damaged: restore it"):
            reference.load(QUICK, tmp_path)
    other = reference.load("mixture, 80 dimensions")
    with pytest.raises(ValueError, match="different recordings"):
        reference.apart(reference.load(QUICK), other)
    found = reference.load(QUICK)
    with pytest.raises(ValueError, match="holds NaN"):
        reference.apart(found._replace(mean=found.mean * np.nan), found)
    lost = GALLERY[QUICK]()._replace(exact=lambda key, y, count: jax.numpy.full((count, 8), np.nan))
    with pytest.raises(ValueError, match="draws hold NaN"):
        reference.make(lost, found.recording, jax.random.key(0), sets=2)
    with pytest.raises(ValueError, match="give 2 or more"):
        reference.make(GALLERY[QUICK](), other.recording, jax.random.key(0), sets=1)


def run(*arguments):
    with pytest.raises(SystemExit) as caught:
        cli.main(["gallery", *arguments])
    return caught.value.code or 0


def test_the_command_compares_writes_and_says_what_differs(tmp_path, capsys, monkeypatch):
    assert run("--problem", QUICK, "--out", str(tmp_path)) == 0
    said = capsys.readouterr().out
    assert f"| {QUICK} | 200000 | " in said and " | 25 | " in said and "closed form" in said
    made = reference.load(QUICK, tmp_path)
    assert reference.apart(made, reference.load(QUICK))[1] > 1e-3
    wrong = reference.load(QUICK)
    wrong = wrong._replace(mean=wrong.mean + 10 * wrong.mean_error)
    monkeypatch.setattr(reference, "load", lambda name: wrong)
    assert run("--problem", QUICK, "--quiet") == 2
    # When it is found, and at the end.
    assert capsys.readouterr().err.count(f"differ from the stored ones: {QUICK} (p = ") == 2
    assert run("--problem", "x") == 2
