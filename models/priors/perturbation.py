"""The perturbations a network can be trained on, each with its error, loss and score.

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


def squared_error(error: jax.Array, averages: float = 0.0) -> jax.Array:
    """Mean square of errors (h, w, channels), and `averages` times those of their averages.

    Of the whole patch and of squares of 2, 4, 8, ... pixels a side that fill it, each average in
    units of the sd that independent errors of 1 would give it. The mean square alone hardly sees an
    error that all pixels share: over n of them 1 / n of it, where data know their average n times
    as well as one. E[error | input] = 0 minimises any such sum of squares.
    """
    total = jnp.mean(jnp.square(error))
    if not averages:
        return total
    h, w, channels = error.shape
    sides = [2**k for k in range(1, 16) if h % 2**k == w % 2**k == 0 and 2**k < max(h, w)]
    for rows, columns in [*((side, side) for side in sides), (h, w)]:
        blocks = error.reshape(h // rows, rows, w // columns, columns, channels).mean((1, 3))
        total += averages * rows * columns * jnp.mean(jnp.square(blocks))
    return total


def denoising_loss(
    denoised: jax.Array, clean: jax.Array, perturbation: str, averages: float = 0.0
) -> jax.Array:
    """`squared_error`; for "signal" of pixels alone, over their clean value (at or above the
    floor): what minimises it is a harmonic mean, which averages of errors would move.
    """
    if perturbation == "signal":
        return jnp.mean(jnp.square(denoised - clean) / clean)
    return squared_error(denoised - clean, averages)


def count_loss(
    denoised: jax.Array,
    clean: jax.Array,
    z: jax.Array,
    sigma: jax.Array,
    mean: float,
    averages: float = 0.0,
) -> jax.Array:
    """`squared_error` over 2 sqrt(z), as of square roots: E[clean | z] minimises it.

    The weight has a floor between sigma^2, one count, and the pictures' mean. It depends on the
    perturbed z alone: one that looked at the clean picture would move the minimum.
    """
    floor = sigma**2 * mean / (sigma**2 + mean)
    return squared_error((denoised - clean) / (2 * jnp.sqrt(z + floor)), averages)


def signal_score_loss(
    score: jax.Array, clean: jax.Array, x: jax.Array, sigma: jax.Array, floor: float
) -> jax.Array:
    """eq:DNN_poisson, folded, in units of the error, for scores that come from an energy.

    The weight depends on the perturbed `x` >= 0 alone: one that looked at the clean picture would
    move the minimum.
    """
    target = folded_score(x, clean, sigma)
    return jnp.mean(sigma**2 * jnp.maximum(x, floor) * jnp.square(score - target))
