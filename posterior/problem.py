"""An imaging problem, and the posterior it has once data are recorded."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .models.annealing import component_sd, remaining_variance, tweedie
from .models.likelihood import Likelihood
from .models.priors.base import Prior
from .models.priors.learned import LearnedPrior

# No picture of a learnt prior is brighter than its mean by so many standard deviations; and data
# that are so many times brighter yet are in other units.
_BRIGHTEST_SD, _OTHER_UNITS = 4, 3


class Problem(eqx.Module):
    """A likelihood and a prior: everything that is known before the data.

    Raises ValueError if the two are for objects of different shape or kind.
    """

    likelihood: Likelihood
    prior: Prior

    def __check_init__(self):
        for name, part, kind in (
            ("likelihood", self.likelihood, Likelihood),
            ("prior", self.prior, Prior),
        ):
            if not isinstance(part, kind):
                raise ValueError(f"{name} is a {type(part).__name__}: give a {kind.__name__}")
        if self.prior.shape != self.likelihood.object_shape:
            raise ValueError(
                f"the prior is for objects of shape {self.prior.shape}, "
                f"the optics for {self.likelihood.object_shape}: build both for one shape"
            )
        # A trial trace finds what the parts refuse together, before any work is done.
        x = jax.ShapeDtypeStruct(self.prior.shape, self.prior.dtype)
        y = jax.eval_shape(self.likelihood.expected, x)
        if self.prior.perturbation == "poisson":
            return  # counts have no score to anneal: samplers check the rest
        jax.eval_shape(
            lambda x, y: self.likelihood.annealed_score(
                x, y, 0.0, perturbation=self.prior.perturbation
            ),
            x,
            y,
        )

    def simulate(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """One draw (x, y) of the joint distribution: an object of the prior, and its recording."""
        key_object, key_recording = jax.random.split(key)
        x = self.prior.sample(key_object)
        return x, self.likelihood.simulate(key_recording, x)

    def condition(self, y: jax.Array) -> "Posterior":
        """The posterior given the recording `y` (normalised: electrons / full well).

        Raises ValueError with one sentence if `y` cannot be such a recording: wrong shape, NaN,
        negative, above the full well, integer codes, in other units than a learnt prior. Inside
        `jax.jit` only the shape is checked.
        """
        if not isinstance(y, jax.core.Tracer):
            y = np.asarray(y)
        if y.shape != self.likelihood.data_shape:
            raise ValueError(
                f"data of shape {y.shape}: these optics record {self.likelihood.data_shape}"
            )
        if not isinstance(y, jax.core.Tracer):
            self.likelihood.camera.check(y)
            self._refuse_other_units(y)
            kind = complex if np.iscomplexobj(y) else float
            y = jnp.asarray(y, jax.dtypes.canonicalize_dtype(kind))
        # Numbers among the parts become arrays: they are carried through compiled loops.
        return jax.tree.map(jnp.asarray, Posterior(self.likelihood, self.prior, y))

    def _refuse_other_units(self, y: np.ndarray) -> None:
        """Refuse data far brighter than any picture of a learnt prior: of 0..255, its own 0..1.

        Of linear optics before a camera without a full well: one with it bounds the data itself.
        """
        prior, likelihood = self.prior, self.likelihood
        if not isinstance(prior, LearnedPrior) or not likelihood.linear:
            return
        if likelihood.camera.counting:
            return
        statistics = prior.statistics
        brightest = abs(statistics.mean) + _BRIGHTEST_SD * statistics.sd
        gain = float(likelihood.optics.norm_squared()) * math.prod(prior.shape) / y.size
        found = math.sqrt(float(np.mean(np.abs(y) ** 2)))
        allowed = math.hypot(
            _OTHER_UNITS * brightest * math.sqrt(gain), 3 * likelihood.camera.sigma
        )
        if found > allowed:
            raise ValueError(
                f"the data have a root mean square of {found:.3g}, and pictures of this prior "
                f"(mean {statistics.mean:.3g}, sd {statistics.sd:.3g}) give {allowed:.3g} at most: "
                "divide data and noise by their full scale"
            )


class Posterior(eqx.Module):
    """p(x | y): what samplers see.

    An object x has shape `shape` and dtype `dtype`; scores are gradients in its real view,
    d/dRe + j d/dIm for complex objects.
    """

    likelihood: Likelihood
    prior: Prior
    y: jax.Array

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the object."""
        return self.prior.shape

    @property
    def dtype(self) -> np.dtype:
        """Dtype of the object."""
        return self.prior.dtype

    def log_prior(self, x: jax.Array) -> jax.Array:
        """Log-density of the prior."""
        return self.prior.log_prob(x)

    def log_likelihood(self, x: jax.Array) -> jax.Array:
        """Exact log-probability of the recording given x."""
        return self.likelihood.log_prob(x, self.y)

    def log_prob(self, x: jax.Array) -> jax.Array:
        """Log-density up to a constant, with the exact likelihood of what was recorded."""
        return self.log_likelihood(x) + self.log_prior(x)

    def score(self, x: jax.Array) -> jax.Array:
        """Gradient of `log_prob`."""
        return self.likelihood.score(x, self.y) + self.prior.score(x)

    def log_prob_and_score(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Both, sharing one pass through the optics."""
        value, score = self.likelihood.log_prob_and_score(x, self.y)
        return value + self.prior.log_prob(x), score + self.prior.score(x)

    def annealed_score(
        self,
        x: jax.Array,
        sigma: jax.Array | float,
        path: str = "convolved",
        published: bool = False,
    ) -> jax.Array:
        """Score of the annealed variable at level `sigma` (models/annealing.py).

        `published=True` is the paper's printed form for complex objects: eq:complex_final, beside a
        prior score of eq:grad_o scaled by sigma^2 where its error has variance sigma^2/4.
        """
        prior = self.prior.score(x, sigma)
        clean = None
        if self.prior.perturbation == "gaussian":
            clean = tweedie(x, prior, sigma)
        likelihood = self.likelihood.annealed_score(
            x, self.y, sigma, path, published, self.prior.perturbation, clean
        )
        return likelihood + (prior / 4 if published and self._complex else prior)

    def annealing_range(self, path: str) -> tuple[jax.Array, jax.Array]:
        """Broadest and finest annealing level: from the prior's scale, or the noise, to 1 % of it.

        The finest is 1 % of the level at which the annealing error equals the measurement noise, or
        the finest that a learned prior knows; "split" starts just under the noise, "convolved" at
        the prior's own scale.
        """
        if self.prior.perturbation == "signal":
            noise_level = jnp.asarray(self.likelihood.camera.sigma0)
        else:
            noise, gain = self.likelihood.noise(self._complex, self.y)
            noise_level = jnp.sqrt(jnp.min(noise / gain))
        finest = jnp.maximum(0.01 * noise_level, self.prior.finest)
        if path == "split":
            return 0.99 * noise_level, finest
        scale = self.prior.scale * (2 if self._complex else 1)
        if self.prior.perturbation == "signal":
            scale = scale / jnp.sqrt(jnp.mean(self.y))
        return jnp.maximum(scale, noise_level), finest

    def data_level(self) -> jax.Array:
        """Annealing level at which the error is as large as the noise where the data say most."""
        curvature = self.likelihood.curvature(self._complex, self.y, 0.0, "convolved")
        return (2 if self._complex else 1) / jnp.sqrt(jnp.max(curvature))

    def annealing_variance(self, sigma: jax.Array | float, path: str) -> jax.Array:
        """The smaller of the level's variance and the likelihood's own, harmonically joined.

        What a Langevin step at this level may be measured by; a scalar, or one value a pixel. For
        the signal perturbation, whose variance is sigma^2 x, that of the root sqrt(x).
        """
        level = jnp.asarray(component_sd(sigma, self._complex)) ** 2
        if self.prior.perturbation == "signal":
            noise = jnp.asarray(self.likelihood.camera.sigma0**2)
            return 0.25 / (1 / level + 1 / remaining_variance(noise, level, path))
        return 1 / (1 / level + self.likelihood.curvature(self._complex, self.y, sigma, path))

    def start(self, key: jax.Array) -> jax.Array:
        """A dispersed place to start a chain: the prior's, where the data do not exclude it."""
        return self.likelihood.feasible(self.prior.start(key))

    @property
    def positive(self) -> bool:
        """Whether the annealed variable lives on the positive line (signal perturbation)."""
        return self.prior.perturbation == "signal"

    @property
    def _complex(self) -> bool:
        return self.prior.complex_valued
