"""Priors learnt from pictures: a score network, or the gradient of an energy network.

Both hold a denoiser D(x~, sigma). `ScorePrior` reads the score off it; nothing makes that a
gradient, so there is no density. `EnergyPrior` takes D as the argument of an energy,

    E(x~, sigma) = sum (x~ - D)^2 / (2 s^2),
    E(z, sigma)  = sum (z - D)^2 / (2 sigma^2 D) - log(1 + exp(-2 z/sigma^2))   for "signal",

and -E as the log-density of the annealed variable, up to a constant at each level: its score is
the gradient of that number, exactly, and costs a backward pass. Such a D is trained through the
gradient and is itself no denoiser; `denoise` gives the estimate either way.

Outside the trained levels: below the finest, sigma is held at it, so that sigma = 0 means the prior
blurred by the finest level; above the broadest, the error's variance stays right and the network
sees an ever fainter picture, which is right while sigma_max is large against the pictures' range.
"""

import abc
import os
from typing import ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..annealing import component_sd
from ..realview import normal_like, real_size
from ..thinning import thickened
from .base import Prior, checked_shape
from .denoiser import Denoiser, Statistics
from .layers import frozen, mean_pool
from .mixture import GaussianMixture
from .perturbation import folded_energy, refuse_counts, score_from_denoised

_APART = 4  # pixels, of those that `EnergyPrior.channel_clean` asks together
_AROUND = 5  # pixels, the side of a neighbourhood


class LearnedPrior(Prior):
    """What score and energy priors share. Objects: (h, w), or (h, w, 3) in colour.

    A complex object (h, w) is two channels to the network. `shape` must suit the network: its
    strides and its channels. Computes in the dtype of the weights, returns that of the object.
    For "signal" the annealed variable is folded (perturbation.py): it is not negative, and a score
    asked for at x < 0 is that at |x| with its sign turned.
    """

    kind: eqx.AbstractClassVar[str]
    denoiser: Denoiser
    shape: tuple[int, ...] = eqx.field(static=True)
    complex_valued: bool = eqx.field(static=True)
    perturbation: str = eqx.field(static=True)
    sampling_steps: int = eqx.field(static=True)

    def __init__(self, denoiser: Denoiser, shape: tuple[int, ...], sampling_steps: int = 40):
        self.denoiser = frozen(denoiser)
        self.shape = suited_shape(shape, denoiser)
        self.complex_valued = denoiser.statistics.complex_valued
        self.perturbation = denoiser.statistics.perturbation
        self.sampling_steps = sampling_steps

    @classmethod
    def load(
        cls,
        name: str | os.PathLike,
        shape: tuple[int, ...],
        perturbation: str = "gaussian",
        dtype: type | None = None,
        sampling_steps: int = 40,
    ) -> Self:
        """Weights by their short name ("nuclei"), the path of a .safetensors file, or what it
        begins with, before "-gaussian-score.safetensors" and the like.

        `perturbation` and `dtype` (float or complex; None: what the weights are for) are what the
        problem asks for; `sampling_steps`: the levels of `sample`. Raises ValueError if the file or
        its card is damaged or not for that.
        """
        from .storage import load_denoiser

        return cls(load_denoiser(name, cls.kind, perturbation, dtype), shape, sampling_steps)

    @property
    def statistics(self) -> Statistics:
        """Mean, sd and least value of the training pictures; the trained levels."""
        return self.denoiser.statistics

    @property
    def scale(self) -> jax.Array:
        """Standard deviation of a channel value over the training pictures."""
        return jnp.asarray(self.statistics.sd)

    @property
    def finest(self) -> float:
        """The finest trained level."""
        return self.statistics.sigma_min

    @property
    def stiffness(self) -> float:
        """The precision of the finest trained level, which no curvature exceeds."""
        return 1 / self._component_sd(self.finest) ** 2

    @abc.abstractmethod
    def channel_score(self, x: jax.Array, sigma: jax.Array) -> jax.Array:
        """Score of channels (h, w, c) at a level at or above the finest."""

    @abc.abstractmethod
    def channel_clean(self, x: jax.Array, sigma: jax.Array) -> jax.Array:
        """`denoise` for channels (h, w, c) at a level at or above the finest."""

    def score(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Gradient of the log-density of the annealed variable, as an object: d/dRe + j d/dIm."""
        refuse_counts(self.perturbation)
        channels, sigma = self._prepared(x, sigma)
        return self._to_object_like(self.channel_score(channels, sigma), x)

    def denoise(self, x: jax.Array, sigma: jax.Array | float) -> jax.Array:
        """E[object | annealed x]; `shape`, dtype of `x`.

        Of counts, x = sigma^2 N, the finest trained level is as fine as it knows. For "signal" the
        harmonic mean 1/E[1/object | x], which is what the score holds.
        """
        channels, sigma = self._prepared(x, sigma)
        return self._to_object_like(self.channel_clean(channels, sigma), x)

    def sample(self, key: jax.Array) -> jax.Array:
        """One object from the network alone, by `sampling_steps` levels from noise to picture.

        Heun's rule on the probability flow (Karras et al. 2022), then one denoising step at the
        finest level. An approximation: the network, the finite steps, a start that is pure noise.
        For "poisson" by thickening (models/thinning.py) from a few counts in the whole picture, as
        if of an even light, whose brightness varies as that of the pictures.
        Never below the pictures' least value. For "signal" no more than a look at the network: the
        harmonic mean stands in for the mean, and draws come out far too dark.
        """
        draw = _thickened_draw if self.perturbation == "poisson" else _flow_draw
        return self._allowed(draw(self, key))

    def start(self, key: jax.Array) -> jax.Array:
        """Independent normal channels of the pictures' mean and sd, none below their least value.

        Costs no evaluation of the network, where `sample` costs 2 `sampling_steps` - 1 of them; as
        dispersed as the pictures are, but nothing like one.
        """
        return self._allowed(self._noise_about_mean(key, self.statistics.sd))

    def tempering_base(self) -> GaussianMixture:
        """Independent normal channels of the pictures' mean and sd: the network's draws are not of
        its density.

        Raises ValueError for "signal", whose density has an edge at zero that no normal keeps.
        """
        if self.perturbation == "signal":
            raise ValueError(
                "no tempering under a prior of the signal-dependent error, which forbids negative "
                "values: use MALA, or a prior of the gaussian perturbation"
            )
        n, sd = real_size(self.shape, self.dtype), self.statistics.sd
        mean = np.full((1, n), self.statistics.mean)
        return GaussianMixture([1.0], mean, np.array([sd**2]), self.shape, self.dtype.type)

    def _noise_about_mean(self, key: jax.Array, sd: jax.Array | float) -> jax.Array:
        blank = jnp.zeros(self.shape, self.dtype)
        mean = self.statistics.mean * (1 + 1j if self.complex_valued else 1)
        return (mean + sd * normal_like(key, blank)).astype(blank.dtype)

    def _allowed(self, x: jax.Array) -> jax.Array:
        return x if self.statistics.lowest is None else jnp.maximum(x, self.statistics.lowest)

    def _prepared(self, x: jax.Array, sigma: jax.Array | float) -> tuple[jax.Array, jax.Array]:
        self._to_vector(x)
        if self.complex_valued:
            channels = jnp.stack([x.real, x.imag], axis=-1)
        else:
            channels = x if len(self.shape) == 3 else x[..., None]
        dtype = jax.tree.leaves(eqx.filter(self.denoiser, eqx.is_inexact_array))[0].dtype
        sigma = jnp.maximum(jnp.asarray(sigma, dtype), self.statistics.sigma_min)
        return channels.astype(dtype), sigma

    def _to_object_like(self, channels: jax.Array, x: jax.Array) -> jax.Array:
        channels = channels.astype(x.real.dtype)
        if self.complex_valued:
            return jax.lax.complex(channels[..., 0], channels[..., 1])
        return channels.reshape(self.shape)


class ScorePrior(LearnedPrior):
    """A prior known by its score network alone: draws and a score, no density.

    `ScorePrior.load("nuclei", (64, 64))` gives one that comes with the project. The score is
    (D - x)/s^2, s the error's standard deviation per real component (eq:denoiser_complex), or
    (tanh(x/sigma^2) - x/D)/sigma^2 for the signal-dependent error (eq:true_p, folded). Of counts
    there is the denoiser D alone, which Thickening takes. Raises ValueError if `shape` does not
    suit the network.
    """

    kind: ClassVar[str] = "score"

    def channel_clean(self, x: jax.Array, sigma: jax.Array) -> jax.Array:
        """What the network says."""
        return self.denoiser(x, sigma)

    def channel_score(self, x: jax.Array, sigma: jax.Array) -> jax.Array:
        """Score of channels (h, w, c) at a level at or above the finest."""
        clean = self.denoiser(x, sigma)
        return score_from_denoised(x, clean, sigma, self.perturbation, self.complex_valued)

    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Refuses: a score network has no density."""
        refuse_counts(self.perturbation)
        raise ValueError(
            "a ScorePrior has no density: use a sampler that needs the score alone "
            "(AnnealedLangevin, ULA, MALA with nodes=4), or an EnergyPrior"
        )


class EnergyPrior(LearnedPrior):
    """A prior known by an energy network: draws, a score, and a log-density up to a constant.

    The constant depends on the level, so only differences at one sigma mean anything. The score is
    the exact gradient of `log_prob`: MALA, NUTS, TemperedSMC and Ensemble are exact for the density
    that the network defines. `EnergyPrior.load("nuclei", (64, 64))` gives one that comes with the
    project. Raises ValueError if `shape` does not suit the network.
    """

    kind: ClassVar[str] = "energy"

    def __check_init__(self):
        if self.perturbation == "poisson":
            raise ValueError("counts have no density: load these weights as a ScorePrior")

    def channel_clean(self, x: jax.Array, sigma: jax.Array) -> jax.Array:
        """From the score, by Tweedie's formula; for "signal" by 16 evaluations of it.

        The harmonic mean D is in that score as z/D, which says little of it where z is far below D.
        But D hardly depends on its own pixel's z: each pixel is asked with its z raised to what
        Lee's filter makes of it (IEEE Trans. PAMI 2, 165, 1980), a sixteenth of them at a time, far
        enough apart that the others see no brighter picture. An approximation, measured in
        test_learned.py.
        """
        if self.perturbation == "gaussian":
            return x + self._component_sd(sigma) ** 2 * self.channel_score(x, sigma)
        z = jnp.abs(x)
        mean = mean_pool(z, _AROUND, 1)
        variance = mean_pool(jnp.square(z - mean), _AROUND, 1) + jnp.finfo(z.dtype).tiny
        noise = jnp.minimum(sigma**2 * mean / variance, 1.0)
        raised_to = jnp.maximum(z, z + noise * (mean - z))
        rows, columns = (jnp.arange(n) % _APART for n in z.shape[:2])

        def asked(place: jax.Array, clean: jax.Array) -> jax.Array:
            row, column = jnp.divmod(place, _APART)
            raised = ((rows == row)[:, None] & (columns == column))[..., None]
            found = self.harmonic_mean(jnp.where(raised, raised_to, z), sigma)
            return jnp.where(raised, found, clean)

        return jax.lax.fori_loop(0, _APART**2, asked, z)

    def harmonic_mean(self, z: jax.Array, sigma: jax.Array) -> jax.Array:
        """D as the score at channels z >= 0 has it, (tanh(z/sigma^2) - z/D)/sigma^2.

        Where z is far below D it is mostly the score's error.
        """
        z = jnp.maximum(z, 0.01 * self.statistics.lowest)
        inverse = (jnp.tanh(z / sigma**2) - sigma**2 * self.channel_score(z, sigma)) / z
        # What leaves no D between the least value and 1 is noise.
        return 1 / jnp.clip(inverse, 1.0, 1 / self.statistics.lowest)

    def channel_score(self, x: jax.Array, sigma: jax.Array) -> jax.Array:
        """Minus the gradient of the energy."""
        return -jax.grad(energy, argnums=1)(self.denoiser, x, sigma)

    def log_prob(self, x: jax.Array, sigma: jax.Array | float = 0.0) -> jax.Array:
        """Log-density of the annealed variable at `x`, up to a constant that depends on sigma.

        -inf if any value is negative for "signal".
        """
        channels, sigma = self._prepared(x, sigma)
        value = -energy(self.denoiser, channels, sigma).astype(x.real.dtype)
        if self.perturbation == "gaussian":
            return value
        return jnp.where(jnp.any(channels < 0), -jnp.inf, value)


def energy(denoiser: Denoiser, x: jax.Array, sigma: jax.Array) -> jax.Array:
    """Half the squared residual of the denoiser over the error's variance, folded for "signal".

    A scalar: -log p(x | clean) up to terms without x, at what the denoiser says of the clean one.
    """
    stats, clean = denoiser.statistics, denoiser(x, sigma)
    if stats.perturbation == "signal":
        return jnp.sum(folded_energy(x, clean, sigma))
    variance = component_sd(sigma, stats.complex_valued) ** 2
    return jnp.sum(jnp.square(x - clean) / (2 * variance))


def suited_shape(shape: tuple[int, ...], denoiser: Denoiser) -> tuple[int, ...]:
    """The object shape, refused if the network's channels or strides do not allow it."""
    shape = checked_shape(shape)
    network, complex_valued = denoiser.network, denoiser.statistics.complex_valued
    if len(shape) not in (2, 3) or (len(shape) == 3 and complex_valued):
        raise ValueError(f"object shape {shape}: this prior is for (height, width) images")
    channels = 2 if complex_valued else 1 if len(shape) == 2 else shape[2]
    if channels != network.channels:
        raise ValueError(
            f"object shape {shape} has {channels} channels, the network {network.channels}: "
            "give (height, width) to a grey prior, (height, width, 3) to one in colour"
        )
    if any(n % network.stride for n in shape[:2]):
        raise ValueError(
            f"object shape {shape}: this network needs sides that are multiples of {network.stride}"
        )
    return shape


def _flow_draw(prior: LearnedPrior, key: jax.Array) -> jax.Array:
    """Heun's rule along dx/dsigma = (x - E[object | x])/sigma, from noise to the finest level.

    x~ = x + sigma (error at sigma = 1) moves at that velocity on average, whatever the error's
    variance depends on, so the flow has the right distribution at every level. Folded, |x~| moves
    at (z - tanh(z/sigma^2) E[object | z])/sigma, the sign of x~ having the mean tanh(z/sigma^2):
    zero at z = 0, so that only finite steps cross it; they are reflected. For "signal" D stands in
    for the mean, which it is below.
    """
    stats = prior.statistics
    # Karras et al.'s spacing: powers of 1/7, dense at the fine levels.
    ends = stats.sigma_max ** (1 / 7), stats.sigma_min ** (1 / 7)
    sigmas = jnp.linspace(*ends, prior.sampling_steps) ** 7
    signal = prior.perturbation == "signal"
    x = prior._noise_about_mean(key, prior.denoiser.channel_sd(sigmas[0]))

    def slope(x: jax.Array, sigma: jax.Array) -> jax.Array:
        mean = prior.denoise(x, sigma)
        return (x - (jnp.tanh(x / sigma**2) * mean if signal else mean)) / sigma

    def advance(x: jax.Array, pair: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        sigma, following = pair
        step = following - sigma
        first = slope(x, sigma)
        second = slope(x + (step * first).astype(x.dtype), following)
        x = x + (step * (first + second) / 2).astype(x.dtype)
        return jnp.abs(x) if signal else x, None

    x, _ = jax.lax.scan(advance, jnp.abs(x) if signal else x, (sigmas[:-1], sigmas[1:]))
    return prior.denoise(x, sigmas[-1])


def _thickened_draw(prior: LearnedPrior, key: jax.Array) -> jax.Array:
    """From the broadest level, whose few counts are as if of an even light, to the finest."""
    stats = prior.statistics
    key_light, key_first, key_more = jax.random.split(key, 3)
    ends = stats.sigma_max, stats.sigma_min
    sigmas = jnp.geomspace(*ends, prior.sampling_steps).astype(prior.dtype)
    light = _even_light(key_light, stats)
    few = jax.random.poisson(key_first, light / stats.sigma_max**2, prior.shape)
    return thickened(key_more, prior.denoise, few.astype(prior.dtype), sigmas)


def _even_light(key: jax.Array, stats: Statistics) -> jax.Array | float:
    """A brightness of the pictures' mean, and of their spread if that is known: gamma.

    How many the first counts are tells how bright a picture is, so that of one brightness alone
    they leave the brightest and the darkest pictures out.
    """
    if stats.brightness_sd is None:
        return stats.mean
    variance = stats.brightness_sd**2
    return jax.random.gamma(key, stats.mean**2 / variance) * variance / stats.mean
