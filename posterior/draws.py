"""Draws: what a run returns, labelled, on disk and off."""

import importlib.metadata
import json
import os
from typing import Any

import jax
import numpy as np
import xarray as xr

from .files import replace_whole

_OBJECT_DIMS = {0: (), 1: ("pixel",), 2: ("row", "col"), 3: ("row", "col", "channel")}


class Draws:
    """Draws of a posterior, with sampler statistics, data and settings, in one xarray Dataset.

    Variables of `dataset`: `draws` (chain, draw, row, col) unless the run did not keep them; `mean`
    and `variance` (chain, row, col), streamed over all draws (complex objects: the variance of Re,
    and in the imaginary part that of Im); a variable (chain, draw) for each sampler statistic; the
    recorded `data`. A 1-D object has the dimension `pixel` instead of row, col.
    """

    def __init__(self, dataset: xr.Dataset):
        self.dataset = dataset

    @classmethod
    def build(
        cls,
        values: np.ndarray | None,
        mean: np.ndarray,
        variance: np.ndarray,
        stats: dict[str, np.ndarray],
        data: np.ndarray,
        settings: dict[str, Any],
    ) -> "Draws":
        """Label plain arrays: `values` (chains, draws, *shape) or None; moments a chain."""
        dims = _object_dims(mean.ndim - 1)
        variables = {"mean": (("chain", *dims), mean), "variance": (("chain", *dims), variance)}
        if values is not None:
            variables["draws"] = (("chain", "draw", *dims), values)
        variables |= {name: (("chain", "draw"), value) for name, value in stats.items()}
        data_dims = tuple(f"data_{i}" for i in range(data.ndim))
        variables["data"] = (data_dims, data)
        return cls(xr.Dataset(variables, attrs={"settings": json.dumps(settings)}))

    @property
    def values(self) -> np.ndarray:
        """Draws (chains, draws, *object shape) in the object's dtype."""
        if "draws" not in self.dataset:
            raise ValueError("this run kept no draws (keep=False): only mean and sd are here")
        return self.dataset["draws"].values

    @property
    def mean(self) -> np.ndarray:
        """Posterior mean over all chains, object shape."""
        return self.dataset["mean"].values.mean(axis=0)

    @property
    def sd(self) -> np.ndarray:
        """Posterior standard deviation over all chains, object shape; real.

        Complex objects: sqrt(E|x - mean|^2), Re and Im together. Raises ValueError for one draw.
        """
        return np.sqrt(_total(self.variance))

    @property
    def variance(self) -> np.ndarray:
        """Variance over all chains, between them included; Re + j Im parts for complex objects.

        Raises ValueError for one draw.
        """
        n = self.dataset.sizes.get("draw", 2)
        if n * self.dataset.sizes["chain"] < 2:
            raise ValueError("one draw has no spread: sample two or more, by draws or by chains")
        within = self.dataset["variance"].values.mean(axis=0) * ((n - 1) / n)
        deviation = self.dataset["mean"].values - self.mean
        if np.iscomplexobj(deviation):
            return within + (deviation.real**2 + 1j * deviation.imag**2).mean(axis=0)
        return within + (deviation**2).mean(axis=0)

    @property
    def stats(self) -> dict[str, np.ndarray]:
        """Sampler statistics, (chains, draws) each."""
        names = [n for n, v in self.dataset.data_vars.items() if v.dims == ("chain", "draw")]
        return {name: self.dataset[name].values for name in names if name != "draws"}

    @property
    def data(self) -> np.ndarray:
        """The recording that was conditioned on."""
        return self.dataset["data"].values

    @property
    def settings(self) -> dict[str, Any]:
        """Settings and versions of the run."""
        return json.loads(self.dataset.attrs["settings"])

    def save(self, path: str | os.PathLike) -> None:
        """Write NetCDF-4, complex included; an old file is replaced once this one is whole."""
        replace_whole(path, lambda part: self.dataset.to_netcdf(part, engine="h5netcdf"))

    def to_arviz(self) -> xr.DataTree:
        """ArviZ's groups posterior, sample_stats and observed_data; complex as two variables."""
        groups = {
            "posterior": _real_variables("x", self.dataset[["draws"]].rename(draws="x")),
            "sample_stats": self.dataset[list(self.stats)],
            "observed_data": _real_variables("data", self.dataset[["data"]]),
        }
        return xr.DataTree.from_dict({f"/{name}": group for name, group in groups.items()})

    def __repr__(self) -> str:
        sizes = dict(self.dataset.sizes)
        kept = "kept" if "draws" in self.dataset else "not kept"
        return f"Draws({kept}, {sizes}, sampler={self.settings.get('sampler', '?')})"


def load(path: str | os.PathLike) -> Draws:
    """Read draws that `Draws.save` wrote.

    Raises FileNotFoundError, or ValueError for a file that is truncated or holds no draws.
    """
    path = os.fspath(path)
    if not os.path.exists(path):
        raise FileNotFoundError(f"no file {path}: give the path of a saved run")
    try:
        dataset = xr.load_dataset(path, engine="h5netcdf")
    except Exception as error:
        raise ValueError(f"{path} is no readable NetCDF-4 file (truncated?): {error}") from error
    if "mean" not in dataset or "settings" not in dataset.attrs:
        raise ValueError(f"{path} holds no draws of this package: it was written by something else")
    return Draws(dataset)


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    names = ("posterior-imaging", "jax", "numpy", "blackjax", "emcee", "equinox")
    found = {name: importlib.metadata.version(name) for name in names}
    return found | {"x64": str(bool(jax.config.jax_enable_x64))}


def _object_dims(ndim: int) -> tuple[str, ...]:
    return _OBJECT_DIMS.get(ndim) or tuple(f"axis_{i}" for i in range(ndim))


def _total(variance: np.ndarray) -> np.ndarray:
    return variance.real + variance.imag if np.iscomplexobj(variance) else variance


def _real_variables(name: str, dataset: xr.Dataset) -> xr.Dataset:
    variable = dataset[name]
    if not np.iscomplexobj(variable.values):
        return dataset
    return xr.Dataset({f"{name}_real": variable.real, f"{name}_imag": variable.imag})
