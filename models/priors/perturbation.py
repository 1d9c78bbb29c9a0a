"""The perturbations a network can be trained on, each with its error and score.

"gaussian", real:     x~ = x + e,          e ~ N(0, sigma^2)
"gaussian", complex:  o~ = o + e,          Re e, Im e ~ N(0, sigma^2/4) each (eq:part_complex)
"signal":             z = |x + sqrt(x) e|, e ~ N(0, sigma^2)                 (eq:defining_x_tilde)
"poisson":            z = sigma^2 N,       N ~ Poisson(x/sigma^2)

Everything here works on channels: real arrays (h, w, channels), a complex object being the two
channels Re and Im. With s the standard deviation per channel, the score of the Gaussian ones is
(D - x~)/s^2, D = E[x | x~] (eq:denoiser_complex), and D is what the squared loss finds.

The signal-dependent variable x~ = x + sqrt(x) e may be negative; a sampler that keeps it positive
by reflection at zero draws z = |x~|. So "signal" means the folded z >= 0 everywhere:

    p(z | x) = (2 pi sigma^2 x)^(-1/2) exp(-(z^2 + x^2)/(2 sigma^2 x)) 2 cosh(z/sigma^2),

whose last factor does not depend on x. What x is given x~ is therefore the same for either sign,
and eq:true_p, (1 - x~ E[1/x | x~])/sigma^2, becomes (tanh(z/sigma^2) - z E[1/x | z])/sigma^2: its
one changes where z is not far above sigma^2. The slope of p(z) at zero is 0, its value is not.

The target of eq:DNN_poisson explodes where x is dark. Here the network predicts D = 1/E[1/x | z],
the harmonic mean, which the loss (D - x)^2/x finds: its minimum is where D E[1/x | z] = 1. The
score is (tanh(z/sigma^2) - z/D)/sigma^2, the same one. A `floor` keeps 1/x finite: the prior learnt
is that of max(x, floor), exactly, and D is never below the floor either.

"poisson" is what the signal-dependent error approximates: the counts of an exposure of 1/sigma^2
electrons at x = 1. It has the mean and the variance of "signal", and no score, being discrete;
E[x | z], which a squared loss with any weight of z alone finds, is all that `thinning` needs.
"""

import jax
import jax.numpy as jnp

from ..annealing import component_sd

PERTURBATIONS = ("gaussian", "signal", "poisson")


def refuse_counts(perturbation: str) -> None:
    """Refuse to give the score or the density of a discrete variable."""
    if perturbation == "poisson":
        raise ValueError(
            "counts have no score (the poisson perturbation is discrete): use the sampler "
            "Thickening, or a prior with the gaussian perturbation"
        )


def check_perturbation(name: str, complex_valued: bool) -> None:
    """Refuse a perturbation that does not exist, or not for complex objects."""
    if name not in PERTURBATIONS:
        raise ValueError(f"unknown perturbation {name!r}: use {' or '.join(PERTURBATIONS)}")
    if name != "gaussian" and complex_valued:
        raise ValueError(f"the {name} perturbation is for real objects: use 'gaussian' for complex")


def error_sd(
    x: jax.Array, sigma: jax.Array, perturbation: str, complex_valued: bool
) -> jax.Array | float:
    """Standard deviation of the error on each channel of the clean `x`, before any fold."""
    if perturbation != "gaussian":
        return sigma * jnp.sqrt(x)
    return component_sd(sigma, complex_valued)


def perturbed(
    key: jax.Array, clean: jax.Array, sigma: jax.Array, perturbation: str, complex_valued: bool
) -> jax.Array:
    """One draw of the annealed variable from the clean channels; negative for "gaussian" alone."""
    if perturbation == "poisson":
        return sigma**2 * jax.random.poisson(key, clean / sigma**2).astype(clean.dtype)
    sd = error_sd(clean, sigma, perturbation, complex_valued)
    x = clean + sd * jax.random.normal(key, clean.shape, clean.dtype)
    return jnp.abs(x) if perturbation == "signal" else x


def folded_score(z: jax.Array, clean: jax.Array, sigma: jax.Array) -> jax.Array:
    """Score in z of p(z | x = clean); with the harmonic mean for `clean`, that of p(z).

    Elementwise. Odd in z, so that a negative value gets the score of the density's mirror image.
    """
    return (jnp.tanh(z / sigma**2) - z / clean) / sigma**2


def folded_energy(z: jax.Array, clean: jax.Array, sigma: jax.Array) -> jax.Array:
    """-log p(z | x = clean), elementwise, without the term log(2 pi sigma^2 clean)/2. Even in z.

    (z - x)^2/(2 sigma^2 x) - log(1 + exp(-2 z/sigma^2)): the cosh without its overflow.
    """
    z = jnp.abs(z)
    unfolded = jnp.square(z - clean) / (2 * sigma**2 * clean)
    return unfolded - jax.nn.softplus(-2 * z / sigma**2)


def score_from_denoised(
    x: jax.Array, denoised: jax.Array, sigma: jax.Array, perturbation: str, complex_valued: bool
) -> jax.Array:
    """Score at the perturbed `x`, from what the network says of the clean one; none of counts."""
    if perturbation == "signal":
        return folded_score(x, denoised, sigma)
    return (denoised - x) / component_sd(sigma, complex_valued) ** 2
