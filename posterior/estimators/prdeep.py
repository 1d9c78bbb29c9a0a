"""prDeep: an object that explains its intensities and that a denoiser leaves alone.

Metzler, Schniter, Veeraraghavan and Baraniuk, ICML 2018: regularisation by denoising for phase
retrieval. With amplitudes a = sqrt(y / irradiance) it goes down

    || a - |H o| ||^2 / 2 + weight o' (o - D(o)) / 2

with the denoiser D of one level after the other, from broad to fine, each from where the last one
ended. An iteration is a gradient step of the amplitudes, then the regulariser's proximal map with
D(o) held (Reehorst and Schniter, IEEE Trans. Computational Imaging 5, 52, 2019).
"""

import math
import operator
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models.annealing import component_sd
from ..models.likelihood import IntensityLikelihood
from ..problem import Posterior
from .red import Regularised, positive

# Of the paper: standard deviations of its denoisers, for pictures in 0..1.
LEVELS = (50 / 255, 40 / 255, 20 / 255, 10 / 255)
_POWER_ITERATIONS = 30
_TINY = float(jnp.finfo(jnp.float32).tiny)


def prdeep(
    posterior: Posterior,
    start: jax.Array,
    levels: Sequence[float] = LEVELS,
    weight: float | None = None,
    iterations: int = 200,
) -> Regularised:
    """What prDeep makes of `start`, such as the object that `hio` finds.

    - `posterior`: of an `IntensityLikelihood` under a prior of the gaussian perturbation.
    - `start`: of the object's shape and dtype; the loss has many minima, and it finds a near one.
    - `levels`: of the denoiser, units of the object; `iterations` at each.
    - `weight`: of the regulariser; None: at each level the variance of an amplitude's noise over
      that of the level: what it ends at is stationary under the posterior with normal amplitudes.

    Departures from the paper: steps of 1 / ||H||^2 in place of FASTA's adaptive ones; the prior's
    denoiser in place of four DnCNN. Saturation and the ADC are not modelled. `imbalance` of what is
    returned: the force that is left over that of the regulariser at the last level, 0 at the end.
    One compiled computation. Raises ValueError for other likelihoods and perturbations, a start of
    another shape or kind, and numbers that are not positive and finite.
    """
    likelihood, prior = posterior.likelihood, posterior.prior
    if not isinstance(likelihood, IntensityLikelihood):
        raise ValueError(
            f"likelihood is a {type(likelihood).__name__}: prdeep is for intensities of a field, "
            "for the picture itself use red"
        )
    if prior.perturbation != "gaussian":
        raise ValueError(
            f"the prior has the {prior.perturbation!r} perturbation: give one with the gaussian"
        )
    start = jnp.asarray(start)
    if start.shape != posterior.shape:
        raise ValueError(f"a start of shape {start.shape}: the object is {posterior.shape}")
    if jnp.iscomplexobj(start) and not jnp.issubdtype(posterior.dtype, jnp.complexfloating):
        raise ValueError("a complex start for a real object: give its real part")
    if not np.all(np.isfinite(start)):
        raise ValueError("the start holds values that are not finite: start from hio")
    levels = [positive("level", level) for level in levels]
    if operator.index(iterations) < 1 or not levels:
        raise ValueError(f"iterations {iterations} at levels {levels}: give 1 or more of both")
    noise = float(likelihood.camera.sigma0) / 2
    noise /= math.sqrt(float(jnp.mean(likelihood.irradiance)))
    if weight is None:
        weights = [(noise / component_sd(t, prior.complex_valued)) ** 2 for t in levels]
    else:
        weights = [weight] * len(levels)
    weights = [positive("weight", w) for w in weights]
    real = posterior.y.real.dtype
    schedule = jnp.asarray(levels, real), jnp.asarray(weights, real)
    return _descended(posterior, start.astype(posterior.dtype), schedule, iterations)


@eqx.filter_jit
def _descended(
    posterior: Posterior,
    start: jax.Array,
    schedule: tuple[jax.Array, jax.Array],
    iterations: int,
) -> Regularised:
    step = 1 / _largest_eigenvalue(posterior)

    def one(o: jax.Array, at: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        level, weight = at
        explained = o + step * _pull(posterior, o)
        clean = posterior.prior.denoise(o, level)
        return (explained + step * weight * clean) / (1 + step * weight), None

    each = tuple(jnp.repeat(values, iterations) for values in schedule)
    o, _ = jax.lax.scan(one, start, each)
    level, weight = (values[-1] for values in schedule)
    regular = weight * (posterior.prior.denoise(o, level) - o)
    left = jnp.linalg.norm(_pull(posterior, o) + regular)
    return Regularised(o, left / jnp.maximum(jnp.linalg.norm(regular), _TINY))


def _pull(posterior: Posterior, o: jax.Array) -> jax.Array:
    """Minus the gradient of || a - |H o| ||^2 / 2: H^H (a e^{j arg H o} - H o)."""
    likelihood = posterior.likelihood
    amplitude = likelihood.amplitude(posterior.y)
    field = likelihood.optics(o)
    return _object(posterior, likelihood.optics.adjoint(amplitude * jnp.sign(field) - field))


def _largest_eigenvalue(posterior: Posterior) -> jax.Array:
    """Of H^H H, by power iterations."""
    optics = posterior.likelihood.optics

    def one(o: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        image = _object(posterior, optics.adjoint(optics(o)))
        norm = jnp.linalg.norm(image)
        return image / norm, norm

    first = jax.random.normal(jax.random.key(0), posterior.shape, posterior.dtype)
    _, norms = jax.lax.scan(one, first / jnp.linalg.norm(first), length=_POWER_ITERATIONS)
    return norms[-1]


def _object(posterior: Posterior, o: jax.Array) -> jax.Array:
    return o if jnp.issubdtype(posterior.dtype, jnp.complexfloating) else o.real
