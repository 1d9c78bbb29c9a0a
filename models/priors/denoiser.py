"""A network with EDM preconditioning (Karras et al. 2022): it predicts the clean image.

D(x, sigma) = m + c_skip (x - m) + c_out F(c_in (x - m), log s), with s the error's standard
deviation per channel, m and d the mean and standard deviation of the training pictures, and
c_skip = d^2/(s^2 + d^2), c_out = s d/sqrt(s^2 + d^2), c_in = 1/sqrt(s^2 + d^2): input, output and
training target of F have unit variance at every level. For the signal-dependent error, whose
standard deviation varies over the image, s is that at brightness m. For "poisson" all this is done
to the square root of the counts, whose error is sigma/2 at every brightness (Anscombe), and the
result is squared.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp

from ..annealing import component_sd
from .perturbation import check_perturbation


@dataclasses.dataclass(frozen=True)
class Statistics:
    """What a network was trained on; all that its preconditioning and its prior must know.

    `mean` and `sd` of a channel value over the training pictures; `sigma_min`, `sigma_max`: the
    trained levels; `lowest`: the least value of a picture, None if there is no such bound, and the
    positive floor of eq:true_p for "signal"; `brightness_sd`: sd of the means of training patches,
    None if it is not known, as in all weights but those of counts.
    """

    mean: float
    sd: float
    sigma_min: float
    sigma_max: float
    perturbation: str = "gaussian"
    complex_valued: bool = False
    lowest: float | None = None
    brightness_sd: float | None = None

    def __post_init__(self):
        check_perturbation(self.perturbation, self.complex_valued)
        if not 0 < self.sigma_min < self.sigma_max:
            raise ValueError(
                f"levels from {self.sigma_min} to {self.sigma_max}: they must be positive and grow"
            )
        if not (self.sd > 0 and math.isfinite(self.sd + self.mean)):
            raise ValueError(f"mean {self.mean}, sd {self.sd}: the pictures must vary")
        if self.brightness_sd is not None and not 0 < self.brightness_sd < math.inf:
            raise ValueError(
                f"brightness_sd {self.brightness_sd}: give the sd of patches' means, a positive "
                "number, or None"
            )
        if self.perturbation == "signal" and not (self.lowest and self.lowest > 0):
            raise ValueError(
                f"lowest value {self.lowest}: the signal perturbation needs a positive floor"
            )

    @property
    def root(self) -> tuple[float, float]:
        """Mean and sd of the square root of a gamma variable of this mean and sd."""
        shape = (self.mean / self.sd) ** 2
        mean = math.exp(math.lgamma(shape + 0.5) - math.lgamma(shape)) * self.sd / self.mean**0.5
        return mean, math.sqrt(self.mean - mean**2)


class Denoiser(eqx.Module):
    """The clean image, from a perturbed one (h, w, channels) and its level sigma.

    For "signal" it is the harmonic mean 1/E[1/x | x~] (perturbation.py), which does not depend on
    the sign of x~, so that the network sees |x~|; else E[x | x~]. sigma is used as it is, except
    that the network is told no level outside the trained ones.
    """

    network: eqx.Module
    statistics: Statistics = eqx.field(static=True)

    def __call__(self, x: jax.Array, sigma: jax.Array) -> jax.Array:
        """(h, w, channels) -> the same shape."""
        stats = self.statistics
        if stats.perturbation == "poisson":
            # Three eighths of a count make the error of the root uniform down to a few counts.
            root = jnp.sqrt(x + 0.375 * sigma**2)
            return jnp.square(self._preconditioned(root, sigma, *stats.root))
        folded = jnp.abs(x) if stats.perturbation == "signal" else x
        clean = self._preconditioned(folded, sigma, stats.mean, stats.sd)
        return jnp.maximum(clean, stats.lowest) if stats.perturbation == "signal" else clean

    def bottleneck(self, x: jax.Array, sigma: jax.Array) -> jax.Array:
        """What a U-Net makes of (h, w, channels) at its coarsest level (h', w', features).

        For the "gaussian" error; the picture `x` is taken for one that has it at `sigma`.
        """
        stats = self.statistics
        return self.network.bottleneck(*self._as_input(x, sigma, stats.mean, stats.sd))

    def _preconditioned(self, x: jax.Array, sigma: jax.Array, mean: float, sd: float) -> jax.Array:
        s, variance = self.channel_sd(sigma), sd**2
        total = s**2 + variance
        centred = x - mean
        raw = self.network(*self._as_input(x, sigma, mean, sd)).astype(x.dtype)
        return mean + variance / total * centred + s * sd / jnp.sqrt(total) * raw

    def _as_input(
        self, x: jax.Array, sigma: jax.Array, mean: float, sd: float
    ) -> tuple[jax.Array, jax.Array]:
        """Of unit variance, and the log of the nearest trained level."""
        stats = self.statistics
        trained = jnp.clip(sigma, stats.sigma_min, stats.sigma_max)
        level = jnp.log(self.channel_sd(trained) / sd)
        return (x - mean) / jnp.sqrt(self.channel_sd(sigma) ** 2 + sd**2), level

    def loss_weight(self, sigma: jax.Array) -> jax.Array:
        """1/c_out^2: every level counts alike in the loss."""
        s, variance = self.channel_sd(sigma), self.channel_spread**2
        weight = (s**2 + variance) / (s**2 * variance)
        return weight * self.statistics.mean if self.statistics.perturbation == "signal" else weight

    @property
    def channel_spread(self) -> float:
        """Standard deviation of the clean channels, or of their roots for "poisson"."""
        stats = self.statistics
        return stats.root[1] if stats.perturbation == "poisson" else stats.sd

    def channel_sd(self, sigma: jax.Array | float) -> jax.Array:
        """Standard deviation of the error per channel: at brightness `mean` for "signal", of the
        square root for "poisson".
        """
        stats = self.statistics
        if stats.perturbation == "poisson":
            return sigma / 2
        if stats.perturbation == "signal":
            return sigma * stats.mean**0.5
        return component_sd(sigma, stats.complex_valued)
