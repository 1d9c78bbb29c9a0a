"""sample() and Draws: settings, streaming, files, checkpoints, and what is refused."""

import os
import signal
import subprocess
import sys
import time

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from posterior import diagnostics, models, samplers

SCRIPT = """
import sys, jax, numpy as np
import posterior as ps
from posterior import diagnostics, models, samplers
prior = models.GaussianPrior(0.0, 1.0, (3,))
likelihood = models.LinearLikelihood(models.Identity((3,)), models.Gaussian(0.5))
post = ps.Problem(likelihood, prior).condition(np.array([0.1, 0.2, 0.3], np.float32))
draws = ps.sample(post, samplers.MALA(), jax.random.key(0), chains=2, draws=400, thin=2000,
                  warmup=200, progress=False, checkpoint=sys.argv[1])
np.save(sys.argv[2], draws.values)
"""


def gaussian_problem(dtype=float, shape=(3,)):
    prior = models.GaussianPrior(0.0, 1.0, shape, dtype)
    likelihood = models.LinearLikelihood(models.Identity(shape), models.Gaussian(0.5))
    return ps.Problem(likelihood, prior)


def gaussian_posterior(dtype=float, shape=(3,)):
    y = np.linspace(0, 1, int(np.prod(shape))).reshape(shape)
    return gaussian_problem(dtype, shape).condition(y + (1j * y if dtype is complex else 0))


def run(post=None, sampler=None, key=0, **settings):
    settings = {"chains": 2, "draws": 10, "warmup": 10, "progress": False, **settings}
    post = gaussian_posterior() if post is None else post
    return ps.sample(post, sampler or samplers.ULA(0.01), jax.random.key(key), **settings)


@pytest.mark.parametrize("dtype", [float, complex])
def test_streamed_moments_are_those_of_the_kept_draws(dtype):
    post = gaussian_posterior(dtype, (2, 3))
    kept, streamed = run(post, draws=50), run(post, draws=50, keep=False)
    np.testing.assert_allclose(kept.mean, kept.values.mean((0, 1)), rtol=1e-4)
    np.testing.assert_allclose(kept.sd, kept.values.std((0, 1)), rtol=1e-4)
    np.testing.assert_array_equal(kept.mean, streamed.mean)
    np.testing.assert_array_equal(kept.sd, streamed.sd)
    with pytest.raises(ValueError, match="keep=False"):
        _ = streamed.values


def test_thinned_draws_are_every_nth_of_all_draws():
    every, third = run(draws=30).values, run(draws=10, thin=3).values
    np.testing.assert_array_equal(every[:, 2::3], third)


def test_a_chain_does_not_depend_on_its_companions():
    np.testing.assert_allclose(run(chains=1).values[0], run(chains=3).values[0], rtol=1e-6)


@pytest.mark.parametrize("dtype", [float, complex])
def test_draws_come_back_equal_from_disk(tmp_path, dtype):
    draws = run(gaussian_posterior(dtype, (2, 3)), samplers.MALA())
    draws.save(tmp_path / "run.nc")
    loaded = ps.load(tmp_path / "run.nc")
    assert loaded.dataset.identical(draws.dataset)
    assert loaded.values.dtype == draws.values.dtype
    assert dict(loaded.dataset["draws"].sizes) == {"chain": 2, "draw": 10, "row": 2, "col": 3}
    assert loaded.settings["draws"] == 10
    assert set(loaded.stats) == {"acceptance_rate", "log_prob"}


def test_arviz_groups_hold_real_variables():
    tree = run(gaussian_posterior(complex), samplers.MALA()).to_arviz()
    assert set(tree.children) == {"posterior", "sample_stats", "observed_data"}
    assert set(tree["posterior"].data_vars) == {"x_real", "x_imag"}


def test_a_truncated_or_missing_file_is_one_sentence(tmp_path):
    path = tmp_path / "run.nc"
    with pytest.raises(FileNotFoundError, match=r"run\.nc"):
        ps.load(path)
    run().save(path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match="truncated"):
        ps.load(path)


def test_a_killed_process_goes_on_bit_identically(tmp_path):
    """SIGKILL in the middle of drawing; the second process ends with the draws of a whole run."""

    def command(folder):
        return [
            sys.executable,
            "-c",
            SCRIPT,
            str(tmp_path / folder),
            str(tmp_path / folder) + ".npy",
        ]

    process = subprocess.Popen(command("killed"))
    state = tmp_path / "killed" / "state.eqx"
    shard = tmp_path / "killed" / "draws-000000.npz"
    until = time.time() + 120
    while not (state.exists() and shard.exists()) and time.time() < until:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not os.path.exists(tmp_path / "killed.npy"), "the run was over before it was killed"
    subprocess.run(command("killed"), check=True)
    subprocess.run(command("whole"), check=True)
    np.testing.assert_array_equal(np.load(tmp_path / "killed.npy"), np.load(tmp_path / "whole.npy"))


def test_a_checkpoint_of_another_run_is_refused_and_kept(tmp_path):
    run(checkpoint=tmp_path / "a")
    before = {p.name: p.read_bytes() for p in (tmp_path / "a").iterdir()}
    for other in ({"key": 1}, {"chains": 3}, {"sampler": samplers.ULA(0.02)}):
        with pytest.raises(ValueError, match="another run"):
            run(**other, checkpoint=tmp_path / "a")
    assert before == {p.name: p.read_bytes() for p in (tmp_path / "a").iterdir()}


def test_a_run_that_diverges_says_when_and_keeps_its_checkpoint(tmp_path):
    with pytest.raises(ps.NonFiniteError, match=r"step \d+ of drawing.*step size.*tenth"):
        run(sampler=samplers.ULA(10.0), warmup=0, draws=2000, checkpoint=tmp_path / "a")
    assert (tmp_path / "a" / "run.json").exists()


def test_new_data_and_more_draws_do_not_recompile(caplog):
    """The compiler logs what it compiles: the chunks of a run once, and never again."""

    def compiled(value, draws):
        caplog.clear()
        with jax.log_compiles():
            run(problem.condition(np.full(3, value)), samplers.MALA(), draws=draws)
        return [r.getMessage() for r in caplog.records if "Finished XLA" in r.getMessage()]

    problem = gaussian_problem(shape=(3,))
    jax.clear_caches()
    assert any("_advance" in message for message in compiled(0.1, 10))
    again = compiled(0.2, 10) + compiled(0.3, 20)
    assert not [m for m in again if "_begin" in m or "_warm" in m or "_advance" in m], again


def denoising(bits=8):
    prior = models.GaussianPrior(0.5, 0.01, (2,))
    likelihood = models.LinearLikelihood(models.Identity((2,)), models.Poisson(100, bits=bits))
    return ps.Problem(likelihood, prior)


BAD = [
    (lambda: run(chains=0), "chains 0"),
    (lambda: run(draws=0), "draws 0"),
    (lambda: run(thin=0.5), r"thin 0\.5"),
    (lambda: run(warmup=-1), "warmup -1"),
    (lambda: run(sampler="mala"), "sampler is a str"),
    (lambda: ps.sample(denoising(), samplers.MALA(), jax.random.key(0)), "problem.condition"),
    (lambda: run(start=jnp.zeros(5)), r"\(5,\)"),
    (lambda: run(start=jnp.full(3, jnp.nan)), "start holds NaN"),
    (lambda: run(start=1j * jnp.ones(3)), "start is complex"),
    (lambda: run(sampler=samplers.TemperedSMC(), keep=False), "population"),
    (lambda: run(gaussian_posterior(shape=(41,)), samplers.Ensemble()), "41 real dim.*MALA"),
    (lambda: samplers.Ensemble(walkers=7).size(gaussian_posterior()), "walkers 7"),
    (lambda: samplers.ULA(0.0), r"step_size 0\.0"),
    (lambda: samplers.MALA(preconditioner="magic"), "'magic'"),
    (lambda: samplers.AnnealedLangevin(levels=1), "levels 1"),
    (lambda: samplers.AnnealedLangevin(path="bent"), "'bent'"),
    (lambda: samplers.AnnealedLangevin(path="convolved", published=True), "split"),
    (lambda: denoising().condition(np.array([0.1, np.nan])), "(?i)nan"),
    (lambda: denoising().condition(np.array([-0.1, 0.2])), r"-0\.1"),
    (lambda: denoising().condition(np.array([1.7, 0.2])), r"1\.7.*full well"),
    (lambda: denoising().condition(np.array([17, 20])), "integer.*from_codes"),
    (lambda: denoising().condition(np.array([0.1, 0.2, 0.3])), r"\(3,\).*\(2,\)"),
    (lambda: denoising().condition(np.array([0.1j, 0.2])), "complex"),
    (lambda: ps.Problem(denoising().likelihood, gaussian_problem().prior), r"\(3,\).*\(2,\)"),
    (lambda: ps.Problem(denoising().prior, denoising().prior), "likelihood is a"),
]


@pytest.mark.parametrize("build, sentence", BAD)
def test_bad_input_is_one_sentence(build, sentence):
    with pytest.raises(ValueError, match=sentence):
        build()


@pytest.mark.slow
def test_nuts_is_tuned_by_its_warmup():
    """Scales from 0.01 to 5: with the step and metric it starts from it would not move."""
    scale = np.geomspace(0.01, 10, 6)
    prior = models.GaussianPrior(np.zeros(6), np.diag(scale**2), (6,))
    likelihood = models.LinearLikelihood(models.Identity((6,)), models.Gaussian(5.0))
    post = ps.Problem(likelihood, prior).condition(np.ones(6))
    sampler = samplers.BlackJAX(blackjax.nuts)
    values = run(post, sampler, chains=4, draws=500, warmup=500).values
    assert diagnostics.rhat(values).max() < 1.05
