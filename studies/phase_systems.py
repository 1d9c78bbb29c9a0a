"""What retrieves phases: the systems of the paper's Table 2, and ours."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from ..estimators import plug_and_play_admm, prdeep, prgamp
from ..models.priors import RealAmongComplex
from ..presets import learned_annealing
from ..problem import Posterior, Problem
from ..samplers import AnnealedLangevin, Sampler
from ..sampling import sample
from ..starts import by_admm, from_magnitudes
from .phase_recording import Recording, loaded

# Of the network: from some twenty settings, on two to four validation pictures of `natural` at
# alpha 2 and 4. Of BM3D: the one that was tried. A network takes 14 ms on one core, BM3D 1 s.
_ADMM = {
    "bm3d": {"levels": tuple(np.geomspace(0.2, 0.01, 5)), "iterations": 15},
    "network": {"levels": tuple(np.geomspace(0.2, 0.005, 6)), "iterations": 80},
}
# Chosen with the network as denoiser.
_GAMP = {"start_sd": 0.1, "iterations": 50, "damping": 0.05, "finest": 0.005}


class PhaseSystem(NamedTuple):
    """`answer(recording)` gives pictures (draws, h, w): an estimator one, it does not sample.

    `published`: PSNR in the paper's Table 2 at alpha 2, 3 and 4; `note`: how the protocol differs
    from the one those figures are of.
    """

    answer: Callable[[Recording], np.ndarray]
    samples: bool
    note: str
    published: tuple[float, ...] = ()


def _hybrid(recording: Recording) -> np.ndarray:
    return np.asarray(recording.by_hio())[None]


def _by_messages(recording: Recording) -> np.ndarray:
    denoiser = _block_matching()
    found = prgamp(
        recording.likelihood, recording.y, recording.key(1), recording.by_hio(), denoiser, **_GAMP
    )
    return np.asarray(found.object)[None]


def _by_admm(recording: Recording, denoiser: str) -> np.ndarray:
    likelihood = recording.likelihood
    chosen = _block_matching() if denoiser == "bm3d" else loaded(
        recording.prior, likelihood.object_shape
    )  # fmt: skip
    found = plug_and_play_admm(
        likelihood, recording.y, recording.by_hio(), chosen, **_ADMM[denoiser]
    )
    return np.asarray(found.object)[None]


def _block_matching() -> Callable[[np.ndarray, float], np.ndarray]:
    try:
        from bm3d import bm3d
    except ImportError as error:
        raise ValueError(
            "BM3D is not installed: pip install 'posterior-imaging[baselines]'"
        ) from error
    return bm3d


def _regularised(recording: Recording) -> np.ndarray:
    # Chosen on four validation pictures of `natural`: 0.3 at alpha 2, 0.5 at 4.
    weight = 0.1 * (1 + recording.alpha)
    found = prdeep(recording.posterior(), recording.by_hio(), weight=weight)
    return np.asarray(found.object)[None]


def _annealed(recording: Recording, search: bool) -> np.ndarray:
    posterior = recording.posterior()
    sampler = _annealing(posterior, float(posterior.prior.scale) / 2)
    if search:
        start = from_magnitudes(posterior, sampler, recording.key(2), 1)[0]
    else:
        start = recording.by_hio()
    return _drawn(recording, posterior, sampler, start)


def _annealed_near(recording: Recording) -> np.ndarray:
    posterior = recording.posterior()
    scout = loaded(recording.scout, recording.likelihood.object_shape)
    start = by_admm(posterior, recording.key(2), 1, scout=scout)[0]
    return _drawn(recording, posterior, learned_annealing(posterior), start)


def _annealing(posterior: Posterior, broadest: float) -> AnnealedLangevin:
    finest = max(0.4 * float(posterior.data_level()), posterior.prior.finest)
    return AnnealedLangevin(levels=60, steps=4, sigma_max=broadest, sigma_min=finest, descent=6)


def _printed(recording: Recording) -> np.ndarray:
    prior = loaded(recording.prior, recording.likelihood.object_shape)
    posterior = Problem(recording.likelihood, RealAmongComplex(prior)).condition(recording.y)
    # About a thousand evaluations of the network, as the paper takes.
    sampler = AnnealedLangevin(levels=250, steps=4, published=True)
    return _drawn(recording, posterior, sampler, recording.by_hio().astype(complex)).real


def _drawn(
    recording: Recording, posterior: Posterior, sampler: Sampler, start: jax.Array
) -> np.ndarray:
    """Runs side by side, each from that start with noise of its own."""
    count = recording.draws
    run = sample(
        posterior, sampler, recording.key(3), chains=count, draws=1,
        start=np.stack([np.asarray(start)] * count), progress=False,
    )  # fmt: skip
    return run.values[:, 0]


PHASE_SYSTEMS = {
    "HIO": PhaseSystem(
        _hybrid,
        False,
        "Fienup 1982 by prDeep's protocol (50 starts x 50 iterations, the best goes on for 1000); "
        "the published code reads the noise of one half of the spectrum alone, here the recordings "
        "at k and -k have their own, which is worth 1.5 dB or more",
        (22.2, 19.9, 17.9),
    ),
    "BM3D-prGAMP": PhaseSystem(
        _by_messages,
        False,
        "Metzler, Maleki and Baraniuk 2016 from HIO, written anew: k and -k count once, scalar "
        "variances, fixed damping chosen on validation pictures with our network as denoiser",
        (24.5, 23.2, 21.0),
    ),
    "BM3D-ADMM": PhaseSystem(
        partial(_by_admm, denoiser="bm3d"),
        False,
        "plug-and-play ADMM from HIO; levels and weight, which Metzler et al. do not print, were "
        "tried on two validation pictures, no others",
        (27.5, 24.5, 21.8),
    ),
    "network-ADMM": PhaseSystem(
        partial(_by_admm, denoiser="network"),
        False,
        "stands in for DnCNN-ADMM: the same ADMM with our prior's denoiser, one network for all "
        "levels, in place of DnCNN",
        (29.3, 26.0, 22.0),
    ),
    "prDeep": PhaseSystem(
        _regularised,
        False,
        "Metzler et al. 2018 from HIO; one network for all levels in place of four DnCNN, steps "
        "of 1 / ||H||^2 in place of FASTA's, weight chosen on validation pictures",
        (28.4, 28.5, 26.4),
    ),
    "annealed, printed": PhaseSystem(
        _printed,
        True,
        "Algorithm 1 of the paper with eq:complex_final as printed, from HIO with noise just under "
        "that of the data, our real network as a complex one; the paper has an NCSNv2 of complex "
        "objects, and its levels and steps stand in a supplement that was not at hand",
        (33.1, 32.6, 28.9),
    ),
    "annealed from HIO": PhaseSystem(
        partial(_annealed, search=False),
        True,
        "the paper's start, HIO with much noise (half the sd of a pixel), but the consistent score "
        "of the counts along the convolved path, and a descent at the end",
        (33.1, 32.6, 28.9),
    ),
    "annealed": PhaseSystem(
        partial(_annealed, search=True),
        True,
        "as annealed from HIO, from the best of 8 candidates chosen anew 5 times by likelihood "
        "(starts.from_magnitudes); all draws stay in that one valley",
        (33.1, 32.6, 28.9),
    ),
    "annealed from ADMM": PhaseSystem(
        _annealed_near,
        True,
        "the same score and descent from a level of 4 times the noise, from the likeliest of 8 "
        "solutions of HIO after network-ADMM (starts.by_admm); all draws stay in that one valley",
        (33.1, 32.6, 28.9),
    ),
}
