"""Writes the records of a dictionary to files for other programs."""

from __future__ import annotations

import os
import pathlib
import tempfile
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray

# Axes of the records, slowest first: the numbers of the records follow them.
_AXES = ("sample_ior", "sigma_t_per_mm", "g", "thickness_mm", "albedo")
# Axes along which a chunk of a Zarr store has the length 1.
_OUTER = ("sample_ior", "sigma_t_per_mm", "g")


def write_zarr(dataset: xarray.Dataset, path: pathlib.Path) -> None:
    """Writes a store that appears at the path once it is complete.

    Raises:
        FileExistsError: if there is something at the path.
    """
    if path.exists():
        raise FileExistsError(f"{path} exists, and a store is not written over: delete it, or choose another path")
    # Zarr's own text type, since NumPy's of fixed length is not in the specification.
    dataset = dataset.assign_coords(channel=dataset["channel"].astype(object))
    chunks = {name: 1 if name in _OUTER else length for name, length in dataset.sizes.items()}
    encoding = {name: {"chunks": tuple(chunks[axis] for axis in dataset[name].dims)} for name in dataset.data_vars}
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
        draft = pathlib.Path(folder, "draft")
        with warnings.catch_warnings():
            # Consolidated metadata are not in the specification yet; readers that do not support them skip them.
            warnings.filterwarnings("ignore", message=".*[Cc]onsolidated metadata")
            dataset.to_zarr(draft, mode="w-", zarr_format=3, encoding=encoding)
        draft.rename(path)


def write_parquet(dataset: xarray.Dataset, about: dict[str, Any], path: pathlib.Path) -> None:
    """Writes a row for each record and channel. The file replaces another one once it is complete."""
    import pandas

    keys = (*_AXES, "channel")
    grid = np.meshgrid(*(dataset[name].values for name in keys), indexing="ij")
    columns: dict[str, Any] = {name: values.ravel() for name, values in zip(keys, grid, strict=True)}
    channels = dataset.sizes["channel"]
    columns = {"record": np.arange(columns["albedo"].size, dtype=np.int32) // channels} | columns
    for name, variable in dataset.data_vars.items():
        columns[str(name)] = list(variable.values.reshape(-1, dataset.sizes["x_mm"]))
    frame = pandas.DataFrame(columns)
    frame.attrs = {"about": about, "x_mm": dataset["x_mm"].values.tolist()}
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
        draft = pathlib.Path(folder, "draft")
        frame.to_parquet(draft, engine="pyarrow", index=False)
        os.replace(draft, path)
