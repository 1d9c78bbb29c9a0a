"""A run in words: the numbers found, and what stands against believing them."""

from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

from .summary import LEVEL, MIXED

_PERCENT = f"{LEVEL * 100:.0f} %"
_COVERED = {
    "coverage": "pixels",
    "coverage_amplitude": "pixels, in amplitude",
    "coverage_phase": "pixels, in phase",
}
# Of a card's calibration (`prior_calibration.worth`), and the level of the test that it is right.
_HELD = {
    "inside": "pixels",
    "inside_8x8_means": "8x8 means",
    "inside_image_means": "image means",
    "inside_bright_areas": "bright areas",
}
_MISSED = 0.01
_PICTURES = 32
_FEW = 100
_TOO_NARROW = 0.85
_FAINT = 0.4  # of full well
_UNEXPLAINED = 1.5
_APPROXIMATE = (
    "annealed", "annealed-split", "ula", "split-gibbs", "daps", "dps", "kawar", "snips",
)  # fmt: skip


def findings(results: dict[str, float]) -> list[str]:
    """The numbers of a run in words."""
    said = []
    if "psnr_data" in results:
        said.append(f"PSNR of the recording: {results['psnr_data']:.2f} dB")
    if "psnr_mean" in results:
        said.append(f"PSNR of the posterior mean: {results['psnr_mean']:.2f} dB")
    said += [
        f"truth inside the {_PERCENT} interval: {100 * value:.1f} % of the {_COVERED[name]}"
        for name, value in results.items()
        if name in _COVERED
    ]
    if "rhat" in results:
        said.append(f"R-hat, largest of all pixels: {results['rhat']:.4g}")
    if "misfit" in results:
        said.append(f"squared residual over the noise: {results['misfit']:.2f}, 1 is right")
    if "ess" in results:
        said.append(f"effective draws, smallest of all pixels: {results['ess']:.0f}")
    return said


def doubts(
    results: dict[str, float],
    sampler: str,
    card: dict[str, Any] | None = None,
    picture: np.ndarray | None = None,
) -> list[str]:
    """What stands against believing the intervals.

    `card` of the weights, if the prior is one; `picture`: the recording, if it is of the object.
    """
    said = [] if card is None else [_learnt(card, sampler, picture is not None)]
    said += out_of_range(card, picture)
    if "rhat" not in results and "ess" not in results:
        said.append(
            "convergence is not checked: that takes 2 chains and 4 draws of each, give --chains 4 "
            "and --draws 4"
        )
    if results.get("rhat", 0.0) > MIXED:
        said.append(
            f"the chains have not mixed: R-hat is above {MIXED} in "
            f"{100 * results['unmixed']:.1f} % of the pixels, up to {results['rhat']:.3g}; do not "
            "trust the intervals there, give more --thin, --draws or --warmup"
        )
    if results.get("modes", 1) > 1:
        said.append(
            f"the draws fall into {results['modes']} modes, {100 * results['largest_mode']:.0f} % "
            "of them into the largest: mean and sd are of no one object, look at the draws"
        )
    if results.get("ess", _FEW) < _FEW:
        said.append(
            f"only {results['ess']:.0f} effective draws in the worst pixel: the ends of its "
            f"interval are rough below {_FEW}, give more --draws"
        )
    if results.get("misfit", 0.0) > _UNEXPLAINED:
        said.append(
            f"the draws do not explain the recording: it is {results['misfit']:.2g} times as far "
            "from them as its noise allows, in variance; full well, optics or prior are not what "
            "was said, and the intervals are too narrow"
        )
    if results.get("dispersion", 0.0) > _UNEXPLAINED:
        said.append(
            f"photon noise does not explain the images: the calibrated microscope leaves "
            f"{results['dispersion']:.2g} times its variance (median of the LEDs), and the draws "
            "take each image for one of so many times fewer electrons; the intervals are true if "
            "the rest is as independent from pixel to pixel as photons are"
        )
    if np.isnan(results.get("dispersion", 0.0)):
        said.append(
            "the stack has no more pixels than its object has unknowns: whether photon noise "
            "explains the images cannot be told"
        )
    if "dispersion" in results and card is not None:
        said.append(
            "the slow phase of a stack scatters as halves of its images disagree, and is that of "
            "its start in all draws of a chain: more --chains tell more of it, more --draws only "
            "of the rest. On a measured stack, draws of two halves of 61 LEDs lay 1.4 times as far "
            "apart as they spread: its sd is too small by that, or more"
        )
    if sampler in _APPROXIMATE:
        said.append(f"{sampler} is approximate: check its intervals against mala or nuts")
    for name, value in results.items():
        if name in _COVERED and value < _TOO_NARROW:
            said.append(
                f"the intervals are too narrow: they hold the truth in {100 * value:.0f} % of the "
                f"{_COVERED[name]}, not {_PERCENT}; the prior does not describe this picture, or "
                "the chains have not mixed"
            )
    return said


def _learnt(card: dict[str, Any], sampler: str, denoises: bool) -> str:
    """What the intervals of a learnt prior are known to be worth."""
    found = card.get("validation", {}).get("calibration", {})
    # Cards that do not say so are of counts, which have one sampler.
    by = next(iter(found.values()), {}).get("sampler", "thickening")
    if not found:
        return (
            "the prior is learnt, and its card holds no calibration: check its intervals on "
            "pictures whose truth is known"
        )
    if not denoises or sampler != by:
        return (
            f"the prior is learnt, and its card holds the calibration of denoising by {by} alone: "
            "check these intervals on pictures whose truth is known"
        )
    told = [
        f"{', '.join(held_shares(row))} at full well {well} ({100 * row['nominal']:.0f} % is right)"
        for well, row in found.items()
    ]
    pictures = card["validation"].get("patches", _PICTURES)
    wrong = [
        words
        for name, words in _HELD.items()
        if any(
            name in row and missed(row[name], row["nominal"], pictures) for row in found.values()
        )
    ]
    advice = f"; do not state {' or '.join(wrong)} from it" if wrong else ""
    return (
        "the prior is learnt: on pictures like its own that were held out its intervals held "
        f"{'; '.join(told)}{advice}; of other pictures nothing is known"
    )


def missed(share: float, nominal: float, pictures: int) -> bool:
    """Whether intervals that hold so few truths hold less than `nominal`, at 1 %.

    Pictures are the unit, one truth each: what is inside one of them is not independent.
    """
    return scipy.stats.binom(pictures, nominal).cdf(round(share * pictures)) < _MISSED


def held_shares(row: dict[str, Any]) -> list[str]:
    """A row of a card's calibration in words: "85 % of pixels", and so on."""
    return [f"{100 * row[name]:.0f} % of {words}" for name, words in _HELD.items() if name in row]


def out_of_range(card: dict[str, Any] | None, picture: np.ndarray | None) -> list[str]:
    """Whether the picture is as bright as those the prior was trained on; as `doubts`."""
    if card is None or picture is None:
        return []
    percentile = card.get("preparation", {}).get("percentile")
    if percentile is None:
        return []
    bright = float(np.percentile(picture, percentile))
    if bright >= _FAINT:
        return []
    return [
        f"the recording reaches {bright:.2g} of white, the prior's pictures 1 (their "
        f"{percentile:g}th percentile): say with --white how many electrons its brightest pixels "
        f"have, about {bright:.2g} of what white has now (unsaid, the full well)"
    ]


def headline(settings: dict[str, Any]) -> str:
    """The title of the figure."""
    options, results = settings["options"], settings["results"]
    parts = [options["problem"]]
    if options["full_well"] is not None:
        parts = [f"{options['problem']}, full well {options['full_well']} electrons"]
    if "psnr_data" in results:
        parts.append(f"recording {results['psnr_data']:.1f} dB")
    if "psnr_mean" in results:
        parts.append(f"mean {results['psnr_mean']:.1f} dB")
    return ", ".join(parts)


def tell(out: Path, settings: dict[str, Any]) -> None:
    """Print a run: what it was, what was found, the doubts, and where it was written."""
    options, results = settings["options"], settings["results"]
    print(
        f"{options['problem']} of {settings['input']['file']}: {options['sampler']}, "
        f"{options['chains']} chains x {options['draws']} draws, {settings['seconds']:.0f} s"
    )
    for line in findings(results):
        print(line)
    for warning in settings["warnings"]:
        print(f"warning: {warning}")
    print(f"written to {out}")
