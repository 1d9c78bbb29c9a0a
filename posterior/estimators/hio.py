"""Hybrid input-output: an object from the magnitudes of its Fourier transform.

Fienup, Applied Optics 21, 2758 (1982). Each iteration gives the transform of the object the
recorded magnitudes; where what comes back breaks what is known of the object (it lies in its box
and support, and is nonnegative), the iterate is pushed the other way instead of being set to zero.
"""

import operator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ..models.likelihood import IntensityLikelihood
from ..models.optics import Fourier

NONNEGATIVE, REAL, COMPLEX = "nonnegative", "real", "complex"


class Retrieved(NamedTuple):
    """Objects (keep, *shape) that `hio` found, best first, each within the constraints.

    `residuals` (keep,): || |H o| - amplitude || / ||amplitude||, amplitude = sqrt(y / irradiance);
    `start_residuals` (starts,): the same at the end of every short run.
    """

    objects: jax.Array
    residuals: jax.Array
    start_residuals: jax.Array

    @property
    def object(self) -> jax.Array:
        """The object with the lowest residual."""
        return self.objects[0]


def hio(
    likelihood: IntensityLikelihood,
    y: ArrayLike,
    key: jax.Array,
    *,
    kind: str = NONNEGATIVE,
    starts: int = 50,
    short: int = 50,
    iterations: int = 1000,
    keep: int = 1,
    beta: float = 0.9,
) -> Retrieved:
    """The object behind Fourier intensities `y`, up to what they cannot tell (`optics.symmetries`).

    `starts` runs of `short` iterations, from random phases, side by side; the `keep` of lowest
    residual go on for `iterations` more (the protocol of Metzler et al., ICML 2018). Run i depends
    on `fold_in(key, i)` alone. All is one compiled computation.

    - `likelihood`: its optics are `Fourier`, bounded by oversampling or support. Noise is ignored.
    - `y`: of `likelihood.data_shape`, normalised; what lies below zero counts as darkness.
    - `kind`: of object: "nonnegative", "real" or "complex". The transform of a real object has
      equal magnitudes at k and -k: the two recordings are averaged, which halves their variance.
    - `beta`: of the feedback, above 0.

    Precision follows JAX's default. Raises ValueError for other optics, an object that nothing
    bounds, data that cannot be such a recording, and settings out of range.
    """
    _check_likelihood(likelihood, kind)
    if not isinstance(y, jax.core.Tracer):
        y = np.asarray(y)
    if y.shape != likelihood.data_shape:
        raise ValueError(f"data of shape {y.shape}: these optics record {likelihood.data_shape}")
    if not isinstance(y, jax.core.Tracer):
        _check_light(likelihood, y)
    for name, value, least in (("starts", starts, 1), ("short", short, 0), ("keep", keep, 1)):
        _check_count(name, value, least)
    _check_count("iterations", iterations, 0)
    if keep > starts:
        raise ValueError(f"keep {keep} of {starts} starts: keep no more than there are")
    if not 0 < beta < np.inf:
        raise ValueError(f"beta {beta}: give a positive number, such as 0.9")
    amplitude = likelihood.amplitude(jnp.asarray(y, float))
    counts = starts, short, iterations, keep
    return _retrieve(likelihood.optics, amplitude, key, kind, counts, jnp.asarray(beta, float))


@eqx.filter_jit
def _retrieve(
    optics: Fourier,
    amplitude: jax.Array,
    key: jax.Array,
    kind: str,
    counts: tuple[int, int, int, int],
    beta: jax.Array,
) -> Retrieved:
    starts, short, iterations, keep = counts
    search = _Search(optics, amplitude, kind, beta)
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(jnp.arange(starts))
    tried = search.run(jax.vmap(search.start)(keys), short)
    tried_residuals = jax.vmap(search.residual)(tried)
    best = jnp.argsort(tried_residuals)[:keep]
    found = search.run(tried[best], iterations)
    residuals = jax.vmap(search.residual)(found)
    order = jnp.argsort(residuals)
    objects = jax.vmap(search.object)(found[order])
    return Retrieved(objects, residuals[order], tried_residuals)


class _Search(eqx.Module):
    """The two sets between which the iterates x, of the padded array's shape, go back and forth.

    A real object needs half of the spectrum; `amplitude` is that half.
    """

    optics: Fourier
    amplitude: jax.Array
    inside: jax.Array
    kind: str
    beta: jax.Array

    def __init__(self, optics: Fourier, amplitude: jax.Array, kind: str, beta: jax.Array):
        self.optics, self.kind, self.beta = optics, kind, beta
        box = jnp.ones(optics.in_shape, bool) if optics.support is None else optics.support
        self.inside = jnp.pad(box, [(0, m - n) for m, n in zip(optics.out_shape, optics.in_shape)])
        self.amplitude = amplitude if kind == COMPLEX else _half(_symmetrised(amplitude))

    def start(self, key: jax.Array) -> jax.Array:
        """The recorded magnitudes with random phases (Sec. Phase Retrieval of the paper)."""
        turns = jax.random.uniform(key, self.optics.out_shape, self.amplitude.dtype)
        turns = turns if self.kind == COMPLEX else _half(turns)
        return self._backward(self.amplitude * jnp.exp(2j * jnp.pi * turns))

    def run(self, x: jax.Array, steps: int) -> jax.Array:
        """A batch of iterates, `steps` iterations later."""

        def step(x: jax.Array, _: None) -> tuple[jax.Array, None]:
            return jax.vmap(self._iterate)(x), None

        return jax.lax.scan(step, x, None, length=steps)[0]

    def object(self, x: jax.Array) -> jax.Array:
        """The iterate with the recorded magnitudes, cut to what is known of the object."""
        x = self._with_magnitudes(x)
        x = jnp.where(self._allowed(x), x, 0)
        return x[tuple(slice(n) for n in self.optics.in_shape)]

    def residual(self, x: jax.Array) -> jax.Array:
        """Relative misfit of the object's magnitudes."""
        o = self.object(x)
        misfit = jnp.abs(self._forward(o)) - self.amplitude
        return self._norm(misfit) / self._norm(self.amplitude)

    def _iterate(self, x: jax.Array) -> jax.Array:
        back = self._with_magnitudes(x)
        return jnp.where(self._allowed(back), back, x - self.beta * back)

    def _allowed(self, x: jax.Array) -> jax.Array:
        return self.inside & (x >= 0) if self.kind == NONNEGATIVE else self.inside

    def _with_magnitudes(self, x: jax.Array) -> jax.Array:
        return self._backward(self.amplitude * jnp.sign(self._forward(x)))

    def _forward(self, x: jax.Array) -> jax.Array:
        transform = jnp.fft.fftn if self.kind == COMPLEX else jnp.fft.rfftn
        return transform(x, s=self.optics.out_shape, norm="ortho")

    def _backward(self, spectrum: jax.Array) -> jax.Array:
        transform = jnp.fft.ifftn if self.kind == COMPLEX else jnp.fft.irfftn
        return transform(spectrum, s=self.optics.out_shape, norm="ortho")

    def _norm(self, spectrum: jax.Array) -> jax.Array:
        """Norm over the whole spectrum; of its half every column but the mirrored ones is twice."""
        if self.kind == COMPLEX:
            return jnp.linalg.norm(spectrum)
        column, last = np.arange(spectrum.shape[-1]), self.optics.out_shape[-1]
        times = np.where((column == 0) | (2 * column == last), 1.0, 2.0)
        return jnp.sqrt(jnp.sum(times * spectrum**2))


def _half(spectrum: jax.Array) -> jax.Array:
    return spectrum[..., : spectrum.shape[-1] // 2 + 1]


def _symmetrised(amplitude: jax.Array) -> jax.Array:
    """From the mean intensity at k and -k: of Poisson counts it keeps all there is to know."""
    axes = tuple(range(amplitude.ndim))
    mirrored = jnp.roll(jnp.flip(amplitude, axes), 1, axes)
    return jnp.sqrt((amplitude**2 + mirrored**2) / 2)


def _check_likelihood(likelihood: IntensityLikelihood, kind: str) -> None:
    if not isinstance(likelihood, IntensityLikelihood):
        raise ValueError(
            f"likelihood is a {type(likelihood).__name__}: give an IntensityLikelihood of Fourier"
        )
    optics = likelihood.optics
    if not isinstance(optics, Fourier):
        raise ValueError(
            f"optics are {type(optics).__name__}: hio is for Fourier, for others use "
            "estimators.maximum_likelihood"
        )
    if kind not in (NONNEGATIVE, REAL, COMPLEX):
        raise ValueError(f"kind {kind!r}: use 'nonnegative', 'real' or 'complex'")
    if optics.in_shape == optics.out_shape and optics.support is None:
        raise ValueError(
            f"nothing bounds the object of shape {optics.in_shape}: build Fourier with "
            "oversampling=2 or more, or with a support"
        )


def _check_light(likelihood: IntensityLikelihood, y: np.ndarray) -> None:
    likelihood.camera.check(y)
    if not np.any(y > 0):
        raise ValueError("the recording is dark everywhere: there is nothing to reconstruct from")


def _check_count(name: str, value: int, least: int) -> None:
    try:
        good = operator.index(value) >= least and not isinstance(value, bool)
    except TypeError:
        good = False
    if not good:
        raise ValueError(f"{name} {value}: give a whole number, {least} or more")
