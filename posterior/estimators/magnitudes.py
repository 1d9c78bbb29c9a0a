"""What plug-and-play methods for intensities of a field share: amplitudes, noise, and checks."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models.likelihood import IntensityLikelihood
from ..models.optics import Optics


class Magnitudes(eqx.Module):
    """Amplitudes of a field H o: `amplitude` = sqrt(y / irradiance), darkness below zero.

    `variance`: of the noise of each amplitude, where light is not scarce.
    """

    optics: Optics
    amplitude: jax.Array
    variance: jax.Array

    def to_object(self, field: jax.Array, like: jax.Array) -> jax.Array:
        """H^H field, its real part where the object is real; dtype of `like`."""
        back = self.optics.adjoint(field)
        return (back if jnp.iscomplexobj(like) else back.real).astype(like.dtype)


def magnitudes(
    likelihood: IntensityLikelihood, y: np.ndarray, start: jax.Array, name: str
) -> tuple[Magnitudes, jax.Array]:
    """Amplitudes of the recording `y`, and the start in JAX's precision; refuses, for the method
    `name`, other likelihoods, recordings that its camera cannot have made, and other starts.
    """
    if not isinstance(likelihood, IntensityLikelihood):
        raise ValueError(
            f"likelihood is a {type(likelihood).__name__}: {name} is for intensities of a field"
        )
    start = np.asarray(start)
    if start.shape != likelihood.object_shape:
        raise ValueError(f"a start of shape {start.shape}: the object is {likelihood.object_shape}")
    if not np.all(np.isfinite(start)):
        raise ValueError("the start holds values that are not finite: start from hio")
    if np.shape(y) != likelihood.data_shape:
        raise ValueError(
            f"data of shape {np.shape(y)}: these optics record {likelihood.data_shape}"
        )
    likelihood.camera.check(np.asarray(y))
    y = jnp.asarray(y, float)
    variance, _ = likelihood.noise(np.iscomplexobj(start), y)
    amplitude = likelihood.amplitude(y)
    start = jnp.asarray(start, complex if np.iscomplexobj(start) else float)
    return Magnitudes(likelihood.optics, amplitude, variance / likelihood.irradiance), start
