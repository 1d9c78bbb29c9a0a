"""The likelihood of the annealed variable: what a recording says of object + annealing error.

An annealed sampler moves x~ = x + e, whose error e shrinks level by level. Its likelihood score
needs the distribution of the recording given x~. Two paths lead to the posterior as sigma_t -> 0:

"split"      the paper's: e is a part of the measurement noise, so what is left of the noise given
             x~ has variance sigma_0^2 - sigma_t^2 ||h_i||^2. Levels start under the noise itself.
"convolved"  e is independent of the noise, so their variances add. Levels may start as broad as
             the prior, which lets the sampler travel between far modes.

The functions here are elementwise in the field (or the image), with the variance that is left
handed in; models/likelihood.py says which variance, and applies the adjoint of the optics.

Perturbations: "gaussian", e ~ N(0, sigma_t^2) for real objects and N(0, sigma_t^2/4) in Re and in
Im for complex ones (eq:part_complex); "signal", sqrt(x) e with e ~ N(0, sigma_t^2)
(eq:defining_x_tilde).
"""

import jax
import jax.numpy as jnp
from jax.scipy.special import i0e, i1e

PATHS = ("split", "convolved")


def component_sd(sigma: jax.Array | float, complex_object: bool) -> jax.Array | float:
    """Standard deviation of the annealing error per real component of the object."""
    return sigma / 2 if complex_object else sigma


def remaining_variance(noise: jax.Array, annealing: jax.Array, path: str) -> jax.Array:
    """Noise variance given x~: noise - annealing ("split") or noise + annealing ("convolved").

    Along "split" the difference is kept above a thousandth of the noise, for levels that touch it.
    """
    if path not in PATHS:
        raise ValueError(f"unknown path {path!r}: use 'split' or 'convolved'")
    if path == "convolved":
        return noise + annealing
    return jnp.maximum(noise - annealing, 1e-3 * noise)


def intensity_score(field: jax.Array, y: jax.Array, variance: jax.Array) -> jax.Array:
    """Score of y = |field + rest|^2 in `field`, the rest normal with `variance` per component.

    For a complex field sqrt(y) is Rician about |field|:
    (f/nu) (sqrt(y) R(nu sqrt(y)/s^2) - nu)/s^2 with nu = |f| and R = I1/I0, which corrects
    eq:complex_final. For a real field it is a folded normal: R = tanh.
    """
    amplitude = jnp.sqrt(jnp.maximum(y, 0.0))
    argument = jnp.abs(field) * amplitude / variance
    ratio = _bessel_ratio if jnp.iscomplexobj(field) else _tanh_ratio
    return field * (jnp.square(amplitude) / variance * ratio(argument) - 1) / variance


def published_intensity_score(field: jax.Array, y: jax.Array, variance: jax.Array) -> jax.Array:
    """eq:complex_final as printed, `variance` standing for sigma_0^2 - sigma_t^2.

    Beside the consistent form it lacks a quarter in the variance and has the factor 1/2 of the
    Wirtinger derivative. It makes the posterior of an amplitude about twice too wide.
    """
    amplitude = jnp.sqrt(jnp.maximum(y, 0.0))
    argument = jnp.abs(field) * amplitude / variance
    bracket = jnp.square(amplitude) / variance * _bessel_ratio(argument) - 1
    return field / (2 * variance) * bracket


def counts_score(expected: jax.Array, y: jax.Array, variance: jax.Array) -> jax.Array:
    """(y - expected)/variance: the Gaussian score, and the Poisson one if variance ~ expected.

    With variance = sigma_0^2 expected this is exactly the score of Poisson counts, so the annealed
    score tends to that of the true counts and not of their Gaussian approximation.
    """
    return (y - expected) / variance


def signal_score(x: jax.Array, y: jax.Array, variance: jax.Array) -> jax.Array:
    """eq:log_p_y_x_tilde: score of y ~ N(x~, variance x~) in x~ > 0."""
    return (jnp.square(y / x) - 1) / (2 * variance) - 1 / (2 * x)


def _bessel_ratio(z: jax.Array) -> jax.Array:
    """I1(z)/(z I0(z)), which is 1/2 at zero."""
    small = z < 1e-2
    safe = jnp.where(small, 1.0, z)
    return jnp.where(small, 0.5 - z**2 / 16, i1e(safe) / (safe * i0e(safe)))


def _tanh_ratio(z: jax.Array) -> jax.Array:
    """tanh(z)/z, which is 1 at zero."""
    small = z < 1e-2
    safe = jnp.where(small, 1.0, z)
    return jnp.where(small, 1 - z**2 / 3, jnp.tanh(safe) / safe)
