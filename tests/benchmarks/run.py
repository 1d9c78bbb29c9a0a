"""Benchmarks: ratios measured in one process. Run by `make bench`; no test depends on them.

Peak memory is that of the whole process, so each memory case runs in a process of its own.
"""

import json
import resource
import subprocess
import sys
import time

import blackjax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import posterior as ps
from posterior import diagnostics, models, samplers


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


def annealed_step_against_score():
    shape = (64, 64)
    power = 1e-3 / (0.05 + np.hypot(*np.meshgrid(*[np.fft.fftfreq(64)] * 2))) ** 2
    prior = models.GaussianField(power, 0.5, dtype=complex)
    likelihood = models.IntensityLikelihood(models.Fourier(shape, 2), models.Poisson(10_000))
    problem = ps.Problem(likelihood, prior)
    post = problem.condition(jnp.minimum(problem.simulate(jax.random.key(0))[1], 1.0))
    sampler = samplers.AnnealedLangevin(levels=50, steps=2)
    keys = jax.random.split(jax.random.key(1), 16)
    from posterior.samplers.base import vmap_init, vmap_step

    states = eqx.filter_jit(vmap_init)(sampler, keys, post, None)

    @eqx.filter_jit
    def run_steps(states, keys):
        def body(states, i):
            step_keys = jax.vmap(lambda k: jax.random.fold_in(k, i))(keys)
            return vmap_step(sampler, step_keys, states)[0], None

        return jax.lax.scan(body, states, jnp.arange(50))[0].position

    @eqx.filter_jit
    def run_scores(x, post):
        def body(x, i):
            score = jax.vmap(lambda x: post.annealed_score(x, 0.1))(x)
            return x + 1e-9 * score, None

        return jax.lax.scan(body, x, jnp.arange(50))[0]

    step = best_of(3, lambda: run_steps(states, keys))
    score = best_of(3, lambda: run_scores(states.position, post))
    print(f"annealed Langevin step, 16 chains of 64x64: {step / score:.2f} of a bare score")


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
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"seconds": seconds, "peak": peak}))


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


if __name__ == "__main__":
    if len(sys.argv) == 3:
        memory_case(int(sys.argv[1]), bool(int(sys.argv[2])))
    else:
        mala_against_blackjax()
        annealed_step_against_score()
        memory()
