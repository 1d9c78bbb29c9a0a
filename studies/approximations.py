"""What an approximation costs: forms and paths of the annealed score where the answer is known."""

from functools import cache
from typing import NamedTuple

import jax
import numpy as np

from ..models.camera import Poisson
from ..models.gallery import GALLERY, Known
from ..models.likelihood import LinearLikelihood
from ..models.optics import Identity
from ..models.priors import EnergyPrior, ScorePrior
from ..presets import start_of
from ..problem import Posterior, Problem
from ..samplers import MALA, AnnealedLangevin
from ..sampling import sample
from ..starts import annealed
from .systems import loaded

# The paper's applications, on problems of the gallery.
APPLICATIONS = {
    "gamma and Poisson": "Poisson denoising",
    "digits, 8 x 8": "Poisson denoising",
    "complex pixel, sigma_0 0.05": "intensity of one pixel",
    "complex pixel, sigma_0 0.1": "intensity of one pixel",
    "complex pixel, sigma_0 0.3": "intensity of one pixel",
    "two-pixel phase retrieval": "phase retrieval",
    "six-pixel phase retrieval": "phase retrieval",
    "ptychography, 6 x 6": "Fourier ptychography",
}
# Kinds of weights that answer for real pictures, by what the table calls them.
PICTURES = {
    "pictures, score network": (ScorePrior, "signal"),
    "pictures, energy network": (EnergyPrior, "signal"),
    "pictures, energy network of the Gaussian error": (EnergyPrior, "gaussian"),
}
EXACT = "exact"
# Of MALA.
CHAINS = 8
_POLISH, _THIN = 200, 25


class Variant(NamedTuple):
    """`settings` of AnnealedLangevin, None: MALA by itself; `started`: at an estimate or nowhere.

    The estimate is where a run along the convolved path ends, one for each draw, and of counts the
    recording: "split", which cannot travel, could have no kinder start. (The paper's, a noised
    solution of hybrid input-output, would add errors of its own: all draws would be of one twin.)
    """

    settings: dict[str, object] | None
    started: bool
    about: str


VARIANTS = {
    "printed": Variant(
        {"path": "split", "published": True}, True, "as printed, plain Langevin steps"
    ),
    "printed + MALA": Variant(
        {"path": "split", "published": True, "polish": _POLISH}, True,
        f"and {_POLISH} Metropolis-adjusted steps on the exact posterior",
    ),
    "split": Variant({"path": "split"}, True, "the consistent score, on the paper's path"),
    "split, no start": Variant({"path": "split"}, False, "the same from draws of the prior"),
    "convolved": Variant({"path": "convolved"}, False, "the usual path, from draws of the prior"),
    "convolved + MALA": Variant(
        {"path": "convolved", "polish": _POLISH}, False, f"and {_POLISH} steps of MALA"
    ),
    "MALA": Variant(None, True, f"alone: {CHAINS} chains, a draw every {_THIN} steps"),
}  # fmt: skip


class Approximations(NamedTuple):
    """The study on known posteriors. Callable as the harness wants: variant, problem, recording.

    Every recording is of an object of its own, drawn from the prior. `EXACT` answers with
    `reference` draws of the exact posterior, every variant with `draws`; annealing has `levels` of
    `steps` each.
    """

    draws: int
    reference: int
    levels: int
    steps: int
    seed: int

    def __call__(self, variant: str, problem: str, index: int) -> np.ndarray:
        _, posterior, key = self.recording(problem, index)
        if variant == EXACT:
            return np.asarray(_exact(problem, self.reference)(key, posterior.y))
        return answered(VARIANTS[variant], posterior, key, self.draws, self.levels, self.steps)

    def recording(self, problem: str, index: int) -> tuple[jax.Array, Posterior, jax.Array]:
        """Truth, posterior and a key for its draws: the same for every variant."""
        known = _known(problem)
        asked = Problem(known.likelihood, known.prior)
        key_data, key = jax.random.split(jax.random.fold_in(jax.random.key(self.seed), index))
        truth, y = asked.simulate(key_data)
        return truth, asked.condition(y), key


class OnPictures(NamedTuple):
    """The study on real pictures under learned priors, whose posteriors nobody knows.

    `truths` (n, h, w) in 0..1, recorded with true Poisson counts of `full_well` electrons. The
    printed form is for the signal-dependent error; a Metropolis test needs the density of an energy
    network. Rows of one network compare the approximations, rows of several the networks too.
    """

    truths: np.ndarray
    prior: str
    full_well: int
    draws: int
    levels: int
    steps: int
    seed: int

    def __call__(self, variant: str, problem: str, index: int) -> np.ndarray:
        kind, perturbation = PICTURES[problem]
        if perturbation != "signal" and (VARIANTS[variant].settings or {}).get("published"):
            raise ValueError("the printed form is of the signal-dependent error: see its network")
        shape = self.truths.shape[1:]
        likelihood = LinearLikelihood(Identity(shape), Poisson(self.full_well))
        asked = Problem(likelihood, loaded(kind, self.prior, shape, perturbation))
        key_data, key = jax.random.split(jax.random.fold_in(jax.random.key(self.seed), index))
        y = likelihood.simulate(key_data, self.truths[index])
        posterior = asked.condition(y)
        return answered(VARIANTS[variant], posterior, key, self.draws, self.levels, self.steps)


def answered(
    variant: Variant, posterior: Posterior, key: jax.Array, draws: int, levels: int, steps: int
) -> np.ndarray:
    """Draws (draws, *shape). Raises ValueError where the variant does not apply."""
    key_start, key = jax.random.split(key)
    if variant.settings is None:
        start = _estimates(posterior, key_start, CHAINS, levels, steps)
        run = sample(
            posterior, MALA(), key, chains=CHAINS, draws=draws // CHAINS, thin=_THIN, start=start,
            progress=False,
        )  # fmt: skip
        return run.values.reshape(draws, *posterior.shape)
    start = None
    if variant.started:
        start = _estimates(posterior, key_start, draws, levels, steps)
    sampler = AnnealedLangevin(levels=levels, steps=steps, **variant.settings)
    run = sample(posterior, sampler, key, chains=draws, draws=1, start=start, progress=False)
    return run.values[:, 0]


def _estimates(
    posterior: Posterior, key: jax.Array, count: int, levels: int, steps: int
) -> np.ndarray:
    """Where draws start (count, *shape)."""
    if posterior.likelihood.linear:
        return start_of("annealed-split", posterior, key, count)
    return annealed(posterior, AnnealedLangevin(levels=levels, steps=steps), key, count)


@cache
def _known(problem: str) -> Known:
    return GALLERY[problem]()


@cache
def _exact(problem: str, count: int):  # noqa: ANN202
    exact = _known(problem).exact
    return jax.jit(lambda key, y: exact(key, y, count))
