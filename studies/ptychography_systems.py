"""What finds a complex object behind the images of LEDs: the paper's systems, and ours."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import numpy as np

from ..estimators import default_start, maximum_likelihood
from ..models.likelihood import IntensityLikelihood
from ..models.priors import FlatPrior, Prior, ScorePrior
from ..presets import learned_annealing, start_of
from ..problem import Posterior, Problem
from ..samplers import AnnealedLangevin, Sampler
from ..sampling import sample
from ..starts import for_ptychography


class Recording(NamedTuple):
    """What a system is given: images `y` (LEDs, n, n), their microscope, a prior by name, a key.

    `measured`: of a real microscope, whose model is not quite right.
    """

    likelihood: IntensityLikelihood
    y: jax.Array
    prior: str
    key: jax.Array
    draws: int
    measured: bool = False

    @property
    def start_key(self) -> jax.Array:
        """Of the starts: `key` is of the draws."""
        return jax.random.fold_in(self.key, 2**31 - 1)

    def posterior(self, prior: Prior | None = None) -> Posterior:
        """Under the network of that name, or another prior."""
        shape = self.likelihood.object_shape
        prior = _loaded(self.prior, shape) if prior is None else prior
        return Problem(self.likelihood, prior).condition(self.y)


class System(NamedTuple):
    """`answer(recording)` gives objects (draws, side, side): an estimator one."""

    answer: Callable[[Recording], np.ndarray]
    reference: str


@cache
def _loaded(prior: str, shape: tuple[int, ...]) -> ScorePrior:
    return ScorePrior.load(prior, shape, dtype=complex)


def _bright_field(recording: Recording) -> np.ndarray:
    return np.asarray(default_start(recording.likelihood, recording.y))[None]


def _quasi_newton(recording: Recording) -> np.ndarray:
    return np.asarray(maximum_likelihood(recording.likelihood, recording.y).object)[None]


def _without_prior(recording: Recording) -> np.ndarray:
    """As printed, from quasi-Newton: nothing else would tell it a phase.

    From just under sigma_0 itself, as the paper's levels are for H = I: what no LED sees keeps the
    noise of the first level, and under the row norms of the optics it would be broader. So it has
    12.6 against 9.8 dB on validation objects behind 9 LEDs, 17.5 against 13.8 behind 89; with the
    prior it is 19.6 against 21.6 and 27.6 against 26.5.
    """
    flat = FlatPrior(recording.likelihood.object_shape, complex)
    start = np.repeat(_quasi_newton(recording), recording.draws, axis=0)
    sampler = _printed(0.99 * float(recording.likelihood.camera.sigma0))
    return _drawn(recording, recording.posterior(flat), sampler, start)


def _annealed_printed(recording: Recording) -> np.ndarray:
    posterior, key = recording.posterior(), recording.start_key
    start = for_ptychography(posterior, key, recording.draws, measured=recording.measured)
    return _drawn(recording, posterior, _printed(), start)


def _annealed(recording: Recording) -> np.ndarray:
    posterior, settings = recording.posterior(), {"measured": recording.measured}
    start = start_of("annealed", posterior, recording.start_key, recording.draws, **settings)
    return _drawn(recording, posterior, learned_annealing(posterior), start)


def _printed(sigma_max: float | None = None) -> AnnealedLangevin:
    # As many evaluations of the network as the consistent form takes.
    return AnnealedLangevin(levels=60, steps=4, published=True, sigma_max=sigma_max)


def _drawn(
    recording: Recording, posterior: Posterior, sampler: Sampler, start: np.ndarray
) -> np.ndarray:
    run = sample(
        posterior, sampler, recording.key, chains=recording.draws, draws=1, start=start,
        progress=False,
    )  # fmt: skip
    return run.values[:, 0]


PTYCHOGRAPHY_SYSTEMS = {
    "bright field": System(_bright_field, "mean bright field, where quasi-Newton starts"),
    "quasi-Newton": System(_quasi_newton, "Yeh et al. 2015, on the exact likelihood"),
    "no prior": System(_without_prior, "arXiv 2212.03235, Algorithm 1 without its prior"),
    "annealed, printed": System(_annealed_printed, "arXiv 2212.03235, as printed"),
    "annealed": System(_annealed, "the consistent form, along the convolved path"),
}
