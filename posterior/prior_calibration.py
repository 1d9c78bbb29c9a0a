"""What the intervals of a learnt prior are worth: draws from counts of pictures held out."""

import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import track

from .diagnostics.coverage import coverage
from .diagnostics.regions import (
    as_planes,
    block_means,
    bright_areas,
    image_means,
    within_grey_levels,
)
from .diagnostics.spread import held_by, spread_over_error
from .models.camera import Poisson
from .models.likelihood import LinearLikelihood
from .models.optics import Identity
from .models.priors.learned import EnergyPrior, LearnedPrior
from .presets import SAMPLERS, denoising_sampler
from .problem import Problem
from .sampling import sample

FULL_WELLS, DRAWS = (100, 25), 16


def measured_by(prior: LearnedPrior) -> str:
    """The sampler that denoises counts under such a prior where none is asked for.

    Raises ValueError for an energy, which takes MALA hours, and for complex objects, of which there
    are no counts.
    """
    if isinstance(prior, EnergyPrior):
        raise ValueError(
            "an energy takes hours to draw from so many pictures: calibrate a score, or put both "
            "side by side with `posterior study denoising`"
        )
    if prior.complex_valued:
        raise ValueError(
            "the prior is of complex objects, which have no counts: its intervals are those of "
            "`posterior study ptychography`"
        )
    return denoising_sampler(prior.perturbation)


def calibration(
    prior: LearnedPrior, patches: np.ndarray, seed: int = 0, quiet: bool = True
) -> dict[str, dict[str, float | str]]:
    """Of 16 draws of each patch (n >= 2, h, w, channels), by full well: see `worth`, and "sampler".

    Patches in the prior's units, none that it was trained on. Raises ValueError as `measured_by`.
    """
    sampler, truth, found = measured_by(prior), patches.reshape(-1, *prior.shape), {}
    for full_well in FULL_WELLS:
        camera = Poisson(full_well)
        likelihood = LinearLikelihood(Identity(prior.shape), camera)
        problem, draws = Problem(likelihood, prior), []
        told = f"calibration at full well {full_well}"
        for i, picture in enumerate(track(truth, told, disable=quiet)):
            key = jax.random.fold_in(jax.random.key(seed), i)
            posterior = problem.condition(camera.sample(key, jnp.asarray(picture)))
            run = sample(
                posterior, SAMPLERS[sampler].build(posterior), key, chains=DRAWS, draws=1,
                progress=False,
            )  # fmt: skip
            draws.append(run.values[:, 0])
        figures = worth(np.stack(draws), truth, prior.statistics.mean)
        found[str(full_well)] = {"sampler": sampler} | figures
    return found


def worth(draws: np.ndarray, truth: np.ndarray, bright: float) -> dict[str, float]:
    """Is the spread of draws the error of their mean, and how many truths do they hold?

    Draws (n, draws, h, w[, 3]), truth (n, h, w[, 3]). "spread_over_error" is 1 for true draws;
    "inside" is the share of pixels between the least and the largest draw, "inside_8x8_means",
    "inside_image_means" and "inside_bright_areas", of pixels above `bright`, those of averages,
    and "nominal" what they ought to be. Areas are of truths spread within their grey levels.
    """
    nominal, rng = held_by(draws.shape[1], 1.0), np.random.default_rng(0)
    drawn, true = (draws, truth) if truth.ndim == 3 else (as_planes(draws), as_planes(truth))
    spread = within_grey_levels(true, rng)
    asked = {
        "inside": (drawn, true),
        "inside_8x8_means": (block_means(drawn), block_means(true)),
        "inside_image_means": (image_means(drawn), image_means(true)),
        "inside_bright_areas": (bright_areas(drawn, bright), bright_areas(spread, bright)),
    }
    shares = {name: coverage(*both, nominal, rng).share for name, both in asked.items()}
    found = {"spread_over_error": spread_over_error(draws, truth), "nominal": nominal} | shares
    return {name: round(float(value), 3) for name, value in found.items()}
