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

    Squared, of `patches` (n, h, w, channels) in the prior's units, over the variance of the mean of
    the noise itself; both are averages of the patches, so that nearly black ones, whose noise is
    next to nothing, do not decide. Of E[x | z] hardly anything is shared at levels at which the
    data know a mean better than the prior does. Unbiased, so that it may be below 0; where nothing
    is shared, and all are as bright, it has an sd of (2/n)^(1/2)/`noises`. 0 of patches without any
    light.

    Thickening counts electrons at the rate of what is denoised: over exposures of lambda a bias b
    of the mean adds b d lambda/lambda to it. Where a share f of the noise's variance is left at
    every level, with the same sign, means of draws end 2 f^(1/2) of their own sd off, and are
    (1 + 4 f)^(1/2) times too narrow.

    Raises ValueError for complex objects, for the signal-dependent error, of which a network knows
    a harmonic mean, for patches that are not the prior's, not finite, or below 0 under a prior of
    counts, and for less than 2 noises.
    """
    if not knows_means(prior):
        raise ValueError(
            "shared errors are those of the mean of a real picture: of complex objects and of the "
            "signal-dependent error no network knows it"
        )
    check_patches(prior, patches)
    if noises < 2:
        raise ValueError(f"noises {noises}: give 2 or more")
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
        shared = np.mean(off.mean(axis=0) ** 2 - off.var(axis=0, ddof=1) / noises)
        found[f"{sigma:g}"] = round(float(shared / (sigma**2 * noise)), 3) if noise else 0.0
    return found


def check_patches(prior: LearnedPrior, patches: np.ndarray) -> None:
    """Raise ValueError for patches that are not (n, h, w, channels) of the prior, not finite, or
    below 0 under a prior of counts.
    """
    shape = prior.shape if len(prior.shape) == 3 else (*prior.shape, 1)
    if patches.ndim != 4 or patches.shape[1:] != shape or not len(patches):
        raise ValueError(
            f"patches of shape {patches.shape}: give (n, {', '.join(map(str, shape))}), as the "
            "prior's objects"
        )
    if not np.all(np.isfinite(patches)):
        raise ValueError("the patches have values that are not finite: leave those patches out")
    if prior.perturbation == "poisson" and np.min(patches) < 0:
        raise ValueError(
            f"the darkest value of the patches is {np.min(patches):.3g}: light that is counted is "
            "0 or more, clip them or take their offset away"
        )


def _variance_of_means(clean: jax.Array, prior: LearnedPrior) -> float:
    """Of the noise of a picture's mean, at sigma = 1, on average of the pictures."""
    sd = jnp.broadcast_to(error_sd(clean, 1.0, prior.perturbation, False), clean.shape)
    return float(jnp.mean(jnp.square(sd)) / clean[0].size)
