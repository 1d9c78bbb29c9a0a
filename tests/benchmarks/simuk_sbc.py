"""SBC beside simuk's with NumPyro, in one process; the loop over BlackJAX is in `run.py`.

Both see one model, run one chain in the precision that JAX has by default, and are timed with all
that they compile.
"""

import os
import sys
import time
from typing import NamedTuple

import blackjax
import jax
import jax.numpy as jnp
import numpy as np

import posterior as ps
from posterior import diagnostics, samplers
from posterior.models.gallery import linear_gaussian

try:
    import numpyro
    import simuk
    from numpyro.infer import MCMC, NUTS
    from numpyro.infer.mcmc import MCMCKernel
    from numpyro.infer.util import log_density
except ImportError as error:
    sys.exit(f"{error}: install what this compares with by `pip install simuk numpyro`")

SIZE, ROWS = 64, 48
DRAWS, WARMUP = 100, 500
SIMULATIONS = 1000
# Theirs are affordable in part; their time is taken up to SIMULATIONS.
AFFORDED, EXACT = 20, 100


class Cost(NamedTuple):
    """Of one simulation: seconds, those of all processors, and its effective draws."""

    seconds: float
    processor: float
    effective: np.ndarray

    def __str__(self):
        return (
            f"{self.seconds:.3g} s a simulation ({self.processor:.3g} s of processors); bulk ESS "
            f"of its {DRAWS} draws {np.median(self.effective):.0f}, of the slowest coordinate "
            f"{self.effective.min():.0f}"
        )


class Drawn(NamedTuple):
    """State of `Exact`."""

    x: jax.Array
    key: jax.Array


class Exact(MCMCKernel):
    """Independent draws of our closed form, as a kernel for simuk."""

    sample_field = "x"

    def __init__(self, model, known):
        self.model, self.known = model, known

    def init(self, rng_key, num_warmup, init_params, model_args, model_kwargs):
        return Drawn(jnp.zeros(SIZE), rng_key)

    def sample(self, state, model_args, model_kwargs):
        key, draw_key = jax.random.split(state.key)
        return Drawn(self.known.exact(draw_key, model_kwargs["y"], 1)[0], key)

    def postprocess_fn(self, model_args, model_kwargs):
        return lambda x: {"x": x}


class Kept(simuk.SBC):
    """simuk's, which keeps ranks alone, with the draws that they are of."""

    def _get_posterior_samples_numpyro(self, prior_predictive_draw):
        found = super()._get_posterior_samples_numpyro(prior_predictive_draw)
        self.draws = [*getattr(self, "draws", []), found["x"].values]
        return found


def in_numpyro(problem):
    """The model of `problem`, written a second time."""
    mean, root = problem.prior.mean, jnp.linalg.cholesky(problem.prior.covariance)
    matrix, noise = problem.likelihood.optics.matrix, problem.likelihood.camera.sigma

    def model(y=None):
        prior = numpyro.distributions.MultivariateNormal(mean, scale_tril=root)
        x = numpyro.sample("x", prior)
        recording = numpyro.distributions.Normal(matrix @ x, noise).to_event(1)
        numpyro.sample("y", recording, obs=y)

    return model


def by_simuk(kernel, simulations, warmup):
    """Ranks and draws of simuk's SBC, its seconds a simulation and those of all processors."""
    settings = {"num_warmup": warmup, "num_samples": DRAWS, "num_chains": 1}
    # Its names of what is observed come from a recording, whatever that holds.
    data = {"y": jnp.zeros(ROWS)}
    test = Kept(kernel, simulations, settings, seed=0, data_dir=data)
    began = time.perf_counter(), time.process_time()
    test.run_simulations()
    ended = time.perf_counter(), time.process_time()
    ranks = test.simulations["prior_sbc"]["x"].values.reshape(simulations, SIZE)
    return ranks, np.stack(test.draws), *(np.subtract(ended, began) / simulations)


def effective(draws):
    """Median bulk ESS of each coordinate, of draws (simulations, chains, draws, coordinates)."""
    return np.median(diagnostics.ess(np.moveaxis(draws, 0, 2)), axis=0)


def ours(problem, sampler, thin):
    """Cost and verdict of our SBC, asked for simuk's ranks and for our default quantities too."""
    pixels = {f"x[{i}]": lambda x, y, i=i: x[i] for i in range(SIZE)}
    quantities = pixels | diagnostics.default_quantities(problem)
    run, key = {"draws": DRAWS, "warmup": WARMUP, "thin": thin}, jax.random.key(0)
    began = time.perf_counter(), time.process_time()
    found = diagnostics.sbc(
        problem, sampler, key, SIMULATIONS, quantities=quantities, progress=False, **run
    )
    taken = np.subtract((time.perf_counter(), time.process_time()), began) / SIMULATIONS
    settings = diagnostics.Settings(**run)
    some = diagnostics.simulate(problem, sampler, key, 32, pixels, settings, progress=False)
    return Cost(*taken, effective(some.draws)), found.verdict()


def check_ranks(problem, known):
    """simuk's ranks of its truths among exact draws of our posterior: uniform for one model."""
    ranks, *_ = by_simuk(Exact(in_numpyro(problem), known), EXACT, 0)
    shares = (ranks + np.random.default_rng(0).random(ranks.shape)) / (DRAWS + 1)
    p = diagnostics.holm({i: diagnostics.uniformity(u) for i, u in enumerate(shares.T)})
    least = min(p.values())
    assert least > 0.001, f"simuk's ranks of an exact sampler are not uniform: p = {least:.2g}"
    print(f"simuk's ranks of exact draws, {EXACT} simulations: uniform, smallest p {least:.2g}")


def closed_form(problem, y):
    """Mean of the posterior."""
    prior, matrix = problem.prior, np.asarray(problem.likelihood.optics.matrix, float)
    mean, precision = np.asarray(prior.mean, float), np.linalg.inv(prior.covariance)
    weights = matrix.T / float(problem.likelihood.camera.sigma) ** 2
    return np.linalg.solve(precision + weights @ matrix, precision @ mean + weights @ np.asarray(y))


def check_densities(problem, points=10):
    """Log-densities of the two models, which are to agree up to rounding."""
    _, y = problem.simulate(jax.random.key(1))
    model, post = in_numpyro(problem), problem.condition(y)
    x = jax.vmap(problem.prior.sample)(jax.random.split(jax.random.key(2), points))
    theirs = np.stack([log_density(model, (), {"y": y}, {"x": v})[0] for v in x])
    np.testing.assert_allclose(theirs, jax.vmap(post.log_prob)(x), rtol=1e-5)


def check_means(problem, draws=4000):
    """Mean of one posterior by both NUTS, within Monte-Carlo error of the closed form."""
    _, y = problem.simulate(jax.random.key(1))
    run = {"num_warmup": WARMUP, "num_samples": draws, "progress_bar": False}
    theirs = MCMC(NUTS(in_numpyro(problem)), **run)
    theirs.run(jax.random.key(2), y=y)
    ours = ps.sample(
        problem.condition(y), samplers.BlackJAX(blackjax.nuts), jax.random.key(2),
        chains=1, draws=draws, warmup=WARMUP, progress=False,
    )  # fmt: skip
    for name, x in {"NumPyro": theirs.get_samples()["x"][None], "ours": ours.values}.items():
        x = np.asarray(x)
        z = np.abs((x.mean(axis=(0, 1)) - closed_form(problem, y)) / diagnostics.mcse(x)).max()
        # Of 128 normal numbers one is beyond 5 once in 14,000 runs.
        assert z < 5, f"NUTS of {name}: a mean {z:.1f} standard errors from the closed form"
        print(f"NUTS of {name}: means within {z:.1f} standard errors of the closed form")


def compare():
    known = linear_gaussian(SIZE, ROWS)
    problem = ps.Problem(known.likelihood, known.prior)
    check_densities(problem)
    check_means(problem)
    check_ranks(problem, known)
    _, draws, *taken = by_simuk(NUTS(in_numpyro(problem)), AFFORDED, WARMUP)
    theirs = Cost(*taken, effective(draws))
    print(
        f"simuk with NumPyro's NUTS, {AFFORDED} simulations: {theirs}; {SIMULATIONS} would take "
        f"{theirs.seconds * SIMULATIONS:.0f} s (scaled up, not run)"
    )
    cases = {"NUTS": (samplers.BlackJAX(blackjax.nuts), 1), "MALA, thin=30": (samplers.MALA(), 30)}
    for name, (sampler, thin) in cases.items():
        mine, verdict = ours(problem, sampler, thin)
        print(f"ours with {name}: {mine.seconds * SIMULATIONS:.0f} s, {mine}; {verdict}")
        # What else runs on the machine changes wall time more than that of processors.
        ratio, processor = theirs.seconds / mine.seconds, theirs.processor / mine.processor
        draw = processor * np.median(mine.effective) / np.median(theirs.effective)
        slowest = processor * mine.effective.min() / theirs.effective.min()
        print(
            f"  ratio to simuk for {SIMULATIONS} simulations: {ratio:.0f}; in seconds of "
            f"processors {processor:.0f}, for equal effective draws {draw:.0f}, of the slowest "
            f"coordinate {slowest:.0f}"
        )
    print(f"load of the machine {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    compare()
