"""The posterior of an energy network: MALA leaves it as it is, emcee agrees. A study."""

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import posterior as ps
from known import batch_error
from networks import trained_on
from posterior import models, samplers
from posterior.models import priors

pytestmark = pytest.mark.slow


def two_textures(size=8):
    """Pictures about one of two means that chains can cross between: 2.4 sd apart."""
    n = size * size
    half = np.repeat([0.03, -0.03], n // 2)
    covariance = np.broadcast_to(0.2**2 * np.eye(n), (2, n, n))
    return priors.GaussianMixture([0.5, 0.5], [0.5 + half, 0.5 - half], covariance, (size, size))


def denoising(prior, y, camera):
    likelihood = models.LinearLikelihood(models.Identity(prior.shape), camera)
    return ps.Problem(likelihood, prior).condition(y)


@pytest.fixture(scope="module")
def energy():
    return trained_on(two_textures(), steps=600, widths=[8], kind="energy")[1]


CHAINS, ROUNDS, MOVES = 400, 40, 5
NOISE, STEP = 0.2, 0.012


def functionals(x, y):
    """Of objects (n, 8, 8): mean, energy, roughness, and the contrast that parts the means.

    And how far their recordings `y` are from them.
    """
    contrast = x[:, :4].mean((1, 2)) - x[:, 4:].mean((1, 2))
    return {
        "mean": x.mean((1, 2)),
        "squares": (x**2).mean((1, 2)),
        "roughness": (np.diff(x, axis=1) ** 2).mean((1, 2)),
        "contrast": contrast,
        "residual": ((y - x) ** 2).mean((1, 2)),
    }


def draws_of(prior, key):
    """Independent draws of a prior with a density: NUTS, beside a recording that says nothing."""
    post = denoising(prior, np.full(prior.shape, 0.5), models.Gaussian(100.0))
    settings = {"chains": CHAINS, "draws": 1, "thin": 100, "warmup": 300, "progress": False}
    return ps.sample(post, samplers.BlackJAX(blackjax.nuts), key, **settings).values[:, 0]


def successive(prior, start, key, sampler, noise=NOISE):
    """Recording given object, moves of the object given the recording, in turns (Geweke 2004).

    The objects and recordings that it ends with.

    `noise`: of the recordings; the moves believe `NOISE`.
    """
    likelihood, simulated = (
        models.LinearLikelihood(models.Identity(prior.shape), models.Gaussian(sd))
        for sd in (NOISE, noise)
    )

    def one_chain(x, key):
        def a_round(x, key):
            key_data, *keys = jax.random.split(key, MOVES + 1)
            post = ps.Posterior(likelihood, prior, simulated.simulate(key_data, x))
            state = sampler.init(key, post, x)
            for k in keys:
                state, _ = sampler.step(k, state)
            return sampler.position(state), post.y

        x, recordings = jax.lax.scan(a_round, x, jax.random.split(key, ROUNDS))
        return x, recordings[-1]

    keys = jax.random.split(key, CHAINS)
    return jax.tree.map(np.asarray, jax.jit(jax.vmap(one_chain))(jnp.asarray(start), keys))


def smallest_p(one, other):
    """Of Kolmogorov and Smirnov's test of each functional, corrected for their number."""
    one, other = functionals(*one), functionals(*other)
    p = {name: scipy.stats.ks_2samp(one[name], other[name]).pvalue for name in one}
    print({name: f"{value:.2g}" for name, value in p.items()})
    return min(1.0, len(p) * min(p.values()))


def test_mala_leaves_the_posterior_of_an_energy_as_it_is(energy):
    """Objects and recordings drawn in turns keep the prior, whose own draws are by NUTS.

    They do not without a Metropolis test, nor where recordings are 10 % noisier than believed.
    """
    keys = jax.random.split(jax.random.key(3), 5)
    mala, unadjusted = samplers.MALA(STEP, "none"), samplers.ULA(STEP)
    start = draws_of(energy, keys[0])
    rng, others = np.random.default_rng(0), draws_of(energy, keys[1])
    first, others = ((x, x + NOISE * rng.standard_normal(x.shape)) for x in (start, others))
    print()
    assert smallest_p(first, others) > 0.01
    kept = successive(energy, start, keys[2], mala)
    # A chain that stays where it began keeps its distribution too.
    assert np.corrcoef(start.ravel(), kept[0].ravel())[0, 1] < 0.3
    assert smallest_p(kept, others) > 0.01
    assert smallest_p(successive(energy, start, keys[3], unadjusted), others) < 1e-6
    noisier = successive(energy, start, keys[4], mala, noise=1.1 * NOISE)
    assert smallest_p(noisier, others) < 1e-3


def test_emcee_mala_smc_and_annealed_langevin_agree_on_a_small_patch(energy):
    """The same network on 2x2 pixels: means and variances, in posterior sd.

    MALA, emcee and SMC to four times their Monte-Carlo error; annealed Langevin, an approximation
    whose prior at its finest level is blurred as that of the others is, to 0.1 beside it.
    """
    # The network's own draws, by one step here, are far from its density: none may lean on them.
    prior = priors.EnergyPrior(energy.denoiser, (2, 2), sampling_steps=2)
    y = np.array([[0.3, 0.5], [0.6, 0.7]])
    post = denoising(prior, y, models.Gaussian(0.15))
    runs = {
        "emcee": (samplers.Ensemble(walkers=32), {"draws": 32 * 2000, "chains": 4}),
        "mala": (samplers.MALA(), {"draws": 5000, "thin": 5, "chains": 4}),
        "smc": (samplers.TemperedSMC(), {"draws": 500, "chains": 32}),
        "annealed": (samplers.AnnealedLangevin(), {"draws": 50, "chains": 64}),
    }
    found = {}
    for i, (name, (sampler, settings)) in enumerate(runs.items()):
        values = ps.sample(post, sampler, jax.random.key(i), progress=False, **settings).values
        found[name] = moments(values.reshape(*values.shape[:2], -1))
    mean, variance = found["emcee"][0]
    print()
    for name, ((m, v), (em, ev)) in found.items():
        off, ratio = (m - mean) / np.sqrt(variance), v / variance
        print(
            f"{name}: mean off by {np.round(off, 3)} sd, variance over emcee's {np.round(ratio, 3)}"
        )
        slack = 0.1 if name == "annealed" else 0.0
        error = np.hypot(em, found["emcee"][1][0]) / np.sqrt(variance)
        assert np.all(np.abs(off) < 4 * error + slack)
        error = np.hypot(ev, found["emcee"][1][1]) / variance
        assert np.all(np.abs(ratio - 1) < 4 * error + slack)


def moments(values):
    """Mean and variance of draws (chains, draws, n), and the Monte-Carlo error of each."""
    mean = values.mean((0, 1))
    squares = (values - mean) ** 2
    return (mean, squares.mean((0, 1))), (batch_error(values), batch_error(squares))
