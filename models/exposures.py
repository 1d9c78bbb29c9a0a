"""Several exposures of one object, independent given it: as one likelihood."""

import math
import operator

import equinox as eqx
import jax
import jax.numpy as jnp

from .camera import Camera, Gaussian, Poisson, PoissonGaussian
from .likelihood import Likelihood
from .optics import Optics


class Exposures(Likelihood):
    """`count` exposures under the same optics and camera; data of shape (count, *data_shape).

    `log_prob` is the sum over the exposures, and exact. The annealed score is that of their mean as
    one longer exposure, of `count` times the electrons: exposures share the annealing error, so
    that their own annealed scores do not add up. The mean is sufficient for Gaussian noise and for
    photon counts; read noise enters by its variance, as in the likelihood of one exposure. Rounding
    by an ADC is taken to be the same in all, which errs on the wide side. A pixel saturated in some
    exposures and not in others is not told apart: samplers of the exact density see it right.

    Raises ValueError for another likelihood, another camera, and counts that are not whole.
    """

    likelihood: Likelihood
    count: int = eqx.field(static=True)
    pooled: Likelihood

    def __init__(self, likelihood: Likelihood, count: int = 2):
        if not isinstance(likelihood, Likelihood) or isinstance(likelihood, Exposures):
            raise ValueError(
                f"likelihood is a {type(likelihood).__name__}: give that of a single exposure"
            )
        try:
            self.count = operator.index(count)
        except TypeError:
            self.count = 0
        if self.count < 1:
            raise ValueError(f"count {count}: give a whole number of exposures, 1 or more")
        self.likelihood = likelihood
        longer = _longer(likelihood.camera, self.count)
        self.pooled = eqx.tree_at(
            lambda one: one.camera, likelihood, longer, is_leaf=lambda a: isinstance(a, Camera)
        )

    @property
    def optics(self) -> Optics:
        """The optics of one exposure, `count` times over."""
        return _Repeated(self.likelihood.optics, self.count)

    @property
    def linear(self) -> bool:
        """As of one exposure."""
        return self.likelihood.linear

    @property
    def camera(self) -> Camera:
        """The camera of every exposure."""
        return self.likelihood.camera

    def expected(self, x: jax.Array) -> jax.Array:
        """Expected signal of each exposure, all the same: (count, *data_shape)."""
        return jnp.broadcast_to(self.likelihood.expected(x), self.data_shape)

    def feasible(self, x: jax.Array) -> jax.Array:
        """As for one exposure."""
        return self.likelihood.feasible(x)

    def annealed_score(
        self,
        x: jax.Array,
        y: jax.Array,
        sigma: jax.Array | float,
        path: str = "convolved",
        published: bool = False,
        perturbation: str = "gaussian",
        clean: jax.Array | None = None,
    ) -> jax.Array:
        """Score of log p(mean of y | x~ = x), as of one longer exposure; shaped as the object."""
        if perturbation != "gaussian":
            # Its levels are measured by the full well of the camera, which is that of one exposure.
            raise ValueError(
                f"perturbation {perturbation!r}: several exposures need a prior with the gaussian "
                "perturbation"
            )
        mean = jnp.mean(y, axis=0)
        return self.pooled.annealed_score(x, mean, sigma, path, published, perturbation, clean)

    def noise(self, x_complex: bool, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Of the mean of the exposures, and in its shape."""
        return self.pooled.noise(x_complex, jnp.mean(y, axis=0))

    def curvature(
        self, x_complex: bool, y: jax.Array, sigma: jax.Array | float, path: str
    ) -> jax.Array:
        """Bound on the curvature of the annealed log-likelihood of their mean."""
        return self.pooled.curvature(x_complex, jnp.mean(y, axis=0), sigma, path)


class _Repeated(Optics):
    """H, `count` times over."""

    optics: Optics

    def __init__(self, optics: Optics, count: int):
        self.optics = optics
        self.in_shape, self.out_shape = optics.in_shape, (count, *optics.out_shape)
        self.real, self.symmetries = optics.real, optics.symmetries

    def _apply(self, o: jax.Array) -> jax.Array:
        return jnp.broadcast_to(self.optics(o), self.out_shape)

    def _adjoint(self, field: jax.Array) -> jax.Array:
        return self.optics.adjoint(jnp.sum(field, axis=0))

    def row_norms(self) -> jax.Array:
        """Those of H."""
        return jnp.broadcast_to(self.optics.row_norms(), self.out_shape)

    def norm_squared(self) -> jax.Array:
        """`count` times that of H."""
        return self.out_shape[0] * self.optics.norm_squared()


def _longer(camera: Camera, count: int) -> Camera:
    """The camera of the mean of `count` exposures: of their sum, in a well as many times larger."""
    if isinstance(camera, Gaussian):
        return Gaussian(camera.sigma / math.sqrt(count))
    if isinstance(camera, Poisson):
        return Poisson(camera.full_well * count, camera.bits, camera.holds * count)
    if isinstance(camera, PoissonGaussian):
        read_noise = camera.read_noise * math.sqrt(count)
        return PoissonGaussian(camera.full_well * count, read_noise, camera.bits)
    raise ValueError(
        f"camera {type(camera).__name__}: several exposures are for Gaussian, Poisson and "
        "PoissonGaussian"
    )
