"""What samplers refuse alike, each in one sentence."""

from ..models.priors import ScorePrior
from ..problem import Posterior
from .base import Sampler


def check_gaussian(sampler: Sampler, posterior: Posterior) -> None:
    """Refuse a prior whose annealing error is not the Gaussian one."""
    perturbation = posterior.prior.perturbation
    if perturbation != "gaussian":
        others = {"signal": "AnnealedLangevin without a descent", "poisson": "Thickening"}
        if not isinstance(posterior.prior, ScorePrior):
            others["signal"] += ", or MALA"
        raise ValueError(
            f"the prior has the {perturbation!r} perturbation: give {type(sampler).__name__} one "
            f"with the gaussian, or use {others[perturbation]}"
        )


def check_at_least(*settings: tuple[str, int, int]) -> None:
    """Refuse a count (name, value, least) below its least."""
    for name, value, least in settings:
        if value < least:
            raise ValueError(f"{name} {value}: give {least} or more")


def check_run(chains: int, draws: int, thin: int, warmup: int | None) -> None:
    """Refuse lengths of a run that are no whole numbers, or too small; None: a default."""
    lengths = (("chains", chains, 1), ("draws", draws, 1), ("thin", thin, 1), ("warmup", warmup, 0))
    for name, value, least in lengths:
        if value is not None and (int(value) != value or value < least):
            raise ValueError(f"{name} {value}: give a whole number, {least} or more")


def check_levels(**levels: float | None) -> None:
    """Refuse levels, the broadest first, that are not positive or in the wrong order."""
    for name, value in levels.items():
        if value is not None and not value > 0:
            raise ValueError(f"{name} {value}: it must be positive, or None")
    (above, broadest), (below, finest) = levels.items()
    if broadest is not None and finest is not None and not finest <= broadest:
        raise ValueError(f"{below} {finest} is above {above} {broadest}: exchange them")
