"""Stored moments of the gallery's posteriors, with their standard errors, and how they are made."""

import os
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats

from .gallery import GALLERY, Exact, Known, file_name
from .realview import to_real

STORED = Path(__file__).parent / "references"
_SETS, _DRAWS = 50, 4000


class Reference(NamedTuple):
    """Moments of the posterior of one recording, from `sets` independent sets of exact draws.

    `mean` and `sd` (n,) are of the components of the real view (`realview.to_real`: real parts,
    then imaginary ones), `masses` (K,) the shares of draws nearest to each of `Known.modes`, with
    K = 0 where there are none. Each stands beside its standard error, from how the sets scatter.
    Where draws are by importance (`basis`) a set is worth fewer draws, which its errors show, and
    has a bias of the order of one over that number, in posterior sd.
    """

    recording: np.ndarray
    mean: np.ndarray
    mean_error: np.ndarray
    sd: np.ndarray
    sd_error: np.ndarray
    masses: np.ndarray
    masses_error: np.ndarray
    sets: int
    draws: int
    basis: str

    def worth(self) -> float:
        """How many independent draws would have these errors of the mean: the median over it."""
        return float(np.median((self.sd / self.mean_error) ** 2))


def make(
    known: Known, y: np.ndarray, key: jax.Array, sets: int = _SETS, draws: int = _DRAWS
) -> Reference:
    """The reference of `known` for the recording `y`, of `sets` sets of `draws` by `known.exact`.

    In the precision of JAX at the call: use `jax.enable_x64`. Raises ValueError for fewer than two
    sets, whose scatter is unknown, and for draws that are not finite.
    """
    if sets < 2:
        raise ValueError(f"{sets} sets of draws: give 2 or more, their scatter is the error")
    y = jnp.asarray(y)
    modes = None if known.modes is None else jax.vmap(to_real)(jnp.asarray(known.modes))

    found = _moments(known.exact, y, modes, draws, jax.random.split(key, sets))
    means, sds, masses = (np.asarray(part, float) for part in found)
    if not all(np.isfinite(part).all() for part in (means, sds, masses)):
        raise ValueError("the exact draws hold NaN: no proposal has any weight for this recording")
    # The spread of the sets' means is part of the spread of all draws.
    sd = np.sqrt((sds**2).mean(axis=0) + means.var(axis=0))
    errors = (part.std(axis=0, ddof=1) / np.sqrt(sets) for part in (means, sds, masses))
    mean_error, sd_error, masses_error = errors
    return Reference(
        np.asarray(y), means.mean(axis=0), mean_error, sd, sd_error,
        masses.mean(axis=0), masses_error, sets, draws, known.basis,
    )  # fmt: skip


@eqx.filter_jit
def _moments(
    exact: Exact, y: jax.Array, modes: jax.Array | None, draws: int, keys: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Means (sets, n), sds (sets, n) and masses (sets, K), a set after the other."""

    def of_set(key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        v = jax.vmap(to_real)(exact(key, y, draws))
        if modes is None:
            return v.mean(axis=0), v.std(axis=0), jnp.zeros(0)
        distances = jax.vmap(lambda mode: jnp.sum((v - mode) ** 2, axis=1), out_axes=1)(modes)
        nearest = jnp.argmin(distances, axis=1)[:, None] == jnp.arange(len(modes))
        return v.mean(axis=0), v.std(axis=0), nearest.astype(v.dtype).mean(axis=0)

    return jax.lax.map(of_set, keys)


def apart(a: Reference, b: Reference) -> tuple[float, float]:
    """The largest difference of two references in standard errors, and its p-value.

    Over all their numbers, by Bonferroni, with Student's t of the smaller number of sets. Raises
    ValueError for references of other recordings or sizes, and for numbers that are not finite.
    """
    sizes = [(one.mean.shape, one.masses.shape) for one in (a, b)]
    if not np.array_equal(a.recording, b.recording) or sizes[0] != sizes[1]:
        raise ValueError("the references are of different recordings: compare those of one")
    z = []
    for name in ("mean", "sd", "masses"):
        error = np.hypot(getattr(a, f"{name}_error"), getattr(b, f"{name}_error"))
        difference = np.abs(getattr(a, name) - getattr(b, name))
        # A mode that no draw is near has the mass 0 in both, without error.
        z.append(difference[difference != 0] / error[difference != 0])
    z = np.concatenate(z)
    if not np.isfinite(z).all():
        raise ValueError("a reference holds NaN, or an error of 0: make it again")
    if not z.size:
        return 0.0, 1.0
    p = 2 * scipy.stats.t(min(a.sets, b.sets) - 1).sf(z.max()) * z.size
    return float(z.max()), float(min(p, 1.0))


def save(reference: Reference, file: str | os.PathLike) -> None:
    """As an archive of NumPy, an array a field, under this very name."""
    # To names, not to open files, NumPy adds an ending.
    with open(file, "wb") as opened:
        np.savez_compressed(opened, **reference._asdict())


def load(name: str, folder: str | os.PathLike = STORED) -> Reference:
    """The stored reference of a problem of the gallery.

    Raises ValueError for a name that is not in the gallery, FileNotFoundError where nothing is
    stored, ValueError for a file that is damaged.
    """
    if name not in GALLERY:
        raise ValueError(f"unknown problem {name!r}: use one of {'; '.join(GALLERY)}")
    file = Path(folder) / f"{file_name(name)}.npz"
    # Opened here: NumPy leaves a damaged file open.
    with open(file, "rb") as opened:
        try:
            with np.load(opened, allow_pickle=False) as kept:
                fields = {field: kept[field] for field in Reference._fields}
        except Exception as error:  # of a damaged archive: of many kinds
            raise ValueError(f"{file} is damaged: restore it from the project") from error
    plain = {"sets": int, "draws": int, "basis": str}
    return Reference(**{k: plain.get(k, np.asarray)(v) for k, v in fields.items()})
