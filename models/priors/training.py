"""Denoising score matching: the loss, and steps of Adam.

The state holds everything: a run that stops and goes on from a saved state gives the same weights,
bit for bit, as one that never stopped. The randomness of step n is `fold_in(key of the seed, n)`.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from .denoiser import Denoiser
from .layers import in_precision
from .learned import energy
from .losses import CoarseErrors, count_loss, denoising_loss, signal_score_loss
from .perturbation import perturbed
from .pictures import SYMMETRIES, Pictures

KINDS = ("score", "energy")
PRECISIONS = ("float32", "bfloat16")

# The share of training levels that is spread evenly over all of them; the rest is near the level
# of the picture's own contrast times _CENTRE, where denoising is hardest to learn.
_EVEN, _CENTRE, _SPREAD = 0.1, 0.4, 1.2


@dataclasses.dataclass(frozen=True)
class Recipe:
    """All that decides a training beside the pictures and the network's start.

    `size`: patch side in pixels; `rate`: Adam's, warmed up and brought to zero along a cosine;
    `average`: decay of the moving average of the weights that is kept; `clip`: largest norm of a
    gradient; `symmetry`: what a patch may be turned by, one of `SYMMETRIES`; `precision`: of the
    network's convolutions, one of `PRECISIONS`. Weights, their average, the loss and Adam are
    float32 either way; bfloat16 pays on accelerators that have units for it. `averages`: weight of
    errors of averages beside those of pixels (`block_errors`); `areas`: of averages over pixels
    that are equally bright (`equally_bright_errors`).
    """

    kind: str = "score"
    steps: int = 5000
    batch: int = 16
    size: int = 48
    rate: float = 2e-3
    average: float = 0.998
    clip: float = 1.0
    seed: int = 0
    symmetry: str = "square"
    precision: str = "float32"
    averages: float = 0.0
    areas: float = 0.0

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"unknown kind {self.kind!r}: use {' or '.join(KINDS)}")
        if self.symmetry not in SYMMETRIES:
            known = ", ".join(SYMMETRIES)
            raise ValueError(f"unknown symmetry {self.symmetry!r}: use one of {known}")
        if self.precision not in PRECISIONS:
            raise ValueError(f"unknown precision {self.precision!r}: use {' or '.join(PRECISIONS)}")
        for name in ("steps", "batch", "size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} {getattr(self, name)}: give 1 or more")
        for name, usual in (("averages", 0.004), ("areas", 0.008)):
            weight = getattr(self, name)
            if not 0 <= weight <= 1:
                raise ValueError(f"{name} {weight}: give a weight from 0 to 1, as {usual}")
        if not (self.rate > 0 and self.clip > 0 and 0 <= self.average < 1):
            raise ValueError(
                f"rate {self.rate}, clip {self.clip}, average {self.average}: rate and clip must "
                "be positive, average between 0 and 1"
            )

    def check(self, perturbation: str) -> None:
        """Raise ValueError if weights for that error cannot be trained so."""
        for name in ("averages", "areas"):
            if getattr(self, name) and perturbation == "signal":
                raise ValueError(
                    f"{name} {getattr(self, name)}: of the signal-dependent error a network learns "
                    "a harmonic mean, which errors of averages would move; leave it out"
                )

    def optimiser(self) -> optax.GradientTransformation:
        """Clipped Adam under a cosine schedule, which counts steps inside its own state."""
        warmup = min(200, max(1, self.steps // 20))
        schedule = optax.warmup_cosine_decay_schedule(0.0, self.rate, warmup, self.steps + 1)
        return optax.chain(optax.clip_by_global_norm(self.clip), optax.adam(schedule))


class TrainingState(NamedTuple):
    """Weights, their moving average, the optimiser's state, and the steps done."""

    weights: Denoiser
    average: Denoiser
    optimiser: optax.OptState
    step: jax.Array


def start_training(denoiser: Denoiser, recipe: Recipe) -> TrainingState:
    """State before the first step, from a denoiser fresh or trained before.

    Raises ValueError as `Recipe.check`.
    """
    recipe.check(denoiser.statistics.perturbation)
    weights = eqx.filter(denoiser, eqx.is_inexact_array)
    optimiser = recipe.optimiser().init(weights)
    return TrainingState(weights, weights, optimiser, jnp.zeros((), jnp.int32))


# The recipe and the network's structure are static; no Python number is traced, so that one
# compilation serves the whole run.
@eqx.filter_jit
def train_steps(
    fixed: tuple[Denoiser, Pictures, Recipe], state: TrainingState, steps: int
) -> tuple[TrainingState, jax.Array]:
    """`steps` steps, and their losses (steps,). `fixed`: structure, pictures, recipe."""
    structure, pictures, recipe = fixed
    structure = eqx.filter(structure, eqx.is_inexact_array, inverse=True)
    optimiser = recipe.optimiser()
    key = jax.random.key(recipe.seed)

    def step(state: TrainingState, _: None) -> tuple[TrainingState, jax.Array]:
        def loss(weights: Denoiser) -> jax.Array:
            keys = jax.random.split(jax.random.fold_in(key, state.step), recipe.batch)
            denoiser = eqx.combine(weights, structure)
            if recipe.precision != "float32":
                denoiser = in_precision(denoiser, recipe.precision)
            losses = jax.vmap(lambda key: patch_loss(denoiser, key, pictures, recipe))(keys)
            return jnp.mean(losses)

        value, gradient = jax.value_and_grad(loss)(state.weights)
        updates, inner = optimiser.update(gradient, state.optimiser, state.weights)
        weights = optax.apply_updates(state.weights, updates)
        # Early on the average forgets its random start faster.
        decay = jnp.minimum(recipe.average, (1 + state.step) / (10 + state.step))
        average = jax.tree.map(lambda a, w: decay * a + (1 - decay) * w, state.average, weights)
        return TrainingState(weights, average, inner, state.step + 1), value

    if steps == 1:
        state, value = step(state, None)
        return state, value[None]
    return jax.lax.scan(step, state, length=steps)


def steps_per_call() -> int:
    """Steps worth compiling into one call: many on an accelerator, one on a CPU.

    On a CPU, XLA takes a path for the gradients of convolutions inside a loop that is 30 times
    slower (jax 0.10), while a call costs nothing beside a step.
    """
    return 1 if jax.default_backend() == "cpu" else 50


def patch_loss(denoiser: Denoiser, key: jax.Array, pictures: Pictures, recipe: Recipe) -> jax.Array:
    """Loss of one random patch at one random level; 1 for a network that has learnt nothing."""
    stats = denoiser.statistics
    key_patch, key_level, key_error = jax.random.split(key, 3)
    clean = pictures.patch(key_patch, recipe.size, recipe.symmetry)
    sigma = random_level(key_level, denoiser)
    x = perturbed(key_error, clean, sigma, stats.perturbation, stats.complex_valued)
    weight, coarse = denoiser.loss_weight(sigma), coarse_errors(denoiser, recipe, sigma)
    if stats.perturbation == "poisson":
        denoised = denoiser(x, sigma)
        return weight * count_loss(denoised, clean, x, sigma, stats.mean, coarse)
    if recipe.kind == "score":
        denoised = denoiser(x, sigma)
        return weight * denoising_loss(denoised, clean, stats.perturbation, coarse)
    score = -jax.grad(energy, argnums=1)(denoiser, x, sigma)
    if stats.perturbation == "signal":
        # denoising_loss is about sigma^2 times this one.
        return weight * sigma**2 * signal_score_loss(score, clean, x, sigma, stats.lowest)
    variance = denoiser.channel_sd(sigma) ** 2
    denoised = x + variance * score
    return weight * denoising_loss(denoised, clean, stats.perturbation, coarse)


def coarse_errors(denoiser: Denoiser, recipe: Recipe, sigma: jax.Array) -> CoarseErrors:
    """What coarse errors weigh at a level beside those of pixels.

    With `loss_weight` it is 1/s^2, so that they count in units of the noise's averages at every
    level. Where the noise is above the pictures' contrast d, averages hold most of what a picture
    is, and by the pixels' weight, which tends to 1/d^2, they would drown the pixels.
    """
    noise, contrast = denoiser.channel_sd(sigma) ** 2, denoiser.channel_spread**2
    return CoarseErrors(recipe.averages, recipe.areas, contrast / (contrast + noise))


def random_level(key: jax.Array, denoiser: Denoiser) -> jax.Array:
    """A training level sigma: log-normal about a part of the pictures' sd, or log-uniform."""
    stats = denoiser.statistics
    key_kind, key_near, key_even = jax.random.split(key, 3)
    low, high = jnp.log(stats.sigma_min), jnp.log(stats.sigma_max)
    centre = jnp.log(_CENTRE * denoiser.channel_spread / denoiser.channel_sd(1.0))
    near = jnp.clip(centre + _SPREAD * jax.random.normal(key_near), low, high)
    even = jax.random.uniform(key_even, minval=low, maxval=high)
    return jnp.exp(jnp.where(jax.random.bernoulli(key_kind, _EVEN), even, near))
