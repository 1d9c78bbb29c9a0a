"""Certificates: right for an exact sampler, a broken one, one that is stuck, one that refuses."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior import samplers
from posterior.diagnostics import beside_exact
from posterior.diagnostics.campaign import Settings
from posterior.diagnostics.certificate import Certificate, certify, settings_of
from posterior.diagnostics.certificate_table import as_matrix, as_table
from posterior.diagnostics.sbc import Calibration
from posterior.models.gallery import (
    gamma_poisson,
    linear_gaussian,
    mixture_linear,
    of_counts,
    one_complex_pixel,
)

LINEAR = linear_gaussian(size=8, rows=6)
MIXTURE = mixture_linear()


def certified(sampler, known, simulations=40, **settings):
    return certify(
        sampler, {"it": known}, jax.random.key(0), simulations, progress=False, **settings
    )["it"]


def test_exact_draws_pass_at_the_noise_floor():
    found = certified(lambda key, p: MIXTURE.exact(key, p.y, 200)[None], MIXTURE)
    assert found.verdict.startswith("passes")
    # Ratios of means over eight recordings: over 16 keys their sd was 12 and 26 %.
    assert abs(found.distance - 1) < 4 * 0.12
    assert 0.12 / 4 < found.distance_error < 0.12 * 4
    assert abs(np.log(found.mode_error / found.mode_floor)) < 4 * 0.26


def test_a_sampler_of_ten_lines_that_is_wrong_fails():
    """Draws that are 1.4 times too narrow about their mean."""

    def narrow(key, posterior):
        draws = LINEAR.exact(key, posterior.y, 100)
        mean = LINEAR.exact(key, posterior.y, 5000).mean(axis=0)
        return (mean + (draws - mean) / 1.4)[None]

    found = certified(narrow, LINEAR, 100)
    assert found.verdict.startswith("fails: ")
    # By how much: the quantity that is named covers too little.
    name = found.verdict.removeprefix("fails: ").split(" (p = ")[0]
    share, error = found.calibration.coverage(0.8)[name]
    assert f"80 % intervals of it hold {100 * share:.0f} +- {100 * error:.0f} %" in found.verdict
    assert found.p == found.calibration.p[name] < 0.05


@pytest.mark.slow
def test_chains_that_hardly_move_are_not_judged_and_their_budget_is_named():
    found = certified(samplers.ULA(1e-7), LINEAR, 20, settings=Settings(2, 50, 0, 1))
    assert found.verdict.startswith("cannot be judged: 2 independent draws of ")
    assert "take at least 2.5 times as many as 2 chains of 50 draws, thinned by 1" in found.verdict
    assert "no chain is worth more than one draw" in found.verdict
    assert found.evaluations == 2 * 50 and 1 <= found.effective < 8
    assert found.effective_per_evaluation == found.effective / found.evaluations


@pytest.mark.slow
def test_chains_that_never_leave_their_mode_are_not_judged():
    found = certified(samplers.MALA(), one_complex_pixel(0.1), 20)
    assert found.verdict.startswith("cannot be judged")
    assert "distance to a mode" in found.verdict and found.mode_error > 0.1


def test_draws_that_are_lost_beside_the_exact_ones_are_not_passed_over():
    """A sampler that is exact in the simulations, and NaN where it is compared."""
    keys = jax.random.split(jax.random.fold_in(jax.random.key(0), 2**31 + 1), 8)
    lost = jax.random.key_data(jax.random.split(keys[2], 4)[1])

    def sampler(key, posterior):
        draws = LINEAR.exact(key, posterior.y, 20)[None]
        return jnp.where(jnp.all(jax.random.key_data(key) == lost), jnp.nan, draws)

    found = certified(sampler, LINEAR, 20)
    assert found.verdict == "fails: draws of 1 in 8 recordings are not finite"
    assert found.distance is None


def test_a_sampler_that_diverges_fails_and_one_that_refuses_does_not_apply():
    assert "NaN" in certified(samplers.ULA(100.0), LINEAR, 20).verdict
    found = certified(samplers.Ensemble(), LINEAR, 20)
    assert found.verdict.startswith("does not apply: Ensemble (emcee) cannot be compiled")
    assert found.calibration is None


@pytest.fixture(scope="module")
def table():
    found = certified(lambda key, p: LINEAR.exact(key, p.y, 50)[None], LINEAR, 20)
    refused = certified(samplers.Ensemble(), LINEAR, 20)
    return {"exact": {"a": found}, "emcee": {"a": refused}}


def test_the_table_has_a_row_for_each(table):
    rows = as_table(table).splitlines()
    assert len(rows) == 4
    assert all(row.count("|") == rows[0].count("|") for row in rows)
    assert "passes" in rows[2] and "does not apply" in rows[3]


def test_the_matrix_has_a_column_for_each_sampler():
    ranks = np.full((50, 1), 0.999)
    failed = Calibration(("norm",), ranks, np.array([100.0]))
    found = {
        "one": {"a": Certificate(failed.verdict(), failed, 1.234)},
        "two": {"b": Certificate("does not apply: it is complex")},
    }
    assert as_matrix(found).splitlines() == [
        "| problem | one | two |",
        "|---|---|---|",
        "| a | **fails**: norm, 1.23 |  |",
        "| b |  | does not apply |",
    ]


def test_its_numbers_are_json(table):
    plain = json.loads(json.dumps({k: v["a"].as_dict() for k, v in table.items()}))
    assert plain["exact"]["simulations"] == 20
    by_quantity = [one["p"] for one in plain["exact"]["calibration"].values()]
    assert plain["exact"]["p"] == min(by_quantity) and plain["emcee"]["p"] is None
    # A function of exact draws asks for no score.
    assert plain["exact"]["effective"] == 50 and plain["exact"]["evaluations"] == 0
    assert plain["exact"]["effective_per_evaluation"] is None
    assert set(plain["exact"]["calibration"]["squared norm"]) == {"p", "draws", "coverage"}
    assert plain["emcee"]["calibration"] is None


def test_quantities_that_the_verdict_leaves_out_have_no_say_in_its_figures():
    """Of the slow one all truths are above all draws, of the others half or fewer."""
    ranks = np.stack([np.full(50, 0.999), np.linspace(0.015, 0.985, 50)], axis=1)
    calibration = Calibration(("slow", "right"), ranks, np.array([3.0, 100.0]))
    found = Certificate(calibration.verdict(), calibration, 1.23, distance_error=0.1)
    assert found.kind == "cannot be judged" and found.p > 0.5 > calibration.p["slow"]
    row = as_table({"it": {"a": found}}).splitlines()[2]
    assert "| 52, 80, 96 | 1.23 \N{PLUS-MINUS SIGN} 0.10 |" in row
    plain = found.as_dict()
    assert plain["p"] == found.p and plain["distance_error"] == 0.1
    assert plain["calibration"]["slow"]["p"] is None
    nothing = found._replace(calibration=calibration._replace(effective=np.array([3.0, 3.0])))
    assert nothing.p is None
    assert as_table({"it": {"a": nothing}}).splitlines()[2].count("|") == row.count("|")


def test_what_cannot_be_certified_is_refused_at_once():
    with pytest.raises(ValueError, match="no problems to certify on: give {name: Known}"):
        certify(samplers.MALA(), {})
    with pytest.raises(ValueError, match="problem a is a function: give a models.gallery.Known"):
        certify(samplers.MALA(), {"a": linear_gaussian})
    with pytest.raises(ValueError, match=r"sampler is the class MALA: give MALA"):
        certified(samplers.MALA, LINEAR)


def test_settings_of_samplers_whose_draws_are_runs():
    assert settings_of(samplers.AnnealedLangevin()) == Settings(20, 1, None, 1)
    assert settings_of(samplers.MALA()).chains == 4


@pytest.mark.slow
def test_a_polish_is_certified_as_it_is_used_tuned():
    """It mends levels that are far too few; one that is not tuned accepts nothing."""
    sampler = samplers.AnnealedLangevin(levels=2, steps=1, polish=400)
    assert certified(sampler, LINEAR, 100).verdict.startswith("passes")
    untuned = settings_of(sampler)._replace(warmup=0)
    assert certified(sampler, LINEAR, 100, settings=untuned).verdict.startswith("fails")


def test_a_sampler_that_is_too_slow_is_not_judged_and_its_budget_is_named():
    def exact(key, posterior):
        return LINEAR.exact(key, posterior.y, 20)[None]

    found = certified(exact, LINEAR, 40, limit=1e-6)
    assert found.kind == "cannot be judged" and found.distance is None
    assert "32 of 40 simulations took" in found.verdict


@pytest.mark.slow
def test_thickening_is_certified_under_the_error_of_counts():
    known, sampler = gamma_poisson(4), samplers.Thickening(levels=24)
    assert certified(sampler, known, 20).verdict.startswith("does not apply")
    assert certified(sampler, of_counts(known), 100).verdict.startswith("passes")
    short = samplers.Thickening(levels=24, sigma_min=0.1)
    assert certified(short, of_counts(known), 100).verdict.startswith("fails")
    with pytest.raises(ValueError, match="the prior is a Gaussian: give a problem of a PixelPrior"):
        of_counts(LINEAR)


def test_an_interrupted_certificate_goes_on_and_repeats_nothing(tmp_path, monkeypatch):
    def exact(key, posterior):
        return LINEAR.exact(key, posterior.y, 20)[None]

    first = certified(exact, LINEAR, 20, folder=tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(beside_exact, "_figures", lambda *_: pytest.fail("compared again"))
        again = certified(exact, LINEAR, 20, folder=tmp_path)
    assert jnp.array_equal(first.calibration.ranks, again.calibration.ranks)
    assert first._replace(calibration=None) == again._replace(calibration=None)
    assert any((tmp_path / "it").iterdir())
    # Figures of another sampler are not taken for this one's.
    kept = json.loads((tmp_path / "it.json").read_text())
    kept |= {"fingerprint": "another", "figures": kept["figures"] | {"distance": 9.0}}
    (tmp_path / "it.json").write_text(json.dumps(kept))
    assert certified(exact, LINEAR, 20, folder=tmp_path).distance == first.distance
