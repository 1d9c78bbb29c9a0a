"""Benchmarks: ratios measured in one process. Run by `make bench`; no test depends on them.

Peak memory is that of the whole process, so each memory case runs in a process of its own; that of
maps of convergence alone is `python tests/benchmarks/run.py convergence`.
"""

import json
import resource
import subprocess
import sys
import time
from functools import partial

import blackjax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from arviz_stats.base import array_stats

import posterior as ps
from posterior import diagnostics, models, samplers
from posterior.models.gallery import linear_gaussian


def best_of(repeats, function):
    """Least wall time of a call, after one that compiles."""
    jax.block_until_ready(function())
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - began)
    return min(times)


def anisotropic():
    """Scales from 0.1 to 3: what a diagonal metric is for."""
    scales = np.geomspace(0.1, 3, 32)
    prior = models.GaussianPrior(np.zeros(32), np.diag(scales**2), (32,))
    likelihood = models.LinearLikelihood(models.Identity((32,)), models.Gaussian(3.0))
    return ps.Problem(likelihood, prior)


def counts():
    """A row of 64 pixels under photon noise, with a smooth prior."""
    power = 0.02 / (0.05 + np.abs(np.fft.fftfreq(64))) ** 2
    prior = models.GaussianField(power / power.mean() * 0.01, 0.5)
    likelihood = models.LinearLikelihood(models.Identity((64,)), models.Poisson(400))
    return ps.Problem(likelihood, prior)


def effective_draws_per_second(post, sampler, key):
    """Least bulk ESS of a pixel per second of drawing, warm-up and compilation left out."""
    settings = {"chains": 4, "warmup": 2000, "progress": False}
    ps.sample(post, sampler, key, draws=10, **settings)
    began = time.perf_counter()
    ps.sample(post, sampler, key, draws=10, **settings)
    overhead = time.perf_counter() - began
    began = time.perf_counter()
    values = ps.sample(post, sampler, key, draws=20_000, **settings).values
    return diagnostics.ess(values).min() / (time.perf_counter() - began - overhead)


def mala_against_blackjax():
    for name, problem in {"anisotropic Gaussian": anisotropic(), "photon counts": counts()}.items():
        _, y = problem.simulate(jax.random.key(0))
        post = problem.condition(y)
        ours = samplers.MALA(preconditioner="diagonal")
        # BlackJAX's MALA has no warm-up: it is given the best of a range of step sizes.
        steps = np.geomspace(1e-4, 1e-1, 7)
        theirs = [samplers.BlackJAX(blackjax.mala, step_size=float(h)) for h in steps]
        key = jax.random.key(1)
        best = max(effective_draws_per_second(post, s, key) for s in theirs)
        mine = effective_draws_per_second(post, ours, key)
        print(f"MALA on {name}: {mine:.0f} ESS/s, BlackJAX's {best:.0f}, ratio {mine / best:.2f}")


def annealed_steps():
    """A step of 16 chains of 64x64 over what it cannot do without: the score, or the network."""
    shape = (64, 64)
    power = 1e-3 / (0.05 + np.hypot(*np.meshgrid(*[np.fft.fftfreq(64)] * 2))) ** 2
    field = models.GaussianField(power, 0.5, dtype=complex)
    far = models.IntensityLikelihood(models.Fourier(shape, 2), models.Poisson(10_000))
    sampler = samplers.AnnealedLangevin(levels=50, steps=2)
    post, step, states = timed_steps(ps.Problem(far, field), sampler, 50)
    score = timed_rounds(lambda x: post.annealed_score(x, 0.1), states.position, 50)
    print(f"annealed Langevin step, 16 chains of 64x64: {step / score:.2f} of a bare score")

    nuclei = models.ScorePrior.load("nuclei", shape)
    counts = models.LinearLikelihood(models.Identity(shape), models.Poisson(100))
    post, step, states = timed_steps(ps.Problem(counts, nuclei), sampler, 20)
    network = timed_rounds(lambda x: post.prior.denoise(x, 0.1), states.position, 20)
    print(f"the same under `nuclei`: {step / network:.2f} of the bare network")


def timed_steps(problem, sampler, rounds):
    """The posterior of a recording, the seconds of so many steps of 16 chains, their states."""
    from posterior.samplers.base import vmap_init, vmap_step

    post = problem.condition(jnp.clip(problem.simulate(jax.random.key(0))[1], 0.0, 1.0))
    keys = jax.random.split(jax.random.key(1), 16)
    states = eqx.filter_jit(vmap_init)(sampler, keys, post, None)

    @eqx.filter_jit
    def run(states, keys):
        def body(states, i):
            step_keys = jax.vmap(lambda k: jax.random.fold_in(k, i))(keys)
            return vmap_step(sampler, step_keys, states)[0], None

        return jax.lax.scan(body, states, jnp.arange(rounds))[0].position

    return post, best_of(3, lambda: run(states, keys)), states


def timed_rounds(function, x, rounds):
    """Seconds of so many evaluations of a function of 16 objects, one after the other."""

    @jax.jit
    def run(x):
        def body(x, i):
            return x + 1e-9 * jax.vmap(function)(x), None

        return jax.lax.scan(body, x, jnp.arange(rounds))[0]

    return best_of(3, lambda: run(x))


def memory_case(draws, keep):
    """One process: seconds and peak memory of `draws` draws at 256x256."""
    shape = (256, 256)
    power = 1e-3 / (0.05 + np.hypot(*np.meshgrid(*[np.fft.fftfreq(256)] * 2))) ** 2
    prior = models.GaussianField(power, 0.5)
    likelihood = models.LinearLikelihood(models.Identity(shape), models.Gaussian(0.1))
    problem = ps.Problem(likelihood, prior)
    post = problem.condition(problem.simulate(jax.random.key(0))[1])
    began = time.perf_counter()
    ps.sample(
        post,
        samplers.MALA(),
        jax.random.key(1),
        chains=2,
        draws=draws,
        warmup=20,
        keep=keep,
        progress=False,
    )
    seconds = time.perf_counter() - began
    print(json.dumps({"seconds": seconds, "peak": peak_memory()}))


def peak_memory():
    """Of this process so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def memory():
    for keep in (False, True):
        found = {}
        for draws in (10, 1000):
            command = [sys.executable, __file__, str(draws), str(int(keep))]
            output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            found[draws] = json.loads(output.splitlines()[-1])
        few, many = found[10], found[1000]
        word = "kept" if keep else "not kept"
        print(
            f"256x256, 2 chains, draws {word}: 10 take {few['seconds']:.1f} s and "
            f"{few['peak']:.0f} MiB, 1000 take {many['seconds']:.1f} s and {many['peak']:.0f} MiB"
        )


def calibration_against_a_loop(size=64, rows=48, loop=10):
    """SBC of 1000 simulations x 100 draws, beside a Python loop over BlackJAX's NUTS.

    The loop does as packages for SBC do: each simulation has a log-density of its own data, and is
    compiled. Its time is that of a few simulations, taken a thousand times.
    """
    known = linear_gaussian(size, rows)
    problem = ps.Problem(known.likelihood, known.prior)
    run = {"draws": 100, "warmup": 500, "progress": False}
    began = time.perf_counter()
    found = diagnostics.sbc(problem, samplers.MALA(), jax.random.key(0), 1000, thin=30, **run)
    mine = time.perf_counter() - began
    print(f"SBC, 1000 simulations of {size} dimensions: {mine:.0f} s; {found.verdict()}")

    def by_blackjax(i):
        keys = jax.random.split(jax.random.fold_in(jax.random.key(0), i), 4)
        x, y = problem.simulate(keys[0])
        log_prob = problem.condition(y).log_prob
        warmup = blackjax.window_adaptation(blackjax.nuts, log_prob)
        (state, tuned), _ = warmup.run(keys[1], jnp.zeros(size), run["warmup"])
        kernel = blackjax.nuts(log_prob, **tuned)

        @jax.jit
        def draw(state, key):
            def move(state, key):
                state, _ = kernel.step(key, state)
                return state, state.position

            return jax.lax.scan(move, state, jax.random.split(key, run["draws"]))[1]

        return (draw(state, keys[2]) < x).sum(axis=0)

    began = time.perf_counter()
    jax.block_until_ready([by_blackjax(i) for i in range(loop)])
    theirs = (time.perf_counter() - began) / loop * 1000
    print(f"  a loop over BlackJAX: {theirs:.0f} s, ratio {theirs / mine:.0f}")


def pixel_by_pixel(statistic, x, **settings):
    """An array function of arviz-stats, called once a pixel."""
    axes = {"chain_axis": 0, "draw_axis": 1}
    return [statistic(x[..., i], **axes, **settings) for i in range(x.shape[2])]


# Of each map of `diagnostics`, the same of arviz-stats.
MAPS = {
    "bulk ESS": (diagnostics.ess, partial(pixel_by_pixel, array_stats.ess, method="bulk")),
    "tail ESS": (
        partial(diagnostics.ess, method="tail"),
        partial(pixel_by_pixel, array_stats.ess, method="tail", prob=(0.05, 0.95)),
    ),
    "MCSE of the mean": (
        diagnostics.mcse,
        partial(pixel_by_pixel, array_stats.mcse, method="mean"),
    ),
    "MCSE of the sd": (
        partial(diagnostics.mcse, method="sd"),
        partial(pixel_by_pixel, array_stats.mcse, method="sd"),
    ),
    "R-hat": (diagnostics.rhat, partial(pixel_by_pixel, array_stats.rhat)),
    "nested R-hat": (
        partial(diagnostics.nested_rhat, superchains=2),
        partial(pixel_by_pixel, array_stats.rhat_nested, superchain_ids=[0, 0, 1, 1]),
    ),
}


def processor_time(repeats, function):
    """Least of a call, in seconds: what runs beside it does not count."""
    function()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return min(times)


def convergence_against_arviz(pixels=500):
    """Maps of every statistic of convergence, beside arviz-stats pixel by pixel."""
    rng = np.random.default_rng(0)
    for draws in (100, 1000):
        x = rng.standard_normal((4, draws, pixels), dtype=np.float32)
        for name, (mine, theirs) in MAPS.items():
            ours, one = (processor_time(3, partial(f, x)) for f in (mine, theirs))
            print(
                f"{name}, 4 x {draws} draws: {one / ours:.1f} times faster "
                f"({1e6 * ours / pixels:.0f} and {1e6 * one / pixels:.0f} us a pixel)"
            )


def convergence_of_a_picture(pixels=200):
    """Every map at 256x256, 4 chains of 1000 draws: the seconds of each, and peak memory.

    Of arviz-stats the seconds are those of a few pixels, taken as many times.
    """
    shape = (4, 1000, 256, 256)
    x = np.random.default_rng(0).standard_normal(shape, dtype=np.float32)
    before = peak_memory()
    for name, (mine, theirs) in MAPS.items():
        began = time.process_time()
        mine(x)
        ours = time.process_time() - began
        few = x.reshape(4, 1000, -1)[..., :: 256**2 // pixels]
        began = time.process_time()
        theirs(few)
        one = (time.process_time() - began) * 256**2 / few.shape[2]
        print(f"{name} of 256x256: {ours:.1f} s, by arviz-stats {one:.0f} s, {one / ours:.1f}")
    print(f"  peak memory {peak_memory():.0f} MiB, of it before the first map {before:.0f}")


if __name__ == "__main__":
    if sys.argv[1:] == ["convergence"]:
        convergence_against_arviz()
        convergence_of_a_picture()
    elif len(sys.argv) == 3:
        memory_case(int(sys.argv[1]), bool(int(sys.argv[2])))
    else:
        mala_against_blackjax()
        annealed_steps()
        calibration_against_a_loop()
        subprocess.run([sys.executable, __file__, "convergence"], check=True)
        memory()
