"""What every prior offers: draws, a log-density and a score, at every annealing level."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..annealing import component_sd, tweedie
from ..realview import from_real, is_complex, real_score, to_real


class Prior(eqx.Module):
    """A distribution over objects of one shape and kind (real or complex).

    `log_prob` and `score` take an annealing level `sigma` and refer to the annealed variable, whose
    meaning `perturbation` names (models/annealing.py): "gaussian" adds a normal error of standard
    deviation sigma to a real object and sigma/2 to each of Re and Im of a complex one
    (eq:part_complex); "signal" adds sqrt(x) times a normal error (eq:defining_x_tilde) and takes
    the modulus, so that the annealed variable is not negative. Of "poisson", the counts of an
    exposure of 1/sigma^2, there is no score, and `denoise` alone. sigma = 0 is the prior itself.
    """

    shape: eqx.AbstractVar[tuple[int, ...]]
    complex_valued: eqx.AbstractVar[bool]
    perturbation: eqx.AbstractVar[str]

    @property
    def dtype(self) -> np.dtype:
        """Dtype of the objects, at the precision that is switched on."""
        return jax.dtypes.canonicalize_dtype(complex if self.complex_valued else float)

    @property
    @abc.abstractmethod
    def scale(self) -> jax.Array:
        """Root mean square, per real component, of the object about its mean."""

    @property
    def finest(self) -> float:
        """Annealing level below which the score does not change: 0 unless it was learnt."""
        return 0.0

    @property
    def stiffness(self) -> jax.Array | float:
        """Largest curvature of the log-density, in the object's units^-2: a bound on steps.

        Exact for Gaussians; of others it is that at one draw, an approximation, by the whole
        Hessian: for few unknowns.
        """

        def log_prob(v: jax.Array) -> jax.Array:
            return self.log_prob(self._to_object(v))

        at = self._to_vector(self.sample(jax.random.key(0)))
        return jnp.maximum(jnp.linalg.eigvalsh(-jax.hessian(log_prob)(at))[-1], 0.0)

    @abc.abstractmethod
    def sample(self, key: jax.Array) -> jax.Array:
        """One object: `shape`, `dtype`."""

    def start(self, key: jax.Array) -> jax.Array:
        """A dispersed place to start a chain, `shape`, `dtype`: a draw, unless draws are dear."""
        return self.sample(key)

    def tempering_base(self) -> "Prior":
        """Where tempering begins: what is drawn exactly by `sample`; this prior, if it is."""
        return self

    @abc.abstractmethod
    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Log-density of the annealed variable at `x` (`shape`), normalised; a real scalar."""

    def score(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Gradient of `log_prob` in the real view, as an object: d/dRe + j d/dIm."""
        return real_score(jax.grad(self.log_prob)(x, sigma))

    def denoise(self, x: jax.Array, sigma: jax.Array | float) -> jax.Array:
        """E[object | annealed x] at level `sigma`, by Tweedie's formula x + s^2 score.

        `shape`, dtype of `x`. For the gaussian perturbation: raises ValueError for another, unless
        the prior knows better.
        """
        if self.perturbation != "gaussian":
            raise ValueError(
                f"the prior has the {self.perturbation!r} perturbation: Tweedie's formula is for "
                "the gaussian one"
            )
        return tweedie(x, self.score(x, sigma), sigma)

    def _component_sd(self, sigma: jax.Array | float) -> jax.Array | float:
        """Standard deviation of the annealing error per real component (eq:part_complex)."""
        return component_sd(sigma, self.complex_valued)

    def _to_object(self, v: jax.Array) -> jax.Array:
        return from_real(v, self.shape, self.dtype)

    def _to_vector(self, x: jax.Array) -> jax.Array:
        """Real view of an object of this prior's kind; refuses the other kind."""
        if x.shape != self.shape:
            raise ValueError(f"object of shape {x.shape}: this prior is for {self.shape}")
        if jnp.iscomplexobj(x) and not self.complex_valued:
            raise ValueError(
                "complex object, but this prior is for real ones: "
                "take the real part, or build the prior with dtype=complex"
            )
        if self.complex_valued and not jnp.iscomplexobj(x):
            x = x.astype(self.dtype)
        return to_real(x)


def check_finite(**arrays: np.ndarray) -> None:
    """Refuse NaN or infinity in a named parameter."""
    for name, value in arrays.items():
        if not np.all(np.isfinite(np.asarray(value))):
            raise ValueError(f"{name} holds NaN or infinity: every entry must be finite")


def checked_shape(shape: tuple[int, ...] | int) -> tuple[int, ...]:
    """The object shape as a tuple of positive ints."""
    shape = (shape,) if np.ndim(shape) == 0 else shape
    shape = tuple(int(n) for n in shape)
    if any(n <= 0 for n in shape):
        raise ValueError(f"object shape {shape}: every side must be positive")
    return shape


def is_complex_kind(dtype: object) -> bool:
    """Whether `dtype` (a type, a dtype or its name) asks for complex objects."""
    return is_complex(np.dtype(dtype))
