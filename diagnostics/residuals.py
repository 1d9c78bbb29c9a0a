"""Does the noise model hold? What a recording leaves over where its mean and variance are known."""

from typing import NamedTuple

import numpy as np
import scipy.stats

from .checks import check_finite, check_real


class Check(NamedTuple):
    """A figure, what it is under the noise model, and its standard error there."""

    value: float
    nominal: float
    error: float

    @property
    def p(self) -> float:
        """Two-sided, taking the figure as normal."""
        return float(2 * scipy.stats.norm.sf(abs(self.value - self.nominal) / self.error))


class Residuals(NamedTuple):
    """`square`: of residuals, over their variance; off where gain or full well are.

    `rows`, `columns`: correlation with the next pixel of the row, of the column; off where a
    detector is slow or pictures were filtered. `blocks`: square of the residuals' sum over a block,
    over its variance; off where light or scene drift by region.
    """

    square: Check
    rows: Check
    columns: Check
    blocks: Check


def residual_checks(difference: np.ndarray, variance: np.ndarray, block: int = 32) -> Residuals:
    """Of `difference` (h, w), recording less its mean, and the `variance` (h, w) of its noise.

    Under the model pixels are independent with these variances; figures are sums over pixels of
    what is measured over sums of what is expected, so that dark pixels do not count for more than
    they tell. A pixel of variance 0 is left out. With a draw of the posterior in place of the truth
    they hold as well, for truth and draw are exchangeable; with the posterior mean they do not.
    Approximations: errors of `rows` and `columns` are exact, that of `square` is measured, that of
    `blocks` takes a block's sum as normal. Raises ValueError for unlike shapes, values that are
    complex or not finite, negative variances, fewer than two whole blocks, and where nothing is
    left.
    """
    difference, variance = np.asarray(difference), np.asarray(variance)
    check_real(differences=difference, variances=variance)
    difference, variance = difference.astype(float), variance.astype(float)
    if difference.shape != variance.shape or difference.ndim != 2:
        raise ValueError(
            f"difference {difference.shape} and variance {variance.shape}: give one (h, w) for both"
        )
    for name, array in (("differences", difference), ("variances", variance)):
        check_finite(name, array, "give such pixels the difference 0 and the variance 0")
    if not (np.all(variance >= 0) and variance.sum() > 0):
        raise ValueError(
            f"variances from {variance.min(initial=0):g} to {variance.max(initial=0):g}: give "
            "variances from 0 up that are not all 0"
        )
    if int(block) != block or block < 1:
        raise ValueError(f"blocks of {block}: give a whole number of pixels, 1 or more")
    block = int(block)
    if np.prod([n // block for n in difference.shape]) < 2:
        raise ValueError(f"blocks of {block} in {difference.shape}: at least two must fit")
    difference = np.where(variance > 0, difference, 0.0)
    return Residuals(
        _square(difference, variance),
        _neighbours(difference, variance),
        _neighbours(difference.T, variance.T),
        _blocks(difference, variance, block),
    )


def _square(difference: np.ndarray, variance: np.ndarray) -> Check:
    excess = difference**2 - variance
    scale = variance.sum()
    return Check(
        float((difference**2).sum() / scale), 1.0, float(np.sqrt((excess**2).sum()) / scale)
    )


def _neighbours(difference: np.ndarray, variance: np.ndarray) -> Check:
    products = difference[:, 1:] * difference[:, :-1]
    variances = variance[:, 1:] * variance[:, :-1]
    scale = np.sqrt(variances).sum()
    return Check(float(products.sum() / scale), 0.0, float(np.sqrt(variances.sum()) / scale))


def _blocks(difference: np.ndarray, variance: np.ndarray, block: int) -> Check:
    sums, variances = _block_sums(difference, block), _block_sums(variance, block)
    scale = variances.sum()
    return Check(
        float((sums**2).sum() / scale), 1.0, float(np.sqrt(2 * (variances**2).sum()) / scale)
    )


def _block_sums(image: np.ndarray, block: int) -> np.ndarray:
    h, w = (n // block for n in image.shape)
    return image[: h * block, : w * block].reshape(h, block, w, block).sum(axis=(1, 3))
