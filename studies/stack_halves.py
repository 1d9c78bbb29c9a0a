"""A measured stack: systems see half of the LEDs, and predict the images of the other half."""

import os
from typing import NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from ..diagnostics.predictive import misfit
from ..estimators import calibrate
from ..estimators.calibration import NOMINAL, Calibrated
from ..models.priors import ScorePrior
from ..presets import prior_scale
from ..stacks import Stack, dispersed, grid, in_electrons, least_upsampling, read_stack
from .harness import Answer
from .ptychography_systems import PTYCHOGRAPHY_SYSTEMS, Recording
from .report import refusals, row_of

CONDITION = "half of the LEDs"
_HEAD = (
    "system", "bright fields", "dark fields", "bright, held out", "dark, held out",
    "a draw: bright, held out", "dark, held out", "s a draw", "MB",
)  # fmt: skip


class StackHalves(NamedTuple):
    """The study of one stack, in electrons: `fitted` half of its LEDs, the other `held_out`.

    `found`: what calibration made of the fitted half. Systems are given its images as if of as few
    electrons as the dispersion says (`stacks.dispersed`), and its microscope. Callable as the
    harness wants it; the one recording has index 0.
    """

    fitted: Stack
    held_out: Stack
    upsampling: int
    found: Calibrated
    prior: str
    draws: int
    seed: int

    @classmethod
    def of(
        cls, path: str | os.PathLike, view: int, widest: float, prior: str, draws: int, seed: int,
        progress: bool = False, background: bool = False,
    ) -> Self:  # fmt: skip
        """From a file: its middle `view` camera pixels (0: all), LEDs of at most `widest` NA.

        Halves at random, by `seed`. Calibrates, which takes minutes; `background`: whether the
        images may hold some. Raises ValueError as `read_stack` and `calibrate` do, and where fewer
        than 4 LEDs or 16 pixels are left.
        """
        stack = read_stack(path)
        stack = stack.of(np.linalg.norm(stack.led_na, axis=1) <= widest)
        stack = in_electrons(stack._replace(intensity=_middle(stack.intensity, view)))
        if len(stack.led_na) < 4:
            raise ValueError(f"{len(stack.led_na)} LEDs below NA {widest}: give a larger --widest")
        half = np.random.default_rng(seed).permutation(len(stack.led_na)) % 2 == 0
        upsampling = least_upsampling(stack)
        # A network that does not fit is refused before minutes of calibration.
        ScorePrior.load(prior, tuple(upsampling * n for n in grid(stack).shape), dtype=complex)
        start = NOMINAL._replace(background=background)
        found = calibrate(stack.of(half), upsampling, start, progress=progress)
        return cls(stack.of(half), stack.of(~half), upsampling, found, prior, draws, seed)

    def __call__(self, system: str, condition: str, index: int) -> np.ndarray:
        return np.asarray(PTYCHOGRAPHY_SYSTEMS[system].answer(self.recording()))

    def recording(self) -> Recording:
        """What every system is given."""
        key_counts, key = jax.random.split(jax.random.key(self.seed))
        prior = ScorePrior.load(self.prior, self.found.object.shape, dtype=complex)
        o = self.found.object * prior_scale(self.found.object, prior)
        fewer = dispersed(self.fitted, self.found.dispersion, key_counts)
        likelihood, y = self.found.calibration.likelihood(fewer, self.upsampling, o)
        return Recording(likelihood, y, self.prior, key, self.draws, measured=True)

    def residuals(self, o: np.ndarray) -> tuple[float, ...]:
        """Squared residuals over photon noise of an object (h, w).

        Of bright and of dark fields that were fitted, then of those held out; nan of none. Each
        LED has the brightness and the background that fit its image best.
        """
        values = []
        for stack in (self.fitted, self.held_out):
            for leds in (stack.bright, ~stack.bright):
                values.append(self._misfit(stack.of(leds), o) if leds.any() else np.nan)
        return tuple(values)

    def expected(self, stack: Stack, o: np.ndarray) -> np.ndarray:
        """Expected electrons (LEDs, n0, n1) of a stack of electrons behind an object (h, w)."""
        likelihood, _ = self.found.calibration.likelihood(stack, self.upsampling, o)
        return np.asarray(likelihood.expected(jnp.asarray(o)), float) * likelihood.camera.full_well

    def _misfit(self, stack: Stack, o: np.ndarray) -> float:
        likelihood, y = self.found.calibration.likelihood(stack, self.upsampling, o)
        return misfit(likelihood, y, o[None])


def _middle(images: np.ndarray, view: int) -> np.ndarray:
    shape = images.shape[1:]
    view = min(shape) if view == 0 else view
    if not 16 <= view <= min(shape):
        raise ValueError(f"--view {view}: give 16 to {min(shape)} pixels, or 0 for all")
    top, left = ((n - view) // 2 for n in shape)
    return images[:, top : top + view, left : left + view]


def stack_table(study: StackHalves, answers: dict[str, Answer]) -> str:
    """Markdown: squared residuals over photon noise (1 is right), of the mean and of a draw.

    The first row is of the object that was found with the calibration.
    """
    leds = len(study.fitted.led_na), len(study.held_out.led_na)
    text = (
        f"{leds[0]} LEDs are fitted, {leds[1]} held out; objects of {study.found.object.shape}. "
        "Squared residuals over the variance of photon noise, sum over sum: 1 where photons alone "
        f"scatter. {_background_of(study)}\n"
    )
    lines = [text, row_of(_HEAD), "|" + "---|" * len(_HEAD)]
    lines.append(row_of(["calibration", *_numbers(study.residuals(study.found.object)), *[""] * 4]))
    for name, answer in answers.items():
        if not answer.refusal:
            lines.append(row_of([name, *_row(study, answer)]))
    return "\n".join([*lines, "", *refusals(answers)])


def _background_of(study: StackHalves) -> str:
    if not study.found.calibration.background:
        return "The images are taken to hold no background."
    share = study.found.background / study.fitted.intensity.mean(axis=(1, 2))
    parts = {"bright": study.fitted.bright, "dark": ~study.fitted.bright}
    said = [
        f"{100 * np.median(share[k]):.1f} % of {name} fields"
        for name, k in parts.items()
        if k.any()
    ]
    return f"Background is {' and '.join(said)} (median)."


def _row(study: StackHalves, answer: Answer) -> list[str]:
    draws = answer.images[0]
    row = _numbers(study.residuals(draws.mean(axis=0)))
    row += _numbers(study.residuals(draws[0])[2:]) if len(draws) > 1 else ["", ""]
    return [*row, f"{answer.seconds[0] / len(draws):.2g}", f"{answer.memory / 1e6:.0f}"]


def _numbers(values: tuple[float, ...]) -> list[str]:
    return [f"{value:.2f}" for value in values]
