"""What `farmctl export` writes is read by the programs that it is written for."""

import json
import pathlib
import subprocess
import warnings

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
import xarray as xr

import resin_farm
from resin_farm import _programs

DERIVATIVES = resin_farm.Grid(
    sigma_t_per_mm=[4, 8], albedo=[0.5, 0.9, 0.99], g=[0.0, 0.4], thickness_mm=[0.5, 1], walks=5000, derivatives=True
)


@pytest.fixture(scope="module")
def small(farm: resin_farm.Farm) -> resin_farm.Dictionary:
    return farm.submit(DERIVATIVES, "derivatives", progress=False)


def export(farm: resin_farm.Farm, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [_programs.program("farmctl"), "--server", farm.address, "export", "derivatives", *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=False)


def test_zarr_npz_and_parquet_hold_the_same_numbers(
    farm: resin_farm.Farm, small: resin_farm.Dictionary, tmp_path: pathlib.Path
) -> None:
    paths = {kind: tmp_path / f"small.{kind}" for kind in ("npz", "zarr", "parquet")}
    for kind, path in paths.items():
        ran = export(farm, f"--{kind}", str(path))
        assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")
    with np.load(paths["npz"]) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "about.json"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        store = xr.open_zarr(paths["zarr"]).load()
    rows = pd.read_parquet(paths["parquet"])
    names = ["value", "std_error", "d_albedo", "d_albedo_std_error", "d_sigma_t", "d_sigma_t_std_error"]
    assert set(store.data_vars) == set(names) and store["value"].shape == (1, 2, 2, 2, 3, 3, 360)
    for name in names:
        np.testing.assert_array_equal(store[name].values, arrays[name])
        np.testing.assert_array_equal(np.stack(rows[name].tolist()).ravel(), arrays[name].ravel())
    for axis in store.dims:
        np.testing.assert_array_equal(store[axis].values.astype(arrays[str(axis)].dtype), arrays[str(axis)])
    assert store["value"].attrs["units"] == "radiance factor" and store["x_mm"].attrs["units"] == "mm"
    assert store.attrs["dictionary"]["records_digest"] == small.records_digest
    metadata = pyarrow.parquet.read_metadata(paths["parquet"]).metadata
    assert json.loads(metadata[b"about"])["dictionary"]["records_digest"] == small.records_digest
    np.testing.assert_allclose(json.loads(metadata[b"x_mm"]), arrays["x_mm"])
    assert list(rows["channel"][:4]) == ["R", "G", "B", "R"] and rows["albedo"].nunique() == 3


def test_a_part_is_exported_and_nothing_is_written_over(
    farm: resin_farm.Farm, small: resin_farm.Dictionary, tmp_path: pathlib.Path
) -> None:
    path = tmp_path / "part.zarr"
    chosen = ["--g", "0.4", "--albedo", "0.5,0.99", "--zarr", str(path)]
    assert export(farm, *chosen).returncode == 0
    part, whole = xr.open_zarr(path)["value"], small.to_xarray()["value"]
    xr.testing.assert_equal(part.load(), whole.sel(g=[0.4], albedo=[0.5, 0.99]))
    again = export(farm, *chosen)
    assert again.returncode == 1 and "it is there already" in again.stderr
    assert list(tmp_path.iterdir()) == [path], "nothing half-written is left"
    assert export(farm, "--zarr", str(tmp_path / "none" / "x")).returncode == 1


def test_what_is_not_complete_is_refused_at_once(tmp_path: pathlib.Path) -> None:
    with resin_farm.Farm(tmp_path) as farm:
        # So many walks that it is not done in the meantime.
        grid = resin_farm.Grid(sigma_t_per_mm=[4, 8], albedo=[0.9], g=[0.0], thickness_mm=[1], walks=1_000_000_000)
        dictionary = farm.submit(grid, "derivatives", wait=False)
        for kind in ("npz", "zarr", "parquet"):
            ran = export(farm, f"--{kind}", str(tmp_path / "out"))
            assert ran.returncode == 1 and "0 of 2 records are done: arrays have no place" in ran.stderr, ran.stderr
            assert not (tmp_path / "out").exists()
        dictionary.cancel("enough")
        assert dictionary.refresh().state == "cancelled"
