"""Exports of a dictionary are read back by the packages that they are written for."""

import io
import json
import pathlib
import subprocess
import sys
import warnings

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import resin_farm
from resin_farm import _programs

DERIVATIVES = resin_farm.Grid(
    sigma_t_per_mm=[4, 8], albedo=[0.5, 0.9, 0.99], g=[0.0, 0.4], thickness_mm=[0.5, 1], walks=5000, derivatives=True
)
NAMES = ["value", "std_error", "d_albedo", "d_albedo_std_error", "d_sigma_t", "d_sigma_t_std_error"]


@pytest.fixture(scope="module")
def small(farm: resin_farm.Farm) -> resin_farm.Dictionary:
    return farm.submit(DERIVATIVES, "derivatives", progress=False)


def export(farm: resin_farm.Farm, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [_programs.program("farmctl"), "--server", farm.address, "export", "derivatives", *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=False)


@pytest.fixture(scope="module")
def arrays(farm: resin_farm.Farm, small: resin_farm.Dictionary, tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    """The arrays that farmctl writes."""
    path = tmp_path_factory.mktemp("npz") / "small.npz"
    ran = export(farm, "--npz", str(path))
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")
    with np.load(path) as archive:
        about = json.loads(archive["about.json"])
        coords = {axis: archive[axis] for axis in about["axes"]}
        return xr.Dataset({name: (about["axes"], archive[name]) for name in NAMES}, coords, about)


def test_responses_have_their_variant_and_rows(tmp_path: pathlib.Path) -> None:
    """The arrays have the numbers of the exported rows, and differ from the records of the axes by the step."""
    grid = resin_farm.Grid(
        sigma_t_per_mm=[4, 6, 8], albedo=[0.9, 0.99], g=[0.4], thickness_mm=[1], scene="lab", walks=5000
    )
    with resin_farm.Farm(tmp_path) as farm:
        dictionary = farm.submit(grid, "derivatives", progress=False)
        responses, records = dictionary.responses(), dictionary.to_xarray()
        ran = export(farm, "--responses")
    rows = pd.read_csv(io.StringIO(ran.stdout), float_precision="round_trip")
    keys = ["sample_ior", "sigma_t_per_mm", "g", "thickness_mm", "albedo", "channel", "x_mm"]
    assert responses["value"].dims == ("variant", *keys)
    assert responses["sigma_t_per_mm"].values.tolist() == [4, 8], "nodes of the responses"
    np.testing.assert_array_equal(rows["value"].astype(np.float32), responses["value"].values.ravel())
    np.testing.assert_array_equal(rows["std_error"].astype(np.float32), responses["std_error"].values.ravel())
    of_variant = rows.groupby(["quantity", "step"], sort=False)["unit"].first().reset_index()
    assert of_variant["quantity"].tolist() == responses["quantity"].values.tolist()
    assert of_variant["step"].tolist() == responses["step"].values.tolist()
    assert set(responses["unit"].values) == {"", "mm", "°"}
    thicker = responses.isel(variant=(responses["quantity"] == "gel thickness").values)
    assert responses["quantity"].values.tolist()[-1] == "baseline"
    change = abs(thicker["value"] - records["value"].sel(sigma_t_per_mm=[4, 8])).mean([*keys])
    assert 0 < change[0] < change[1] < 0.1, "steps of −0.015 and 0.08 mm"


def test_an_exact_scene_has_no_responses(small: resin_farm.Dictionary) -> None:
    with pytest.raises(resin_farm.FarmError, match="the dictionary has no responses: its scene is exact"):
        small.responses()


def test_a_zarr_store_has_arrays_and_attributes(
    small: resin_farm.Dictionary, arrays: xr.Dataset, tmp_path: pathlib.Path
) -> None:
    path = tmp_path / "small.zarr"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        small.to_zarr(path)
        store = xr.open_zarr(path).load()
    assert set(store.data_vars) == set(NAMES) and store["value"].shape == (1, 2, 2, 2, 3, 3, 360)
    assert store["value"].dtype == np.float32
    xr.testing.assert_equal(store, arrays)
    assert store["value"].attrs["units"] == "radiance factor" and store["x_mm"].attrs["units"] == "mm"
    assert store.attrs == arrays.attrs
    assert store.attrs["dictionary"]["records_digest"] == small.records_digest
    head = json.loads((path / "value" / "zarr.json").read_text(encoding="utf-8"))
    assert head["chunk_grid"]["configuration"]["chunk_shape"] == [1, 1, 1, 2, 3, 3, 360]
    assert json.loads((path / "zarr.json").read_text(encoding="utf-8"))["zarr_format"] == 3
    before = sorted(path.rglob("*"))
    with pytest.raises(FileExistsError, match="is not written over"):
        small.to_zarr(path)
    assert sorted(path.rglob("*")) == before and list(tmp_path.iterdir()) == [path], "nothing half-written is left"
    with pytest.raises(FileNotFoundError):
        small.to_zarr(tmp_path / "none" / "x")


def test_a_parquet_file_has_a_row_for_each_channel(
    small: resin_farm.Dictionary, arrays: xr.Dataset, tmp_path: pathlib.Path
) -> None:
    path = tmp_path / "small.parquet"
    for _ in range(2):
        small.to_parquet(path)
    assert list(tmp_path.iterdir()) == [path], "nothing half-written is left"
    rows = pd.read_parquet(path)
    keys = ["sample_ior", "sigma_t_per_mm", "g", "thickness_mm", "albedo"]
    assert list(rows.columns) == ["record", *keys, "channel", *NAMES]
    for name in NAMES:
        pixels = np.stack(rows[name].tolist())
        assert pixels.dtype == np.float32
        np.testing.assert_array_equal(pixels.ravel(), arrays[name].values.ravel())
    assert list(rows["channel"][:4]) == ["R", "G", "B", "R"] and list(rows["record"][:4]) == [0, 0, 0, 1]
    # The parameters of a row identify its pixels.
    row = rows.iloc[50]
    found = arrays["value"].sel({name: row[name] for name in [*keys, "channel"]})
    np.testing.assert_array_equal(row["value"], found)
    assert rows.attrs["about"] == arrays.attrs
    assert rows.attrs["about"]["dictionary"]["records_digest"] == small.records_digest
    assert rows.attrs["x_mm"] == arrays["x_mm"].values.tolist()


def test_the_rows_have_the_numbers_of_farmctl(
    farm: resin_farm.Farm, small: resin_farm.Dictionary, tmp_path: pathlib.Path
) -> None:
    """Numbers of records and parameters are those of the CSV."""
    small.to_parquet(tmp_path / "small.parquet")
    assert export(farm, "--output", str(tmp_path / "small.csv")).returncode == 0
    keys = ["record", "sample_ior", "sigma_t_per_mm", "g", "thickness_mm", "albedo", "channel"]
    rows = pd.read_parquet(tmp_path / "small.parquet", columns=keys).set_index("record")
    records = pd.read_csv(tmp_path / "small.csv").drop_duplicates(keys)[keys].set_index("record")
    pd.testing.assert_frame_equal(rows, records, check_dtype=False, check_index_type=False)


@pytest.mark.parametrize("package", ["xarray", "zarr", "pyarrow"])
def test_a_missing_package_is_named(
    small: resin_farm.Dictionary, package: str, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"this needs {package}: pip install 'resin-farm\[data\]'"):
        small.to_parquet(tmp_path / "x") if package == "pyarrow" else small.to_zarr(tmp_path / "x")
    assert not list(tmp_path.iterdir())


def test_an_incomplete_dictionary_is_not_exported(tmp_path: pathlib.Path) -> None:
    """Arrays have no place for missing records."""
    with resin_farm.Farm(tmp_path) as farm:
        # Enough walks that it is not done in the meantime.
        grid = resin_farm.Grid(sigma_t_per_mm=[4, 8], albedo=[0.9], g=[0.0], thickness_mm=[1], walks=1_000_000_000)
        dictionary = farm.submit(grid, "derivatives", wait=False)
        ran = export(farm, "--npz", str(tmp_path / "out"))
        assert ran.returncode == 1 and "0 of 2 records are done: arrays have no place" in ran.stderr, ran.stderr
        for write in (dictionary.to_zarr, dictionary.to_parquet):
            with pytest.raises(resin_farm.FarmError, match="0 of 2 records are done"):
                write(tmp_path / "out")
        assert not (tmp_path / "out").exists()
        dictionary.cancel("enough")
        assert dictionary.refresh().state == "cancelled"
