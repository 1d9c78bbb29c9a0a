"""Phase retrieval, the paper's Table 2: its systems and ours on the same recordings."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..models.camera import Poisson
from ..models.priors.storage import card_of
from .phase_recording import Recording
from .phase_systems import PHASE_SYSTEMS
from .pictures import held_out

OVERSAMPLING = 2
GAUSSIAN, COUNTS = "prdeep", "poisson"
DEFINITIONS = (GAUSSIAN, COUNTS, f"{COUNTS}-8")
_WHITE = 255


class Condition(NamedTuple):
    """`alpha`: noise as prDeep counts it; `bits` of an ADC, None where every electron is told;
    `gaussian`: prDeep's normal noise, in place of photon counts.
    """

    alpha: float
    gaussian: bool
    bits: int | None

    @classmethod
    def of(cls, text: str) -> "Condition":
        """From "2-prdeep", "2-poisson" or "2-poisson-8". Raises ValueError for anything else."""
        alpha, _, definition = text.partition("-")
        kind, _, bits = definition.partition("-")
        known = not bits if kind == GAUSSIAN else kind == COUNTS and (not bits or bits.isdecimal())
        if not known:
            raise ValueError(
                f"definition {definition!r}: give {', '.join(DEFINITIONS)}, or other bits"
            )
        found = cls(check_alpha(alpha), kind == GAUSSIAN, int(bits) if bits else None)
        Poisson(1, found.bits)
        return found

    @property
    def electron(self) -> float:
        """What one electron is of the intensity |F x|^2, F unitary and x in 0..1."""
        return (2 * self.alpha / _WHITE) ** 2


def check_alpha(text: str) -> float:
    """The noise level. Raises ValueError unless it is a positive number."""
    try:
        alpha = float(text)
    except ValueError:
        alpha = 0.0
    if not 0 < alpha < _WHITE / 2:
        raise ValueError(f"alpha {text}: give a noise level above 0, such as 2, 3 or 4")
    return alpha


class PhaseRetrieval(NamedTuple):
    """The study: `truths` (pictures, h, w) in 0..1, each recorded and answered `seeds` times over.

    A condition is alpha and the definition of the noise (`Condition.of`). Answer i is of picture
    i modulo their number. `scout`: the prior whose denoiser finds where annealing starts.
    Callable as the harness wants it.
    """

    truths: np.ndarray
    prior: str
    draws: int
    seed: int
    scout: str

    def __call__(self, system: str, condition: str, index: int) -> np.ndarray:
        return np.asarray(PHASE_SYSTEMS[system].answer(self.recording(condition, index)))

    def truth(self, index: int) -> np.ndarray:
        """The picture behind answer `index`."""
        return self.truths[index % len(self.truths)]

    def recording(self, condition: str, index: int) -> Recording:
        """Of one picture: the same for every system and on every machine.

        "prdeep": y^2 = |z|^2 + alpha |z| w of Metzler et al., z half the unitary transform of the
        picture in 0..255, padded to twice its sides, w standard normal; in whole electrons then,
        which adds a twelfth to a variance of the electrons themselves. "poisson": photon counts of
        the same mean and variance. With bits an ADC spans the brightest of them.
        """
        how = Condition.of(condition)
        x = self.truth(index)
        shape = tuple(OVERSAMPLING * n for n in x.shape)
        electrons = np.abs(np.fft.fft2(x, s=shape, norm="ortho")) ** 2 / how.electron
        rng = np.random.default_rng((self.seed, index, round(1000 * how.alpha)))
        if how.gaussian:
            noise = np.sqrt(electrons) * rng.standard_normal(shape)
            counts = np.rint(np.maximum(electrons + noise, 0))
        else:
            counts = rng.poisson(electrons).astype(float)
        # No pixel saturates: what is lost by the ADC is lost to its steps.
        full_well = int(counts.max()) + 1
        y = counts / full_well
        if how.bits is not None:
            top = 2**how.bits - 1
            y = np.floor(y * top + 0.5) / top
        Poisson(full_well, how.bits).check(y)
        return Recording(
            y.astype(np.float32), full_well, how.bits, 1 / (how.electron * full_well),
            how.alpha, self.prior, (self.seed, index), self.draws, self.scout,
        )  # fmt: skip


def pictures_of(data: Path, prior: str, count: int | None, side: int = 128) -> np.ndarray:
    """Pictures (count, h, w) in 0..1, float32; None: all there are.

    `data`: an .npz file with `images_float` (n, h, w) in grey levels, such as prDeep's six, to test
    on; or the folder of the pictures that the prior's card holds out for validation, to choose
    settings on. Raises ValueError for other files, and for more pictures than there are.
    """
    if Path(data).is_dir():
        card = card_of(prior)
        listed = card["data"].get("validation", [])
        return held_out(card, data, "validation", count or len(listed), side)
    try:
        with np.load(data) as file:
            pictures = np.asarray(file["images_float"], np.float32) / _WHITE
    except (KeyError, ValueError, AttributeError) as error:
        raise ValueError(
            f"{data} holds no images_float (n, h, w): give such an .npz file, or a folder of "
            "validation pictures"
        ) from error
    if pictures.ndim != 3 or not np.all(np.isfinite(pictures)):
        raise ValueError(f"{data} holds pictures of shape {pictures.shape}: give (n, h, w), finite")
    if count is not None and count > len(pictures):
        raise ValueError(f"{data} holds {len(pictures)} pictures, not {count}: take fewer")
    return pictures if count is None else pictures[:count]
