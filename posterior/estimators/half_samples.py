"""Half samples: answers that scatter as far as the data disagree.

McCarthy, Review of the International Statistical Institute 37, 239, 1969: an estimate from a random
half of the data lies about as far from that of all as that of all lies from the truth. It asks
nothing of the noise, so it knows what a likelihood that is wrong does not.
"""

import jax
import numpy as np
from jax.typing import ArrayLike
from rich.progress import track

from ..models.likelihood import Likelihood
from .quasi_newton import default_start, maximum_likelihood


def half_samples(
    likelihood: Likelihood,
    y: ArrayLike,
    key: jax.Array,
    count: int,
    *,
    iterations: int = 200,
    progress: bool = False,
) -> np.ndarray:
    """Objects (count, *shape), each the likeliest under a random half of `y`, no prior.

    Halves are of the first axis: an image of a stack is taken or left as a whole, for what a model
    gets wrong in it is not independent from pixel to pixel. Quasi-Newton climbs from
    `default_start` each time: what a half leaves free stays there, and does not scatter. Raises
    ValueError as `maximum_likelihood` does, and for a `y` that has no halves.

    Approximation: exact for the mean of an even number of data. Of n data for p unknowns least
    squares scatter by about (n/2) / (n/2 - p - 1) more, in variance, and other estimates by as much
    as they depend on n. What was fitted to all of the data, such as a calibration, does not
    scatter.
    """
    if np.ndim(y) == 0 or len(y) < 2:
        raise ValueError(f"data of shape {np.shape(y)} have no halves: give 2 or more along axis 0")
    chosen, of_one = np.arange(len(y)) < len(y) // 2, (len(y), *(1,) * (np.ndim(y) - 1))
    start, found = default_start(likelihood, y), []
    keys = jax.random.split(key, count)
    for one in track(keys, "half samples", disable=not progress):
        weights = jax.random.permutation(one, chosen).reshape(of_one)
        half = maximum_likelihood(likelihood, y, start, weights=weights, iterations=iterations)
        found.append(np.asarray(half.object))
    return np.stack(found)
