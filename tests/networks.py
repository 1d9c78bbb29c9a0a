"""Networks for tests: fresh, enlarged, or trained on pictures whose distribution is known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from posterior import train as training
from posterior.models import priors
from posterior.models.priors import EnergyPrior, ScorePrior
from posterior.models.priors.denoiser import Denoiser, Statistics
from posterior.models.priors.storage import build_network
from posterior.models.priors.training import Recipe
from posterior.models.priors.unet import UNet

NETWORK = {"type": "unet", "channels": 1, "widths": [8], "blocks": 1, "fine": 8}


def fresh(statistics, network=NETWORK):
    return Denoiser(build_network(network, jax.random.key(0)), statistics)


def network_denoiser(dtype="float64", perturbation="gaussian"):
    network = UNet(1, jax.random.key(4), (8, 8), fine=4)
    # A fresh network says almost nothing: enlarge its last layer, to have something to measure.
    network = eqx.tree_at(lambda n: n.fine_out.kernel, network, replace_fn=lambda k: 30 * k)
    network = jax.tree.map(lambda a: a.astype(dtype), network)
    floor = 0.01 if perturbation == "signal" else 0.0
    statistics = Statistics(0.3, 0.25, 0.01, 10.0, perturbation, lowest=floor)
    return Denoiser(network, statistics)


def pixels_of(prior, count=256, size=8):
    keys = jax.random.split(jax.random.key(0), count)
    return list(np.asarray(jax.vmap(prior.sample)(keys), "f4").reshape(-1, size, size, 1))


def two_levels(size=8):
    """Pictures that are all dark or all bright, with a little texture: far from Gaussian."""
    n = size * size
    return priors.GaussianMixture(
        [0.5, 0.5],
        [np.full(n, 0.2), np.full(n, 0.8)],
        np.broadcast_to(0.05**2 * np.eye(n), (2, n, n)),
        (size, size),
    )


def relative_error(prior, exact, sigma, count=64):
    """Of the score, root mean square over noisy draws, in units of the exact score's."""
    keys = jax.random.split(jax.random.key(9), (2, count))
    x = jax.vmap(exact.sample)(keys[0])
    noise = jax.vmap(lambda k: jax.random.normal(k, exact.shape))(keys[1])
    x = (x + sigma * noise).astype("f4")
    found, true = (jax.jit(jax.vmap(lambda x, p=p: p.score(x, sigma)))(x) for p in (prior, exact))
    return float(jnp.sqrt(jnp.mean((found - true) ** 2) / jnp.mean(true**2)))


def trained_on(exact, steps, widths, kind="score", batch=16):
    pictures = pixels_of(exact)
    flat = np.stack(pictures)
    statistics = Statistics(float(flat.mean()), float(flat.std()), 0.005, 8.0)
    recipe = Recipe(kind, steps=steps, batch=batch, size=8, rate=3e-3)
    denoiser = fresh(statistics, NETWORK | {"widths": widths})
    found, losses, _ = training.train(denoiser, pictures, recipe)
    prior = ScorePrior if kind == "score" else EnergyPrior
    return prior(denoiser, exact.shape), prior(found, exact.shape), losses
