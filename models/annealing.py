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
from jax.scipy.stats import norm

PATHS = ("split", "convolved")


def component_sd(sigma: jax.Array | float, complex_object: bool) -> jax.Array | float:
    """Standard deviation of the annealing error per real component of the object."""
    return sigma / 2 if complex_object else sigma


def tweedie(x: jax.Array, score: jax.Array, sigma: jax.Array | float) -> jax.Array:
    """E[object | x~ = x] from the prior's score at level `sigma`, gaussian perturbation; as `x`."""
    return x + (component_sd(sigma, jnp.iscomplexobj(x)) ** 2 * score).astype(x.dtype)


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
    ratio = bessel_ratio if jnp.iscomplexobj(field) else _tanh_ratio
    return field * (jnp.square(amplitude) / variance * ratio(argument) - 1) / variance


def counted_intensity_score(
    field: jax.Array, y: jax.Array, noise: jax.Array, annealing: jax.Array
) -> jax.Array:
    """Score, in `field`, of Poisson counts of the intensity |field + e|^2 ("convolved").

    `noise`: variance of sqrt(y), so that y holds N = y F electrons, F = 1/(4 noise); `annealing`:
    variance of e per real component, 0 allowed. The counts are those of laser light among thermal
    light (Lachs 1965): with n_t = 2 F annealing and n_s = F |field|^2,
        p(N | field) ~ exp(-n_s/(1 + n_t)) M(-N, b, -z),   z = n_s/(n_t (1 + n_t)),
    M Kummer's function, b = 1 for a complex field and 1/2 for a real one. At annealing = 0 this is
    the score of the counts themselves, in the dark too, where `intensity_score`, which takes
    sqrt(y) to have the same variance at every brightness, is up to twice too sure.

    Approximation: the logarithmic derivative of M, below 0.5 % (complex) and 1 % (real) for whole
    N; measured against quadrature, the score errs by less than 2 % of 1/sd of the field.
    """
    b = 1.0 if jnp.iscomplexobj(field) else 0.5
    full_well = 1 / (4 * noise)
    count = full_well * jnp.maximum(y, 0.0)
    thermal = 2 * full_well * annealing
    coherent = full_well * (jnp.square(field.real) + jnp.square(field.imag)) / (1 + thermal)
    per_signal = _kummer_slope(count, coherent, thermal, b)
    return 2 * full_well * field * (per_signal - 1) / (1 + thermal)


def signal_count(
    field: jax.Array, y: jax.Array, noise: jax.Array, annealing: jax.Array, background: jax.Array
) -> jax.Array:
    """What of `y` the light of the field is expected to have given, beside a `background`.

    The score of a sum of counts is the mean, given the sum, of the score of one of them (Fisher).
    That mean is the share l / (l + b) of all N electrons, where b are expected of the background
    and l of the field; l is the light under the annealing error, of mean m and variance v, by its
    best linear predictor m + v (N - m - b) / (v + m + b). Exact at annealing = 0, where l = m, and
    near N - b where the error is broad. `noise` and `annealing` as in `counted_intensity_score`.

    Approximation: measured against quadrature, the score errs by up to 0.4 of 1/sd of the field,
    0.15 in root mean square, under 30 electrons of background; less under fewer.
    """
    half = 1.0 if jnp.iscomplexobj(field) else 0.5
    full_well = 1 / (4 * noise)
    thermal = 2 * full_well * annealing
    coherent = full_well * (jnp.square(field.real) + jnp.square(field.imag))
    mean = coherent + half * thermal
    variance = 2 * thermal * coherent + half * thermal**2
    dark = full_well * background
    # Where neither sends light there is none to be shared out.
    tiny = jnp.finfo(mean.dtype).tiny
    total = jnp.maximum(mean + dark, tiny)
    light = mean + variance / (variance + total) * (full_well * y - total)
    light = jnp.maximum(light, 0.0)
    return y * light / jnp.maximum(light + dark, tiny)


def published_intensity_score(field: jax.Array, y: jax.Array, variance: jax.Array) -> jax.Array:
    """eq:complex_final as printed, `variance` standing for sigma_0^2 - sigma_t^2.

    Beside the consistent form it lacks a quarter in the variance and has the factor 1/2 of the
    Wirtinger derivative. It makes the posterior of an amplitude about twice too wide.
    """
    amplitude = jnp.sqrt(jnp.maximum(y, 0.0))
    argument = jnp.abs(field) * amplitude / variance
    bracket = jnp.square(amplitude) / variance * bessel_ratio(argument) - 1
    return field / (2 * variance) * bracket


def counts_score(expected: jax.Array, y: jax.Array, variance: jax.Array) -> jax.Array:
    """(y - expected)/variance: the Gaussian score, and the Poisson one if variance ~ expected.

    With variance = sigma_0^2 expected this is exactly the score of Poisson counts, so the annealed
    score tends to that of the true counts and not of their Gaussian approximation. Beside an
    annealing error the variance must be that of the light without the error: if it follows
    `expected` up and down, low values pull harder than high ones, and dark areas come out bright.
    """
    return (y - expected) / variance


def saturated_score(expected: jax.Array, edge: jax.Array | float, variance: jax.Array) -> jax.Array:
    """Score of a recording that says only "at least `edge`": d/dx log P(x + noise > edge).

    Gaussian noise of the `variance`, which is taken not to depend on the signal: a good
    approximation above some ten electrons.
    """
    sd = jnp.sqrt(variance)
    z = (expected - edge) / sd
    return jnp.exp(norm.logpdf(z) - norm.logcdf(z)) / sd


def signal_score(x: jax.Array, y: jax.Array, variance: jax.Array) -> jax.Array:
    """eq:log_p_y_x_tilde: score of y ~ N(x~, variance x~) in x~ > 0."""
    return (jnp.square(y / x) - 1) / (2 * variance) - 1 / (2 * x)


def bessel_ratio(z: jax.Array) -> jax.Array:
    """I1(z)/(z I0(z)), which is 1/2 at zero."""
    small = z < 1e-2
    safe = jnp.where(small, 1.0, z)
    return jnp.where(small, 0.5 - z**2 / 16, i1e(safe) / (safe * i0e(safe)))


def _tanh_ratio(z: jax.Array) -> jax.Array:
    """tanh(z)/z, which is 1 at zero."""
    small = z < 1e-2
    safe = jnp.where(small, 1.0, z)
    return jnp.where(small, 1 - z**2 / 3, jnp.tanh(safe) / safe)


def _kummer_slope(n: jax.Array, zt: jax.Array, t: jax.Array, b: float) -> jax.Array:
    """w/t, w = d/dz log M(-n, b, -z), by zt = z t; t = 0 allowed, where it is n/(z t).

    w solves Riccati's z (w' + w^2) + (b + z) w = n. First the form
    2n/(b - 1 + z + sqrt((b + 1 + z)^2 + 4 (n - 1) z)), which has the right value and slope at
    z = 0, the right two terms at infinity, and is exact for n = 0 and 1; then Riccati's equation
    solved for w with the slope w' of that form.
    """
    tiny = jnp.finfo(zt.dtype).tiny
    root = jnp.sqrt(jnp.maximum((t * (b + 1) + zt) ** 2 + 4 * (n - 1) * zt * t, tiny))
    bottom = jnp.maximum(t * (b - 1) + zt + root, jnp.sqrt(tiny))
    slope = 2 * n * (zt / bottom) * (t / bottom) * (1 + (t * (b + 1) + zt + 2 * (n - 1) * t) / root)
    risen, linear = n + slope, t * b + zt
    bottom = linear + jnp.sqrt(linear**2 + 4 * zt * risen * t)
    return 2 * risen / jnp.maximum(bottom, jnp.sqrt(tiny))
