"""Simulations in batches: the same whatever the batch and the executor, and if interrupted."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import distributed
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from faults import GaussianCase

from posterior import samplers
from posterior.diagnostics import campaign, executors, sbc
from posterior.diagnostics.campaign import Settings, simulate
from posterior.diagnostics.quantities import SquaredNorm
from posterior.diagnostics.ranks import randomised_ranks
from posterior.sampling import NonFiniteError

CASE = GaussianCase(size=6, rows=4)
ASKED = {
    "norm": lambda x, y: jnp.sum(x**2),
    "fit": lambda x, y: jnp.sum((CASE.matrix @ x - y) ** 2),
}


# Run by a process that is to be killed, or sees two devices; no function is its own.
SCRIPT = """
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import jax
from faults import GaussianCase
from posterior import samplers
from posterior.diagnostics import Settings, campaign, simulate
from posterior.diagnostics.quantities import SquaredNorm

def run(folder, executor, count):
    simulate(GaussianCase(size=6, rows=4).problem, samplers.ULA(0.01), jax.random.key(0), count,
             {"norm": SquaredNorm()}, Settings(1, 20, 20, 1), batch=5, folder=folder,
             executor=executor, progress=False)

if __name__ == "__main__":
    folder, count, processes = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "processes"
    if processes:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
            run(folder, executor, count)
    else:
        compiled = campaign._batch
        def on_two(*args):
            found = compiled(*args)
            assert all(len(a.devices()) == 2 for a in found)
            return found
        on_two.lower, campaign._batch = compiled.lower, on_two
        run(folder, None, count)
"""


def simulated(count, *, batch=4, key=0, sampler=None, asked=ASKED, **settings):
    sampler = CASE.drawer(count=5) if sampler is None else sampler
    key = jax.random.key(key)
    return simulate(
        CASE.problem, sampler, key, count, asked, batch=batch, progress=False, **settings
    )


def test_truths_and_draws_are_those_of_the_simulation_with_that_number():
    found = simulated(6)
    assert found.names == ("norm", "fit")
    assert found.truths.shape == (6, 2) and found.draws.shape == (6, 1, 5, 2)
    key_joint, key_run = jax.random.split(jax.random.fold_in(jax.random.key(0), 5))
    x, y = CASE.problem.simulate(key_joint)
    np.testing.assert_allclose(found.truths[5], [f(x, y) for f in ASKED.values()], rtol=1e-4)
    draws = CASE.drawer(count=5)(key_run, CASE.problem.condition(y))[0]
    expected = [[f(x, y) for f in ASKED.values()] for x in draws]
    np.testing.assert_allclose(found.draws[5, 0], expected, rtol=1e-4)


def test_neither_batch_nor_number_change_a_simulation():
    few, many = simulated(3, batch=2), simulated(9, batch=4)
    np.testing.assert_allclose(few.truths, many.truths[:3], rtol=1e-4)
    np.testing.assert_allclose(few.draws, many.draws[:3], rtol=1e-4)


@pytest.fixture
def ran(monkeypatch):
    """The batches that this process computes, as they begin."""
    found, compiled = [], campaign._batch

    def counting(*args):
        found.append(1)
        return compiled(*args)

    counting.lower = compiled.lower
    monkeypatch.setattr(campaign, "_batch", counting)
    return found


def assert_equal(found, expected):
    assert found.names == expected.names
    np.testing.assert_array_equal(found.truths, expected.truths)
    np.testing.assert_array_equal(found.draws, expected.draws)


def of_script(count, **settings):
    """What `SCRIPT` computes, by this process."""
    settings = {"settings": Settings(1, 20, 20, 1), **settings}
    asked, sampler = {"norm": SquaredNorm()}, samplers.ULA(0.01)
    return simulated(count, batch=5, sampler=sampler, asked=asked, **settings)


def started(tmp_path, *arguments, **environment):
    """`SCRIPT`, in a group of processes of its own."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    paths = os.pathsep.join(str(Path(__file__).parents[n]) for n in (1, 2))
    environment = {**os.environ, "PYTHONPATH": paths, **environment}
    command = [sys.executable, str(script), *map(str, arguments)]
    return subprocess.Popen(command, env=environment, start_new_session=True)


def test_an_interrupted_campaign_goes_on_and_repeats_nothing(tmp_path, monkeypatch, ran):
    whole = simulated(10)
    ran.clear()

    def dying(self, number, shard, put=campaign.Shards.put):
        put(self, number, shard)
        if number == 1:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(campaign.Shards, "put", dying)
        with pytest.raises(KeyboardInterrupt):
            simulated(10, folder=tmp_path / "c")
    assert len(ran) == 2
    assert_equal(simulated(10, folder=tmp_path / "c"), whole)
    assert len(ran) == 3
    # A finished one is read, and may grow.
    assert len(simulated(7, folder=tmp_path / "c").truths) == 7 and len(ran) == 3
    assert len(simulated(13, folder=tmp_path / "c").truths) == 13 and len(ran) == 4


def test_a_campaign_out_of_time_says_how_much_it_needs_and_goes_on(tmp_path, ran):
    kept = {"folder": tmp_path / "c"}
    with pytest.raises(campaign.OutOfTime, match=r"4 of 10 simulations took .* s for all"):
        simulated(10, limit=1e-6, **kept)
    # What the folder holds took its time too.
    with pytest.raises(campaign.OutOfTime, match="4 of 10 "):
        simulated(10, limit=1e-6, **kept)
    assert len(ran) == 1
    assert_equal(simulated(10, limit=600.0, **kept), simulated(10))
    # Of the last batch two are asked for.
    assert campaign._done({0: {}, 2: {}}, 10, 4) == 6
    ended = simulated(10, limit=1e-6, **kept)
    assert len(ended.truths) == 10
    with pytest.raises(ValueError, match="limit 0: give seconds above 0"):
        simulated(10, limit=0)


def test_a_batch_of_large_objects_is_smaller(monkeypatch, ran):
    simulated(9, batch=None)
    assert len(ran) == 1
    monkeypatch.setattr(campaign, "_BATCH_SIZE", 4 * 6)
    simulated(9, batch=None)
    assert len(ran) == 1 + 3


@pytest.mark.slow
def test_processes_killed_at_work_lose_and_repeat_no_simulation(tmp_path, ran):
    folder = tmp_path / "c"
    process = started(tmp_path, folder, 100_000, "processes")
    try:
        deadline = time.monotonic() + 300
        while len(list(folder.glob("shard-*.npz"))) < 3:
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    kept = {int(path.stem[6:]) for path in folder.glob("shard-*.npz")}
    batches = max(kept) + 3
    resumed = of_script(5 * batches, folder=folder)
    assert len(ran) == batches - len(kept)
    assert_equal(resumed, of_script(5 * batches))


def test_threads_compute_the_same_in_any_order(tmp_path, monkeypatch, ran, x64):
    """In the precision of the caller, which threads do not inherit."""
    whole = simulated(18)
    assert whole.draws.dtype == np.float64
    ran.clear()
    compute = campaign._Campaign.__call__

    def uneven(self, number):
        time.sleep(0.05 * (number % 2 == 0))
        return compute(self, number)

    monkeypatch.setattr(campaign._Campaign, "__call__", uneven)
    with ThreadPoolExecutor(2) as executor:
        assert_equal(simulated(18, executor=executor, folder=tmp_path / "c"), whole)
    assert len(ran) == 5
    assert_equal(simulated(18, folder=tmp_path / "c"), whole)
    assert len(ran) == 5


@pytest.mark.slow
def test_a_cluster_computes_the_same_in_the_precision_of_the_caller(x64):
    """Of functions that no module holds."""
    factor = 0.5
    asked = {"scaled": lambda x, y: factor * x[0]}
    arguments = GaussianCase(size=6, rows=4).problem, CASE.drawer(count=5), jax.random.key(0), 10
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        executor = client.get_executor()
        found = simulate(*arguments, asked, batch=4, executor=executor, progress=False)
    assert_equal(found, simulate(*arguments, asked, batch=4, progress=False))
    assert found.draws.dtype == np.float64


@pytest.mark.slow
def test_a_batch_is_split_over_devices(tmp_path):
    """Five simulations on two devices: the same folder, the same numbers."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
    assert started(tmp_path, tmp_path / "c", 10, "here", XLA_FLAGS=flags).wait(300) == 0
    split, whole = of_script(10, folder=tmp_path / "c"), of_script(10)
    np.testing.assert_allclose(split.truths, whole.truths, rtol=1e-4)
    np.testing.assert_allclose(split.draws, whole.draws, rtol=1e-3, atol=1e-4)


def test_functions_that_cannot_be_sent_are_named(monkeypatch):
    """Before any process starts."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        monkeypatch.setattr(executors, "dumps", executors.pickle.dumps)
        sampler = samplers.ULA(0.01)
        with pytest.raises(ValueError, match="quantity norm cannot be sent .* install cloudpickle"):
            simulated(4, sampler=sampler, executor=executor)
        with pytest.raises(ValueError, match="the sampler cannot be sent"):
            simulated(4, executor=executor)
        assert not executor._processes


def test_processes_made_by_fork_are_refused():
    with (
        ProcessPoolExecutor(1, mp_context=get_context("fork")) as executor,
        pytest.raises(ValueError, match="JAX may hang: give .*spawn"),
    ):
        simulated(4, executor=executor)


def test_a_worker_that_would_run_another_program_refuses(monkeypatch):
    work = campaign._Campaign(
        CASE.problem, samplers.ULA(0.01), jax.random.key(0), ASKED, Settings(), 4
    )
    _, content = executors._task(work, executor=None)
    monkeypatch.setattr(campaign._Campaign, "identity", lambda self: "of other versions")
    with pytest.raises(ValueError, match="another program than this process: give it the same"):
        executors._run_sent(content, 0)


def test_an_error_in_a_batch_cancels_those_that_wait(ran):
    def diverging(key, posterior):
        return jnp.full((1, 5, 6), jnp.nan)

    with (
        ThreadPoolExecutor(1) as executor,
        pytest.raises(NonFiniteError, match="norm of a draw is NaN"),
    ):
        simulated(4 * 2000, sampler=diverging, executor=executor)
    assert len(ran) < 100


def test_calibration_goes_to_an_executor_too(ran):
    with ThreadPoolExecutor(1) as executor:
        found = sbc(
            CASE.problem, CASE.drawer(count=5), jax.random.key(0), 20, quantities=ASKED, batch=10,
            executor=executor, progress=False,
        )  # fmt: skip
    assert len(found.ranks) == 20 and len(ran) == 2


def test_the_folder_of_another_campaign_is_refused(tmp_path):
    """Another key, number of draws, function of the same name, or quantity of the same name."""
    simulated(4, folder=tmp_path / "c")
    with pytest.raises(ValueError, match="another campaign"):
        simulated(4, sampler=CASE.drawer(temperature=0.2, count=5), folder=tmp_path / "c")
    other = {"norm": lambda x, y: jnp.sum(2.5 * x**2), "fit": ASKED["fit"]}
    with pytest.raises(ValueError, match="another campaign"):
        simulated(4, asked=other, folder=tmp_path / "c")
    with pytest.raises(ValueError, match="another campaign"):
        simulated(4, key=1, folder=tmp_path / "c")
    with pytest.raises(ValueError, match="another campaign"):
        simulated(4, batch=2, folder=tmp_path / "c")


def test_two_campaigns_at_once_in_one_folder(tmp_path):
    """Of the same they do no harm; another is refused, though the folder was empty at its start."""
    whole = simulated(16)
    with ThreadPoolExecutor(2) as both:
        futures = [both.submit(simulated, 16, folder=tmp_path / "c") for _ in range(2)]
        for future in futures:
            assert_equal(future.result(), whole)
    assert_equal(simulated(16, folder=tmp_path / "c"), whole)

    early = campaign.Shards(tmp_path / "d", "another")
    late = campaign.Shards(tmp_path / "d", "late")
    early.put(0, {"truths": np.zeros(1)})
    with pytest.raises(ValueError, match="is of another campaign"):
        late.put(0, {"truths": np.ones(1)})
    assert early.found(1)[0]["truths"] == 0


def test_a_damaged_shard_is_named_and_computed_anew_once_deleted(tmp_path, ran):
    whole = simulated(8, folder=tmp_path / "c")
    path = tmp_path / "c" / "shard-000001.npz"
    contents = path.read_bytes()
    place = contents.find(whole.draws[4].tobytes()[:16])
    changed = contents[:place] + bytes([contents[place] ^ 1]) + contents[place + 1 :]
    for damaged in (contents[:-100], b"", changed):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="shard-000001.npz is damaged: delete it"):
            simulated(8, folder=tmp_path / "c")
    path.unlink()
    ran.clear()
    assert_equal(simulated(8, folder=tmp_path / "c"), whole)
    assert len(ran) == 1


def test_a_folder_of_other_things_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="holds notes.txt, which is no campaign's: give a new"):
        simulated(4, folder=tmp_path)
    with pytest.raises(ValueError, match="notes.txt is a file: give the path of a folder"):
        simulated(4, folder=tmp_path / "notes.txt")


def test_the_time_left_is_known_however_long_a_batch_takes():
    bar, now = campaign._bar(show=False), [0.0]
    bar.get_time = lambda: now[0]
    task = bar.add_task("simulations", total=100, completed=60)
    for _ in range(3):
        now[0] += 500.0
        bar.advance(task, 10)
    assert bar.tasks[0].time_remaining == pytest.approx(500, abs=1)


def test_a_draw_that_the_prior_excludes_ranks_last():
    def asked(x, y):
        return jnp.where(x[0] > 0, -jnp.inf, x[0])

    found = simulate(
        CASE.problem, CASE.drawer(count=5), jax.random.key(0), 4, {"f": asked}, progress=False
    )
    truths = found.truths[np.arange(4), 0]
    u = randomised_ranks(truths, found.draws[:, 0, :, 0], np.random.default_rng(0))
    excluded = found.draws[:, 0, :, 0] < -1e30
    below = (excluded | (found.draws[:, 0, :, 0] < truths[:, None])).sum(axis=1)
    assert excluded.any() and np.all(u[truths > -1e30] >= (below / 6)[truths > -1e30])


def test_a_run_that_diverges_is_named():
    def diverging(key, posterior):
        return jnp.full((1, 5, 6), jnp.nan)

    with pytest.raises(NonFiniteError, match="simulation 0: norm of a draw is NaN"):
        simulated(4, sampler=diverging)


def test_a_pixel_that_is_not_finite_counts_though_no_quantity_reads_it():
    asked = {"first": lambda x, y: x[0]}

    def sampler(key, posterior):
        return jnp.zeros((1, 5, 6)).at[0, 2, -1].set(jnp.nan)

    with pytest.raises(NonFiniteError, match="simulation 0: first .* the draw is not finite"):
        simulated(4, sampler=sampler, asked=asked)


def test_simulations_that_were_not_asked_for_decide_nothing():
    """Of a batch of four the fourth diverges: three are three, and four are refused."""
    fourth = jax.random.split(jax.random.fold_in(jax.random.key(0), 3))[1]

    def once(key, posterior):
        lost = jnp.all(jax.random.key_data(key) == jax.random.key_data(fourth))
        return jnp.where(lost, jnp.nan, CASE.drawer(count=5)(key, posterior))

    assert len(simulated(3, sampler=once).truths) == 3
    with pytest.raises(NonFiniteError, match="simulation 3"):
        simulated(4, sampler=once)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"asked": {"vector": lambda x, y: x}}, "vector is no real number"),
        ({"asked": {"field": lambda x, y: 1j * x[0]}}, "field is no real number"),
        ({"asked": {"odd": lambda x, y: jnp.log(-jnp.sum(x**2))}}, "of the object itself is NaN"),
        ({"asked": {}}, "no quantities"),
        ({"sampler": lambda key, p: jnp.zeros((5, 6))}, r"draws of shape \(5, 6\): give"),
        ({"sampler": lambda key, p: (jnp.zeros((1, 5, 6)),)}, "gives a tuple: give a JAX array"),
        ({"sampler": lambda key, p: np.zeros((1, 5, 6))}, "gives a ndarray: .* jax.numpy"),
        (
            {
                "sampler": lambda key, p: jnp.zeros((1, 5, 6), complex),
                "asked": {"first": lambda x, y: x[0].real},
            },
            "gives draws of complex64, the object is float32",
        ),
        ({"sampler": lambda key, p: jnp.zeros((1, 5, 6), int)}, "gives draws of int32"),
        ({"sampler": "mala"}, "sampler 'mala' is a str: give one of posterior.samplers"),
        ({"sampler": samplers.MALA}, r"sampler is the class MALA: give MALA\(...\)"),
        ({"settings": Settings(thin=0)}, "thin 0: give a whole number, 1 or more"),
        ({"settings": Settings(draws=20.5)}, "draws 20.5: give a whole number"),
        ({"settings": Settings(warmup=-5)}, "warmup -5: give a whole number, 0 or more"),
    ],
)
def test_what_cannot_be_ranked_is_refused_at_once(change, message):
    with pytest.raises(ValueError, match=message):
        simulated(4, **change)


@pytest.mark.parametrize("settings", [{"count": 0}, {"count": 2.5}, {"count": 4, "batch": 0}])
def test_bad_numbers_are_refused(settings):
    with pytest.raises(ValueError, match="give a whole number, 1 or more"):
        simulated(**settings)
