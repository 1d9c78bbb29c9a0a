"""Stand-ins for trained networks whose denoiser is known in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp

from posterior.models.priors.denoiser import Denoiser, Statistics


class WienerNetwork(eqx.Module):
    """Exact for independent normal pixels of the statistics' mean and sd: the raw output is 0."""

    scale: jax.Array
    channels: int = eqx.field(static=True, default=1)
    stride: int = eqx.field(static=True, default=1)

    def __call__(self, x, log_level):
        return 0.0 * self.scale * x


class WienerEnergyNetwork(WienerNetwork):
    """The same through the energy: x - D must be s (x - m)/sqrt(s^2 + d^2)."""

    def __call__(self, x, log_level):
        ratio = jnp.exp(log_level)
        return self.scale * (ratio - jnp.sqrt(ratio**2 + 1)) * x


def wiener(kind="score", complex_valued=False, mean=0.3, sd=0.25, dtype="float64", **levels):
    """A denoiser that is exact for independent normal pixels."""
    network = WienerNetwork if kind == "score" else WienerEnergyNetwork
    levels = {"sigma_min": 1e-3, "sigma_max": 20.0} | levels
    statistics = Statistics(mean, sd, complex_valued=complex_valued, **levels)
    return Denoiser(network(jnp.ones((), dtype), 2 if complex_valued else 1), statistics)
