"""Figure of a measured stack's study: an image that no system has seen, as each foretells it."""

import numpy as np
from matplotlib.figure import Figure

from .harness import Answer
from .stack_halves import StackHalves

_WORST = 8.0  # sd of photon noise, at the ends of the colours


def prediction(study: StackHalves, answers: dict[str, Answer]) -> Figure:
    """A held-out image as measured and as the mean of each system's draws predicts it; residuals.

    The bright-field LED nearest the middle, or the nearest of all where none is held out. Residuals
    are over the sd of photon noise, as predicted; titles give their mean square.
    """
    stack = study.held_out
    some = stack.of(stack.bright) if stack.bright.any() else stack
    led = np.linalg.norm(some.led_na, axis=1).argmin()
    one = some.of([led])
    figure = Figure(figsize=(2.6 * (len(answers) + 1), 5.0), layout="constrained")
    axes = figure.subplots(2, len(answers) + 1, squeeze=False)
    for axis in axes.ravel():
        axis.set_axis_off()
    measured = one.intensity[0]
    # One scale, without the few brightest pixels.
    grey = {"cmap": "gray", "vmin": 0, "vmax": np.quantile(measured, 0.999)}
    axes[0, 0].imshow(measured, **grey)
    axes[0, 0].set_title("measured, held out", fontsize=9)
    for (above, below), (name, answer) in zip(axes.T[1:], answers.items()):
        expected = study.expected(one, answer.images[0].mean(axis=0))[0]
        residual = (measured - expected) / np.sqrt(expected)
        draws = len(answer.images[0])
        above.imshow(expected, **grey)
        above.set_title(f"{name}, mean of {draws}" if draws > 1 else name, fontsize=9)
        shown = below.imshow(residual, cmap="RdBu_r", vmin=-_WORST, vmax=_WORST)
        below.set_title(f"residual, mean square {np.mean(residual**2):.1f}", fontsize=9)
    if answers:
        # In the empty place below the measured image.
        bar = figure.colorbar(shown, cax=axes[1, 0].inset_axes((0.6, 0.05, 0.06, 0.9)))
        bar.set_label("sd of photon noise", fontsize=9)
    return figure
