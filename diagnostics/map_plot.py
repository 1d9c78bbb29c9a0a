"""Maps of numbers a pixel: residuals, R-hat, effective sizes and scores, on scales that mean it."""

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

_SIGNED, _RISING, _UNSAID = "RdBu_r", "viridis", "0.75"


def plot_residuals(residuals: np.ndarray, axes: Axes | None = None, limit: float = 4.0) -> Axes:
    """Draw residuals (h, w) in sds of the noise, such as those of `normalised_residuals`.

    Red is more light than the draws predict, blue less, white as much; the scale ends at `limit`
    sds, which of normal noise 6 pixels in 100,000 are beyond. Structure is what object, optics and
    noise do not explain. Pixels without a number (nan) are grey. Returns the axes, new ones unless
    given. Raises ValueError for residuals that are complex or no picture, and limits of 0 or less.
    """
    residuals = _picture(residuals, "residuals")
    if not limit > 0:
        raise ValueError(f"limit {limit}: give sds of the noise, above 0")
    beyond = np.mean(np.abs(residuals[np.isfinite(residuals)]) > limit)
    axes = _drawn(residuals, axes, Normalize(-limit, limit), _SIGNED, "residual / sd of the noise")
    axes.set_title(f"{100 * beyond:.2g} % beyond {limit:g} sd", fontsize=9)
    return axes


def plot_rhat(found: np.ndarray, axes: Axes | None = None, limit: float = 1.01) -> Axes:
    """Draw a map (h, w) of `rhat`, or of `nested_rhat` with the `limit` that belongs to it.

    From 1, or the least there is, to the largest, and to `limit` at least; the title says how many
    pixels are above it. Pixels that do not vary (nan) are grey; chains that never agree (infinity)
    have the last colour. Returns the axes, new ones unless
    given. Raises ValueError for what is no real picture.
    """
    found = _picture(found, "R-hat")
    finite = found[np.isfinite(found)]
    scale = Normalize(finite.min(initial=1.0), finite.max(initial=limit))
    axes = _drawn(found, axes, scale, _RISING, "R-hat")
    axes.set_title(f"{np.sum(found > limit)} of {found.size} pixels above {limit:g}", fontsize=9)
    return axes


def plot_ess(
    found: np.ndarray, axes: Axes | None = None, least: float = 400, label: str = "bulk ESS / draws"
) -> Axes:
    """Draw a map (h, w) of `ess`, in independent draws; dark is few.

    From 0 to the largest, and to `least` at least; the title says how many pixels are below it (400
    for four chains, Vehtari et al. 2021). Pixels that do not vary (nan) are grey. Returns the axes,
    new ones unless given. Raises ValueError for what is no real picture.
    """
    found = _picture(found, "effective sizes")
    scale = Normalize(0, found[np.isfinite(found)].max(initial=least))
    axes = _drawn(found, axes, scale, _RISING, label)
    axes.set_title(f"{np.sum(found < least)} of {found.size} pixels below {least:g}", fontsize=9)
    return axes


def plot_crps(
    scores: np.ndarray | Mapping[str, np.ndarray], axes: Axes | None = None, unit: str = "object"
) -> Axes:
    """Draw a map (h, w) of `crps`, or of several systems, {name: (images,)}, a bar for each.

    In the object's unit, which `unit` names; 0 is best. A bar is the mean over images, each of
    which is a dot: systems that saw the same images are compared dot by dot. Returns the axes, new
    ones unless given. Raises ValueError for nothing to draw, and what is no real picture.
    """
    label = f"CRPS / {unit}"
    if not isinstance(scores, Mapping):
        scores = _picture(scores, "scores")
        top = scores[np.isfinite(scores)].max(initial=0)
        axes = _drawn(scores, axes, Normalize(0, top or 1), _RISING, label)
        axes.set_title(f"mean {np.nanmean(scores):.3g}", fontsize=9)
        return axes
    if not scores or not all(np.size(one) for one in scores.values()):
        raise ValueError("no scores to draw: give {name: scores (images,)}, one image or more")
    if axes is None:
        axes = Figure(figsize=(1.6 + 0.8 * len(scores), 3.4), layout="constrained").add_subplot()
    for place, one in enumerate(scores.values()):
        axes.bar(place, np.mean(one), 0.7, color="#bfdcf0")
        across = place + np.linspace(-0.25, 0.25, np.size(one) + 2)[1:-1]
        axes.plot(across, np.ravel(one), "o", ms=3, color="#4a86b8")
    axes.set_xticks(range(len(scores)), list(scores))
    axes.set_ylabel(label)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _drawn(
    picture: np.ndarray, axes: Axes | None, scale: Normalize, colours: str, label: str
) -> Axes:
    """A map and its scale; what has no number is grey."""
    if axes is None:
        height, width = picture.shape
        size = (4.6, 0.5 + 3.4 * height / width)
        axes = Figure(figsize=size, layout="constrained").add_subplot()
    shown = axes.imshow(
        # Infinity would be left blank, as what has no number.
        np.ma.masked_invalid(np.nan_to_num(picture, nan=np.nan, posinf=scale.vmax)),
        norm=scale,
        cmap=mpl.colormaps[colours].with_extremes(bad=_UNSAID),
        interpolation="nearest",
    )
    axes.set(xticks=[], yticks=[])
    axes.figure.colorbar(shown, ax=axes, label=label)
    return axes


def _picture(found: np.ndarray, name: str) -> np.ndarray:
    found = np.asarray(found)
    if np.iscomplexobj(found) or found.ndim != 2 or not found.size:
        raise ValueError(
            f"{name} of shape {found.shape}, {found.dtype}: give a real picture (h, w); of a "
            "complex one .real and .imag, one at a time"
        )
    return found
