"""The three perturbations a network can be trained on, each with its error, loss and score.

"gaussian", real:     x~ = x + e,          e ~ N(0, sigma^2)
"gaussian", complex:  o~ = o + e,          Re e, Im e ~ N(0, sigma^2/4) each (eq:part_complex)
"signal":             x~ = x + sqrt(x) e,  e ~ N(0, sigma^2)                 (eq:defining_x_tilde)

Everything here works on channels: real arrays (h, w, channels), a complex object being the two
channels Re and Im. With s the standard deviation per channel, the score of the Gaussian ones is
(D - x~)/s^2, D = E[x | x~] (eq:denoiser_complex), and D is what the squared loss finds.

The signal-dependent score is E[(x - x~)/(sigma^2 x) | x~] = (1 - x~ E[1/x | x~])/sigma^2
(eq:true_p). Its target in eq:DNN_poisson explodes where x is dark. Here the network predicts
D = 1/E[1/x | x~], the harmonic mean, which the loss (D - x)^2/x finds: its minimum is where
D E[1/x | x~] = 1. The score is (D - x~)/(sigma^2 D), the same one. A `floor` keeps 1/x finite: the
prior learnt is that of max(x, floor), exactly, and D is never below the floor either.
"""

import jax
import jax.numpy as jnp

from ..annealing import component_sd

PERTURBATIONS = ("gaussian", "signal")


def check_perturbation(name: str, complex_valued: bool) -> None:
    """Refuse a perturbation that does not exist, or not for complex objects."""
    if name not in PERTURBATIONS:
        raise ValueError(f"unknown perturbation {name!r}: use {' or '.join(PERTURBATIONS)}")
    if name == "signal" and complex_valued:
        raise ValueError("the signal perturbation is for real objects: use 'gaussian' for complex")


def error_sd(
    x: jax.Array, sigma: jax.Array, perturbation: str, complex_valued: bool
) -> jax.Array | float:
    """Standard deviation of the error on each channel of the clean `x`."""
    if perturbation == "signal":
        return sigma * jnp.sqrt(x)
    return component_sd(sigma, complex_valued)


def score_from_denoised(
    x: jax.Array, denoised: jax.Array, sigma: jax.Array, perturbation: str, complex_valued: bool
) -> jax.Array:
    """Score at the perturbed `x`, from what the network says of the clean one."""
    if perturbation == "signal":
        return (denoised - x) / (sigma**2 * denoised)
    return (denoised - x) / component_sd(sigma, complex_valued) ** 2


def denoising_loss(denoised: jax.Array, clean: jax.Array, perturbation: str) -> jax.Array:
    """Mean squared error; over the clean value for "signal" (`clean` at or above the floor)."""
    error = jnp.square(denoised - clean)
    return jnp.mean(error / clean) if perturbation == "signal" else jnp.mean(error)


def signal_score_loss(
    score: jax.Array, clean: jax.Array, x: jax.Array, sigma: jax.Array, floor: float
) -> jax.Array:
    """eq:DNN_poisson in units of the error, for signal-dependent scores that come from an energy.

    The weight depends on the perturbed `x` alone: one that looked at the clean picture would move
    the minimum.
    """
    target = (clean - x) / (sigma**2 * clean)
    return jnp.mean(sigma**2 * jnp.maximum(x, floor) * jnp.square(score - target))
