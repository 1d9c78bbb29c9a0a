"""What plug-and-play methods plug in: a prior's denoiser, or any program that removes noise."""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models.priors import Prior

# Of a prior E[object | object + error] at an annealing level; of a program (BM3D) what it makes of
# an array with white Gaussian noise of a standard deviation, which is that level for real objects.
Denoiser = Prior | Callable[[np.ndarray, float], np.ndarray]
Step = Callable[[Any, Callable[[jax.Array, jax.Array], jax.Array], Any, Any], Any]


def iterated(step: Step, problem: Any, denoiser: Denoiser, state: Any, schedule: Any) -> Any:
    """The state after `step(problem, denoise, state, at)` at each `at` of the schedule.

    Leaves of `schedule` have the iterations first. With a prior it is one compiled scan, which a
    new problem of the same shapes does not recompile; a program runs on the host, so that with one
    it is a loop in Python. Raises ValueError for a program that returns another shape or values
    that are not finite.
    """
    if isinstance(denoiser, Prior):
        return _scanned(step, problem, denoiser, state, schedule)
    denoise = partial(_on_host, denoiser)
    for i in range(len(jax.tree.leaves(schedule)[0])):
        state = step(problem, denoise, state, jax.tree.map(lambda values, i=i: values[i], schedule))
    return state


def check_denoiser(denoiser: Denoiser, shape: tuple[int, ...], complex_object: bool) -> None:
    """Refuse, in a sentence, what cannot denoise objects of this shape and kind."""
    if not isinstance(denoiser, Prior):
        if not callable(denoiser):
            raise ValueError(
                f"denoiser {denoiser!r}: give a prior, or a function of an array and its noise"
            )
        return
    if denoiser.perturbation != "gaussian":
        raise ValueError(
            f"the prior has the {denoiser.perturbation!r} perturbation: give one with the gaussian"
        )
    if denoiser.shape != shape or denoiser.complex_valued != complex_object:
        raise ValueError(
            f"the prior is for {'complex' if denoiser.complex_valued else 'real'} objects of "
            f"{denoiser.shape}, the start is {'complex' if complex_object else 'real'} of {shape}: "
            "give a start of its kind"
        )


@eqx.filter_jit
def _scanned(step: Step, problem: Any, prior: Prior, state: Any, schedule: Any) -> Any:
    def one(state: Any, at: Any) -> tuple[Any, None]:
        return step(problem, prior.denoise, state, at), None

    return jax.lax.scan(one, state, schedule)[0]


def _on_host(denoiser: Callable, x: jax.Array, level: jax.Array) -> jax.Array:
    clean = np.asarray(denoiser(np.asarray(x), float(level)))
    if clean.shape != x.shape or not np.all(np.isfinite(clean)):
        raise ValueError(
            f"the denoiser returned {clean.shape}, with {np.sum(~np.isfinite(clean))} values that "
            f"are not finite: it must keep the shape {x.shape}, and be finite"
        )
    return jnp.asarray(clean, x.dtype)
