"""Whether a denoiser knows the mean of a picture: what its errors of it share."""

import jax
import jax.numpy as jnp
import numpy as np

from ..models.priors.learned import LearnedPrior
from ..models.priors.perturbation import error_sd, perturbed

NOISES = 24


def knows_means(prior: LearnedPrior) -> bool:
    """Whether its network was trained to know E[x | z] of real pictures."""
    return not prior.complex_valued and prior.perturbation != "signal"


def shared_errors(
    prior: LearnedPrior,
    patches: np.ndarray,
    sigmas: tuple[float, ...],
    seed: int = 0,
    noises: int = NOISES,
) -> dict[str, float]:
    """What all noises of a picture share of the error of its denoised mean, by sigma.

    Squared, over the variance of the mean of the noise itself, and on average of `patches`
    (n, h, w, channels), in the prior's units; real. Of E[x | z] hardly anything is shared: the data
    know a mean better than the prior does. Unbiased, so that it may be below 0; where nothing is
    shared it has an sd of (2/n)^(1/2)/`noises`.

    Thickening counts electrons at the rate of what is denoised: over exposures of lambda a bias b
    of the mean adds b d lambda/lambda to it. Where a share f of the noise's variance is left at
    every level, with the same sign, means of draws end 2 f^(1/2) of their own sd off, and are
    (1 + 4 f)^(1/2) times too narrow.

    Raises ValueError for complex objects and for the signal-dependent error, of which a network
    knows a harmonic mean.
    """
    if not knows_means(prior):
        raise ValueError(
            "shared errors are those of the mean of a real picture: of complex objects and of the "
            "signal-dependent error no network knows it"
        )
    clean = jnp.asarray(patches)
    noise = _variance_of_means(clean, prior)

    @jax.jit
    def errors(sigma: jax.Array, keys: jax.Array) -> jax.Array:
        """Of the means, (noises, n)."""

        def once(key: jax.Array) -> jax.Array:
            z = perturbed(key, clean, sigma, prior.perturbation, False)
            found = jax.vmap(lambda z: prior.denoise(z, sigma))(z.reshape(-1, *prior.shape))
            return (found.reshape(clean.shape) - clean).mean((1, 2, 3))

        return jax.lax.map(once, keys)

    found = {}
    for i, sigma in enumerate(sigmas):
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), i), noises)
        off = np.asarray(errors(sigma, keys))
        shared = off.mean(axis=0) ** 2 - off.var(axis=0, ddof=1) / noises
        found[f"{sigma:g}"] = round(float(np.mean(shared / (sigma**2 * noise))), 3)
    return found


def _variance_of_means(clean: jax.Array, prior: LearnedPrior) -> np.ndarray:
    """Of the noise, at sigma = 1, of each picture's mean, (n,)."""
    sd = jnp.broadcast_to(error_sd(clean, 1.0, prior.perturbation, False), clean.shape)
    return np.asarray(jnp.mean(jnp.square(sd), (1, 2, 3)) / clean[0].size)
