"""Samplers by name, with the settings they have under each prior, and where their chains start."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import blackjax
import jax
import jax.numpy as jnp
import numpy as np

from ..estimators.quasi_newton import bright_fields, default_start
from ..models.priors import ScorePrior
from ..models.priors.learned import LearnedPrior
from ..problem import Posterior
from ..samplers import (
    DAPS,
    DPS,
    MALA,
    SNIPS,
    ULA,
    AnnealedLangevin,
    BlackJAX,
    Ensemble,
    Kawar,
    Sampler,
    SplitGibbs,
    TemperedSMC,
    Thickening,
)
from ..starts import annealed, by_admm, for_ptychography, from_magnitudes, has_magnitudes


class Sampling(NamedTuple):
    """How a named sampler is built for a posterior, and how much it draws if nothing is said.

    `needs`, of the prior: its "density", its "score" alone, the "annealed score", which may be of
    the signal-dependent error, or the denoiser of "counts".
    """

    build: Callable[[Posterior], Sampler]
    draws: int
    thin: int
    needs: str = "density"


STARTS = ("none", "hio", "admm")


def _ula(posterior: Posterior) -> ULA:
    # A fifth of the stiffest variance: the step's own bias is then 10 % of it at most.
    complex_object = jnp.issubdtype(posterior.dtype, jnp.complexfloating)
    data = posterior.likelihood.curvature(complex_object, posterior.y, 0.0, "convolved")
    return ULA(step_size=0.2 / float(jnp.max(data) + posterior.prior.stiffness))


_ANNEALED = {"levels": 200, "steps": 5}


def learned_annealing(
    posterior: Posterior, path: str = "convolved", begin: str | None = None
) -> AnnealedLangevin:
    """Annealing for score networks, with settings chosen on held-out pictures.

    It ends in a descent by the prior: for a picture itself from twice the network's finest level,
    for an object behind a field from where its annealing error is 0.4 of the noise. There it begins
    where a start is not forgotten, but its errors are: far-field magnitudes of real objects at 4
    times the noise, from the ends of ADMM (`starts.by_admm`; at half the sd of a channel, where
    those of complex objects begin, annealing loses its valley: 3 dB); other fields at 15 times
    the noise, for in the lowest frequencies quasi-Newton is that far off: 12 of 16384 held 76 % of
    its draws' error at sigma_0 = 0.2. `begin`: where chains start, if not there (`start_of`); with
    "none" annealing begins at the prior's own scale.
    """
    prior, steps = posterior.prior, {"steps": 4, "path": path}
    if prior.perturbation == "signal":
        # A descent is for the gaussian error; the posterior knows the range of this one.
        return AnnealedLangevin(levels=45, **steps)
    steps["descent"] = 6
    if posterior.likelihood.linear:
        return AnnealedLangevin(levels=45, sigma_min=2 * prior.finest, **steps)
    noise = float(posterior.data_level())
    finest = max(0.4 * noise, prior.finest)
    if begin == "none":
        broadest = float(posterior.annealing_range(path)[0])
    elif has_magnitudes(posterior.likelihood.optics):
        admm = _by_admm(posterior) if begin is None else begin == "admm"
        broadest = 4 * noise if admm else float(prior.scale) / 2
    else:
        broadest = min(max(float(prior.scale), 15 * noise), prior.statistics.sigma_max)
    if path == "split":
        # The annealing error is a part of the noise there.
        broadest = min(broadest, float(posterior.annealing_range(path)[0]))
    return AnnealedLangevin(levels=60, sigma_max=max(broadest, finest), sigma_min=finest, **steps)


def _annealed_sampler(posterior: Posterior, path: str = "convolved") -> AnnealedLangevin:
    if isinstance(posterior.prior, ScorePrior):
        return learned_annealing(posterior, path)
    return AnnealedLangevin(**_ANNEALED, path=path, polish=200)


def sampler_of(name: str, posterior: Posterior, begin: str | None = None) -> Sampler:
    """The named sampler for a posterior, whose chains start as `start_of` says of `begin`."""
    learned = isinstance(posterior.prior, ScorePrior) and name in ("annealed", "annealed-split")
    if begin is None or not learned:
        return SAMPLERS[name].build(posterior)
    return learned_annealing(posterior, "split" if name == "annealed-split" else "convolved", begin)


SAMPLERS = {
    "mala": Sampling(lambda _: MALA(), 500, 25),
    "annealed": Sampling(_annealed_sampler, 25, 1, needs="annealed score"),
    "annealed-split": Sampling(
        partial(_annealed_sampler, path="split"), 25, 1, needs="annealed score"
    ),
    "ula": Sampling(_ula, 500, 10, needs="score"),
    "split-gibbs": Sampling(lambda _: SplitGibbs(), 25, 1, needs="score"),
    "daps": Sampling(lambda _: DAPS(), 25, 1, needs="score"),
    "dps": Sampling(lambda _: DPS(), 25, 1, needs="score"),
    "kawar": Sampling(lambda _: Kawar(), 25, 1, needs="score"),
    "snips": Sampling(lambda _: SNIPS(), 25, 1, needs="score"),
    "thickening": Sampling(lambda _: Thickening(), 25, 1, needs="counts"),
    "nuts": Sampling(lambda _: BlackJAX(blackjax.nuts), 250, 1),
    "smc": Sampling(lambda _: TemperedSMC(), 250, 1),
    "ensemble": Sampling(lambda _: Ensemble(), 4000, 1),
}


def start_of(
    sampler: str,
    posterior: Posterior,
    key: jax.Array,
    chains: int,
    *,
    progress: bool = False,
    measured: bool = False,
    scout: LearnedPrior | None = None,
    begin: str | None = None,
) -> np.ndarray | None:
    """Where the chains of a named sampler start, (chains, *shape); None: at its own choice.

    From intensities of a field, a chain that starts at random stays in the wrong valley, so each
    starts at the end of an annealing run of its own; behind a Fourier transform, of the best of
    several, which start from hybrid input-output. Under a learned prior a real object behind one
    starts from plug-and-play ADMM (`starts.by_admm`); ptychography from quasi-Newton, where no LED
    is a dark field from an annealing run from there, and a `measured` stack from halves of itself.
    `scout`: a prior that searches better than the posterior's (`scout_of`), for ADMM.
    "split" cannot travel at all.

    `begin`, of phase retrieval alone, None as above: "none", at the sampler's own choice; "hio",
    the search from hybrid input-output; "admm". Raises ValueError where that is not to be had.
    """
    if begin is not None:
        return _phase_start(begin, sampler, posterior, key, chains, progress, scout)
    magnitudes = has_magnitudes(posterior.likelihood.optics)
    if posterior.likelihood.linear:
        if sampler != "annealed-split":
            return None
        start = default_start(posterior.likelihood, posterior.y)
        start = start if posterior.prior.complex_valued else start.real
        if posterior.positive:
            # Darkness itself has no score under the signal-dependent error: half an electron has.
            start = jnp.maximum(start, posterior.likelihood.camera.sigma0**2 / 2)
        return np.stack([start] * chains)
    if isinstance(posterior.prior, LearnedPrior):
        if not magnitudes:
            return _ptychography_start(posterior, key, chains, progress, measured)
        if _by_admm(posterior):
            return by_admm(posterior, key, chains, progress, scout)
        return from_magnitudes(posterior, learned_annealing(posterior), key, chains, progress)
    if sampler not in ("mala", "ula", "nuts", "annealed-split"):
        return None
    search = from_magnitudes if magnitudes else annealed
    return search(posterior, AnnealedLangevin(**_ANNEALED), key, chains, progress=progress)


def _phase_start(
    begin: str,
    sampler: str,
    posterior: Posterior,
    key: jax.Array,
    chains: int,
    progress: bool,
    scout: LearnedPrior | None,
) -> np.ndarray | None:
    """As `begin` says, one of `STARTS`."""
    if begin not in STARTS or not has_magnitudes(posterior.likelihood.optics):
        raise ValueError(f"start {begin!r}: phase retrieval alone takes one of {', '.join(STARTS)}")
    learned = isinstance(posterior.prior, LearnedPrior)
    if begin == "none":
        if sampler == "annealed-split":
            raise ValueError("start none: annealed-split cannot travel, use hio, or annealed")
        return None
    if begin == "admm":
        if not learned or not _by_admm(posterior):
            raise ValueError("start admm: it needs a learnt prior of real objects, use hio")
        return by_admm(posterior, key, chains, progress, scout)
    annealing = AnnealedLangevin(**_ANNEALED)
    if learned:
        annealing = learned_annealing(posterior, begin=begin)
    return from_magnitudes(posterior, annealing, key, chains, progress)


def _by_admm(posterior: Posterior) -> bool:
    """Whether ADMM starts phase retrieval: measured on real objects alone."""
    prior = posterior.prior
    return not prior.complex_valued and prior.perturbation == "gaussian"


def _ptychography_start(
    posterior: Posterior, key: jax.Array, chains: int, progress: bool, measured: bool
) -> np.ndarray | None:
    """As `for_ptychography`; after one run more where all LEDs are bright fields.

    An LED tells a slow phase to first order where one of its sidebands passes the pupil and the
    other does not. Bright fields well inside tell none, and quasi-Newton is off there by more than
    the noise of the first level: the draws of one run remember it. A broader first level loses
    quasi-Newton's valley. On four validation objects behind 9 LEDs the second run brought spread
    over error from 0.90 to 1.07, and the error of the mean from 0.114 to 0.101.
    """
    start = for_ptychography(posterior, key, chains, progress, measured)
    optics = posterior.likelihood.optics
    if start is None or measured or not bright_fields(optics).all():
        return start
    scout, key = learned_annealing(posterior), jax.random.fold_in(key, 1)
    return annealed(posterior, scout, key, chains, start, progress)
