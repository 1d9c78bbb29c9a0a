"""Do the draws explain the recording? A posterior of the wrong microscope is sure of itself too."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..models.likelihood import Likelihood
from .checks import check_finite, check_kinds, check_real
from .ranks import randomised_ranks


def misfit(likelihood: Likelihood, y: np.ndarray, draws: np.ndarray) -> float:
    """Squared residuals of the recording over the variance of its noise: 1 where all is right.

    `draws` (draws, *shape) of the posterior given `y`. The sum over pixels of (y - E[y | draw])^2,
    over the sum of the variances of y given the draw, averaged over draws: a posterior predictive
    check (Gelman, Meng and Stern 1996) whose expectation is 1, for draws and truth are
    exchangeable. Above it where the optics, the noise or the prior are not what they were; an error
    of the optics that the object can absorb is not seen. Left out, by what is expected there and
    not by what was recorded, are pixels within 4 sd of the full well, and those whose noise is
    below the ADC's; nan if none is left.

    Raises ValueError for a recording or draws of another shape than the likelihood's, no draws,
    values that are not finite, and a recording that is complex where the expected signal is real or
    real where it is complex.
    """
    y, draws = _checked(likelihood, y, draws)
    return float(np.mean([_misfit_of(likelihood, y, jnp.asarray(o)) for o in draws]))


def normalised_residuals(likelihood: Likelihood, y: np.ndarray, draws: np.ndarray) -> np.ndarray:
    """Map of the recording less what the draws predict on average, in sds of its noise.

    Of the data's shape; structure in it is what object, optics and noise do not explain. The sd is
    the root of the mean variance of y given the draws (of both parts of a complex recording, whose
    residuals are complex). Of exact draws its mean square is below 1, for they follow the
    recording's own noise: `reduced_chi_square` counts that. nan where `misfit` leaves pixels out,
    and where no noise is expected; raises ValueError as that does.
    """
    found = _prediction(likelihood, *_checked(likelihood, y, draws))
    seen = found.seen & (found.variance > 0)
    return np.where(seen, found.residual / np.sqrt(np.where(seen, found.variance, 1)), np.nan)


def reduced_chi_square(likelihood: Likelihood, y: np.ndarray, draws: np.ndarray) -> float:
    """Squared residuals about the draws' mean prediction, over what is expected: 1 is right.

    The expected square of a residual is the variance of y given the draw less the variance of its
    mean over the draws, which followed the noise so far: for noise of one sd the sum is chi-square
    over its degrees of freedom, pixels less effective parameters. Sums over pixels of both, as in
    `misfit`, whose own draws add their spread to numerator and denominator alike: where the draws
    are free to follow the recording it tells less. Its expectations are exact for draws of the
    posterior, however few. nan if no pixel is left; raises ValueError as `misfit` does, for fewer
    than 2 draws, and for draws that vary as much as the noise, which leave no degree of freedom.
    """
    y, draws = _checked(likelihood, y, draws, fewest=2)
    found = _prediction(likelihood, y, draws)
    if not found.seen.any():
        return float("nan")
    freedom = np.sum((found.variance - found.spread)[found.seen])
    if freedom <= 0:
        raise ValueError(
            f"what {len(draws)} draws predict varies as much as the noise: no degree of freedom is "
            "left, use misfit"
        )
    return float(np.sum(np.abs(found.residual[found.seen]) ** 2) / freedom)


def predicted(likelihood: Likelihood, draws: np.ndarray, key: jax.Array) -> np.ndarray:
    """A recording (L, *data_shape) of each of the draws (L, *shape): the posterior predictive.

    Raises ValueError for draws of another shape, none, and values that are not finite.
    """
    draws = jnp.asarray(_checked_draws(likelihood, draws))
    return np.asarray(_recorded(likelihood, draws, jax.random.split(key, len(draws))))


def predictive_ranks(
    likelihood: Likelihood, second: np.ndarray, draws: np.ndarray, key: jax.Array
) -> np.ndarray:
    """Where each pixel of a second exposure lies among those that the draws predict, in (0, 1).

    `draws` (L, *shape) of the posterior given the first exposure; `second`, of the likelihood's
    data shape, of the same object under the same optics and camera. If object and noise are as
    believed each rank is uniform: the probability integral transform of counts, made continuous at
    random (Czado, Gneiting and Held 2009). Pixels share the draws: test one a recording
    (`uniformity`), or their share in the tails by image. Ranks of the first exposure itself crowd
    in the middle, for the draws have seen it. Raises ValueError as `misfit` does, and for complex
    recordings, which have no ranks.
    """
    second, draws = _checked(likelihood, second, draws)
    check_real(recordings=second)
    key_predicted, key_ties = jax.random.split(key)
    others = predicted(likelihood, draws, key_predicted)
    seed = np.asarray(jax.random.key_data(key_ties))
    return randomised_ranks(np.asarray(second)[None], others[None], np.random.default_rng(seed))[0]


class _Prediction(NamedTuple):
    """Of each pixel: y less its mean prediction, noise variance, variance of the prediction."""

    residual: np.ndarray
    variance: np.ndarray
    spread: np.ndarray
    seen: np.ndarray


def _prediction(likelihood: Likelihood, y: jax.Array, draws: np.ndarray) -> _Prediction:
    """`spread` is over the number of draws: the mean of so many keeps a share of their variance."""
    count = len(draws)
    mean, square, variance = 0.0, 0.0, 0.0
    # About the first, lest squares that are nearly equal lose their difference.
    first = np.asarray(likelihood.expected(jnp.asarray(draws[0])))
    for o in draws:
        expected, noise, _ = (np.asarray(part) for part in _moments(likelihood, jnp.asarray(o)))
        moved = (expected - first).astype(complex if np.iscomplexobj(expected) else float)
        mean = mean + moved / count
        square = square + np.abs(moved) ** 2 / count
        variance = variance + noise.astype(float) / count
    residual = np.asarray(y) - first - mean
    light = (first + mean).real if likelihood.camera.counting else np.zeros(y.shape)
    seen = np.asarray(_seen(likelihood, np.maximum(light, 0), variance))
    return _Prediction(residual, variance, square - np.abs(mean) ** 2, seen)


@jax.jit
def _recorded(likelihood: Likelihood, draws: jax.Array, keys: jax.Array) -> jax.Array:
    return jax.vmap(likelihood.simulate)(keys, draws)


@jax.jit
def _misfit_of(likelihood: Likelihood, y: jax.Array, o: jax.Array) -> jax.Array:
    expected, variance, seen = _moments(likelihood, o)
    residual = jnp.abs(y - expected) ** 2
    return jnp.sum(jnp.where(seen, residual, 0.0)) / jnp.sum(jnp.where(seen, variance, 0.0))


@jax.jit
def _moments(likelihood: Likelihood, o: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Expected signal of an object, the variance of its noise, and which pixels count."""
    camera, expected = likelihood.camera, likelihood.expected(o)
    light = jnp.maximum(expected.real, 0.0) if camera.counting else jnp.zeros(expected.shape)
    parts = 2 if jnp.iscomplexobj(expected) else 1
    variance = parts * (camera.sigma0**2 * light + camera.read_variance)
    return expected, variance, _seen(likelihood, light, variance)


def _seen(likelihood: Likelihood, light: jax.Array, variance: jax.Array) -> jax.Array:
    camera = likelihood.camera
    return (variance >= 2 * camera.adc_variance) & (
        light + 4 * jnp.sqrt(variance) < camera.saturation
    )


def _checked(
    likelihood: Likelihood, y: np.ndarray, draws: np.ndarray, fewest: int = 1
) -> tuple[jax.Array, np.ndarray]:
    y, draws = np.asarray(y), _checked_draws(likelihood, draws, fewest)
    if y.shape != likelihood.data_shape:
        raise ValueError(f"data of shape {y.shape}: these optics record {likelihood.data_shape}")
    check_finite("recording", y, "mask or repair dead pixels first")
    expected = jax.eval_shape(likelihood.expected, jnp.asarray(draws[0]))
    check_kinds("a recording", y, "an expected signal", expected)
    return jnp.asarray(y), draws


def _checked_draws(likelihood: Likelihood, draws: np.ndarray, fewest: int = 1) -> np.ndarray:
    draws = np.asarray(draws)
    if draws.shape[1:] != likelihood.object_shape or len(draws) < fewest:
        raise ValueError(
            f"draws of shape {draws.shape} for objects of {likelihood.object_shape}: give (draws, "
            f"*shape), {fewest} or more"
        )
    check_finite("draws", draws)
    return draws
