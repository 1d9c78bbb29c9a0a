"""What denoises counts: the systems of the paper's Table 1, and ours."""

import math
from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import jax
import numpy as np

from ..estimators import anscombe_denoised, mmse, red
from ..models.camera import Poisson
from ..models.likelihood import LinearLikelihood
from ..models.optics import Identity
from ..models.priors import EnergyPrior, ScorePrior
from ..models.priors.learned import LearnedPrior
from ..presets import SAMPLERS, start_of
from ..problem import Posterior, Problem
from ..samplers import AnnealedLangevin, Kawar, Sampler
from ..sampling import sample

# Level of RED's denoiser over sigma_0, and its weight in units of 1 / level^2: chosen at three
# levels of noise on validation pictures, six of `nuclei` and four of `faces`.
_RED, _RED_OF = (0.25, 2.0), {"faces": (0.15, 0.6)}


class Recording(NamedTuple):
    """What a system is given: counts `y` (h, w[, 3]), their camera, the prior's name, a key."""

    y: jax.Array
    camera: Poisson
    prior: str
    key: jax.Array
    draws: int

    def posterior(self, perturbation: str, kind: type[LearnedPrior] = ScorePrior) -> Posterior:
        """Under the prior of that annealing error."""
        likelihood = LinearLikelihood(Identity(self.y.shape), self.camera)
        prior = loaded(kind, self.prior, self.y.shape, perturbation)
        return Problem(likelihood, prior).condition(self.y)


class System(NamedTuple):
    """`answer(recording)` gives images (draws, h, w[, 3]): an estimator one, it does not sample.

    `published`, `published_ssim` (%): the paper's Table 1 at sigma_0 = 0.025, 0.05, 0.1 and 0.2, on
    faces.
    """

    answer: Callable[[Recording], np.ndarray]
    samples: bool
    reference: str
    published: tuple[float, ...] = ()
    published_ssim: tuple[float, ...] = ()


@cache
def loaded(
    kind: type[LearnedPrior], prior: str, shape: tuple[int, ...], perturbation: str
) -> LearnedPrior:
    """The learned prior of that name, read once."""
    return kind.load(prior, shape, perturbation)


def _recorded(recording: Recording) -> np.ndarray:
    return np.asarray(recording.y)[None]


def _mean_of_counts(recording: Recording) -> np.ndarray:
    return np.asarray(mmse(recording.posterior("poisson")))[None]


def _regularised(recording: Recording) -> np.ndarray:
    share, weight = _RED_OF.get(recording.prior, _RED)
    level = share * float(recording.camera.sigma0)
    found = red(recording.posterior("gaussian"), level, weight=weight / level**2)
    return np.asarray(found.object)[None]


def _anscombe_by_planes(recording: Recording) -> np.ndarray:
    if recording.y.ndim == 2:
        raise ValueError("the picture has one plane: VST + BM3D is the same")
    planes = [recording._replace(y=recording.y[..., i]) for i in range(recording.y.shape[-1])]
    return np.stack([_anscombe(plane, (1.0,)) for plane in planes], axis=-1)


def _anscombe(recording: Recording, shares: tuple[float, ...]) -> np.ndarray:
    try:
        from bm3d import bm3d, bm3d_rgb
    except ImportError as error:
        raise ValueError(
            "BM3D is not installed: pip install 'posterior-imaging[baselines]'"
        ) from error
    # Codes hide counts where the ADC is coarse; the nearest count is what is known.
    camera = Poisson(recording.camera.full_well, holds=recording.camera.holds)
    counts = np.round(np.asarray(recording.y, float) * camera.full_well)
    denoiser = bm3d if recording.y.ndim == 2 else bm3d_rgb
    return anscombe_denoised(counts / camera.full_well, camera, denoiser, shares)[None]


def _drawn(
    recording: Recording,
    name: str,
    perturbation: str,
    build: Callable[[Posterior], Sampler],
    kind: type[LearnedPrior] = ScorePrior,
) -> np.ndarray:
    posterior, count = recording.posterior(perturbation, kind), recording.draws
    start = start_of(name, posterior, recording.key, count)
    run = sample(
        posterior, build(posterior), recording.key, chains=count, draws=1, start=start,
        progress=False,
    )  # fmt: skip
    return run.values[:, 0]


def _printed(_: Posterior) -> AnnealedLangevin:
    return AnnealedLangevin(levels=45, steps=4, published=True)


def _then_mala(_: Posterior) -> AnnealedLangevin:
    """As many levels and steps as annealing has of a score, and a warm-up and 200 steps of MALA."""
    return AnnealedLangevin(levels=45, steps=4, polish=200)


def published_kawar(posterior: Posterior) -> Kawar:
    """By the schedule of NCSNv2 for faces of 64x64 (Song and Ermon 2020, configs/celeba.yml).

    Of 500 levels from 90 to 0.01 as many as lie below the noise at full light, with 5 steps of
    3.3e-6 (sigma_t / 0.01)^2: a twelfth of our default's length. The recording's own noise, where
    they begin, is less: there they lie somewhat closer, and a camera has one compilation. Where the
    noise is not white, as here, it is an advantage not to come near the equilibrium.
    """
    below = math.log(float(posterior.likelihood.camera.sigma0) / 0.01) / math.log(90 / 0.01)
    return Kawar(max(2, round(500 * below)), steps=5, step_size=0.033, sigma_min=0.01)


def _sampler(name: str, perturbation: str, build: Callable | None = None) -> Callable:
    build = build or SAMPLERS[name].build
    return partial(_drawn, name=name, perturbation=perturbation, build=build)


SYSTEMS = {
    "recording": System(_recorded, False, "as it is"),
    "VST + BM3D": System(
        partial(_anscombe, shares=(1.0,)), False, "Makitalo and Foi 2011, Dabov et al. 2007"
    ),
    "VST + BM3D by planes": System(_anscombe_by_planes, False, "as VST + BM3D, colours apart"),
    "iterated VST + BM3D": System(
        partial(_anscombe, shares=(1.0, 0.625, 0.25)),
        False,
        "Azzari and Foi 2016, without binning",
        (39.1, 35.8, 30.9, 27.2),
        (99, 98, 96, 93),
    ),
    "RED": System(
        _regularised, False, "Romano et al. 2017", (39.8, 36.9, 31.8, 27.8), (99, 98, 96, 93)
    ),
    "MMSE": System(
        _mean_of_counts,
        False,
        "a network of counts, one evaluation",
        (42.5, 38.4, 34.5, 30.9),
        (99, 99, 98, 96),
    ),
    "Kawar": System(
        _sampler("kawar", "gaussian"),
        True,
        "Kawar et al. 2021, to equilibrium: 300 levels of 5 large steps",
    ),
    "Kawar, published": System(
        _sampler("kawar", "gaussian", published_kawar),
        True,
        "Kawar et al. 2021, by the levels and steps of Song and Ermon 2020",
        (34.2, 34.1, 30.6, 27.1),
        (97, 97, 95, 91),
    ),
    "DPS": System(_sampler("dps", "gaussian"), True, "Chung et al. 2023"),
    "DAPS": System(_sampler("daps", "gaussian"), True, "Zhang et al. 2024"),
    "split Gibbs": System(_sampler("split-gibbs", "gaussian"), True, "Vono et al. 2019"),
    "annealed, printed": System(
        _sampler("annealed-split", "signal", _printed),
        True,
        "arXiv 2212.03235, as printed",
        (41.5, 37.1, 32.8, 28.6),
        (99, 99, 98, 94),
    ),
    "annealed, signal": System(
        _sampler("annealed", "signal"), True, "arXiv 2212.03235, along the convolved path"
    ),
    "annealed": System(_sampler("annealed", "gaussian"), True, "with the Gaussian error"),
    "annealed, then MALA": System(
        partial(
            _drawn, name="annealed", perturbation="gaussian", build=_then_mala, kind=EnergyPrior
        ),
        True,
        "of the energy network, Metropolis-adjusted in the end",
    ),
    "thickening": System(_sampler("thickening", "poisson"), True, "this project"),
}
