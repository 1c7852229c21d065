"""Dictionaries: simulated profiles for a grid of parameters."""

from __future__ import annotations

import importlib
import json
import os
import pathlib
import sys
import tempfile
from typing import TYPE_CHECKING, Any

import numpy as np

from resin_farm import _display, _exports, _optional, _programs
from resin_farm._access import FarmAccess
from resin_farm._wire import dictionaries_pb2 as wire
from resin_farm._wire import fits_pb2, model_pb2
from resin_farm.errors import Deleted, FarmError, NotFound
from resin_farm.medium import Medium
from resin_farm.profile import Profile

if TYPE_CHECKING:
    import xarray

_ENDED = ("done", "failed", "cancelled", "outdated", "paused")


class Dictionary:
    """A dictionary of a farm, with the state of its last refresh; `refresh()` updates it."""

    def __init__(self, farm: FarmAccess, status: wire.Dictionary) -> None:
        self._farm = farm
        self._status = status

    def __reduce__(self) -> tuple[object, tuple[FarmAccess, bytes]]:
        return _of_bytes, (self._farm, self._status.SerializeToString())

    @property
    def name(self) -> str:
        """Its name."""
        return self._status.name

    @property
    def state(self) -> str:
        """`running`, `done`, `failed`, `paused`, `cancelled` or `outdated`."""
        return wire.DictionaryState.Name(self._status.state).removeprefix("DICTIONARY_STATE_").lower()

    @property
    def records_done(self) -> int:
        """Number of records that are computed."""
        return self._status.records_done

    @property
    def records_total(self) -> int:
        """Number of records of the grid."""
        return self._status.records_total

    @property
    def work_done(self) -> float:
        """Share of the work, 0 to 1."""
        return self._status.work_done

    @property
    def eta_s(self) -> float | None:
        """Estimated seconds until it is done; None while there is no estimate."""
        return self._status.eta_s if self._status.HasField("eta_s") else None

    @property
    def records_digest(self) -> str | None:
        """BLAKE3 of all records, which does not depend on where they were computed; None until all are done."""
        return self._status.records_digest or None

    @property
    def axes(self) -> dict[str, tuple[float, ...]]:
        """The values of the grid along each axis: sigma_t_per_mm, albedo, g, thickness_mm, sample_ior."""
        grid = self._status.grid
        names = ("sigma_t_per_mm", "albedo", "g", "thickness_mm", "sample_ior")
        return {name: tuple(getattr(grid, name)) for name in names}

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of its scene."""
        return tuple(channel.name for channel in self._status.grid.scene.channels)

    def refresh(self) -> Dictionary:
        """Requests the current state from the farm.

        Returns:
            itself.

        Raises:
            NotFound: if it was deleted.
        """
        self._status = self._farm._call("Dictionaries/Get", wire.GetRequest(name=self.name), wire.Dictionary)
        return self

    def wait(self, *, progress: bool = True) -> Dictionary:
        """Waits until it is done.

        Args:
            progress: show the progress, on standard error or in the notebook.

        Returns:
            itself.

        Raises:
            FarmError: if it ended otherwise: cancelled, paused, or with failed jobs.
            Deleted: if it was deleted, or replaced by another one of its name.
        """
        bar = _Progress(self.name) if progress else None
        try:
            for status in self._farm._stream("Dictionaries/Watch", wire.WatchRequest(name=self.name), wire.Dictionary):
                self._take(status)
                if bar:
                    bar.show(self)
                if self.state in _ENDED:
                    break
            request = wire.GetRequest(name=self.name)
            self._take(self._farm._call("Dictionaries/Get", request, wire.Dictionary))
        except NotFound:
            raise Deleted(f"dictionary {self.name} was deleted, or replaced, while it was waited for") from None
        finally:
            if bar:
                bar.end()
        if self.state != "done":
            why = f": {self._status.reason}" if self._status.reason else ""
            raise FarmError(f"dictionary {self.name} is {self.state}{why}; `explain()` gives the reasons")
        return self

    def _take(self, status: wire.Dictionary) -> None:
        if status.grid_digest != self._status.grid_digest:
            raise NotFound(f"dictionary {self.name} has another grid")
        self._status = status

    def explain(self) -> list[str]:
        """Reasons why it is not done yet, the most important first.

        Raises:
            NotFound: if it was deleted.
        """
        answer = self._farm._call("Dictionaries/Explain", wire.ExplainRequest(name=self.name), wire.ExplainResponse)
        return [reason.text for reason in answer.reasons]

    def pause(self) -> Dictionary:
        """Hands out no more of its jobs.

        Returns:
            itself.

        Raises:
            Refused: if its state does not allow it.
        """
        self._status = self._farm._call("Dictionaries/Pause", wire.PauseRequest(name=self.name), wire.Dictionary)
        return self

    def resume(self) -> Dictionary:
        """Continues after a pause or a cancellation.

        Returns:
            itself.

        Raises:
            Refused: if its state does not allow it.
        """
        self._status = self._farm._call("Dictionaries/Resume", wire.ResumeRequest(name=self.name), wire.Dictionary)
        return self

    def cancel(self, reason: str = "") -> Dictionary:
        """Ends the work; finished records are kept.

        Args:
            reason: the reason, which its state then has.

        Returns:
            itself.

        Raises:
            Refused: if its state does not allow it.
        """
        request = wire.CancelRequest(name=self.name, reason=reason)
        self._status = self._farm._call("Dictionaries/Cancel", request, wire.Dictionary)
        return self

    def delete(self) -> int:
        """Deletes it, and the records that no other dictionary uses.

        Returns:
            the number of deleted records.

        Raises:
            NotFound: if it was deleted before.
        """
        answer = self._farm._call("Dictionaries/Delete", wire.DeleteRequest(name=self.name), wire.DeleteResponse)
        return answer.records_deleted

    def profile(
        self,
        *,
        sigma_t_per_mm: float,
        albedo: float,
        g: float,
        thickness_mm: float,
        channels: tuple[str, ...] = (),
        sample_ior: float | None = None,
    ) -> Profile:
        """The profile of a slab, at the records or between them.

        Args:
            sigma_t_per_mm: extinction coefficient, in 1/mm.
            albedo: single-scattering albedo.
            g: anisotropy, the mean cosine of the phase function.
            thickness_mm: thickness in mm, near one of the dictionary's, or between two.
            channels: all of the dictionary's if there are none.
            sample_ior: refractive index; the dictionary's first if None.

        Raises:
            InvalidArgument: if a value lies outside of the dictionary.
        """
        request = fits_pb2.ProfileRequest(
            dictionary=self.name,
            medium=model_pb2.Medium(sigma_t_per_mm=sigma_t_per_mm, albedo=albedo, g=g),
            thickness_mm=thickness_mm,
            sample_ior=sample_ior,
            channels=channels or self.channels,
        )
        answer = self._farm._call("Fits/Profile", request, fits_pb2.ProfileResponse)
        pixels, count = answer.pixels, len(answer.channels[0].values)
        return Profile(
            medium=Medium._of_wire(answer.medium),
            thickness_mm=answer.thickness_mm,
            x_mm=pixels.from_mm + pixels.pitch_mm * (np.arange(count, dtype=np.float64) + 0.5),
            channels={one.channel: np.array(one.values) for one in answer.channels},
            std_errors={one.channel: np.array(one.std_errors) for one in answer.channels if one.std_errors},
            recorded=answer.recorded,
        )

    def to_xarray(self) -> xarray.Dataset:
        """All records: `value` and `std_error`, also of derivatives if the grid has them, over sample_ior,
        sigma_t_per_mm, g, thickness_mm, albedo, channel and x_mm. The paper's dictionary takes 300 MB.

        Raises:
            FarmError: if records are missing.
            ImportError: if xarray is not installed.
        """
        dataset, about = self._records()
        found = about["dictionary"]
        dataset.attrs = {
            "dictionary": self.name,
            "records_digest": found["records_digest"],
            "about": json.dumps(about),
        }
        return dataset

    def responses(self) -> xarray.Dataset:
        """The profiles of varied scenes, in which one uncertain quantity has another value.

        The variables are those of `to_xarray`, over variant and the axes, at the nodes where they were traced. The
        coordinates `quantity`, `step` and `unit` are the varied quantity, its difference from the scene's value, and
        the unit. The last variant is the baseline, the scene itself with the walks of the variants of roughnesses,
        indices and the second lobe: the effect of a step on a profile is the difference from it.

        Raises:
            FarmError: if the scene is exact, or records are missing.
            ImportError: if xarray is not installed.
        """
        dataset, _ = self._records("--responses")
        return dataset.set_coords(["quantity", "step", "unit"])

    def to_zarr(self, path: str | os.PathLike[str]) -> None:
        """Writes all records as a Zarr store (format 3), with the variables and axes of `to_xarray`. Its attributes are
        the report of `farmctl show --json`, the axes and the units.

        Args:
            path: the folder of the store.

        Raises:
            FarmError: if records are missing.
            FileExistsError: if there is something at the path.
            ImportError: if xarray or zarr is not installed.
        """
        _optional.require("data", "xarray", "zarr")
        dataset, attributes = self._records()
        _exports.write_zarr(dataset.assign_attrs(attributes), pathlib.Path(path))

    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Writes all records as a Parquet file: a row for each record and channel, with its parameters, and the pixels
        as lists. `attrs` of the frame that `pandas.read_parquet` returns hold `about` and `x_mm`.

        Args:
            path: the file, which is replaced if it exists.

        Raises:
            FarmError: if records are missing.
            ImportError: if xarray, pandas or pyarrow is not installed.
        """
        _optional.require("data", "xarray", "pandas", "pyarrow")
        dataset, about = self._records()
        _exports.write_parquet(dataset, about, pathlib.Path(path))

    def _records(self, *options: str) -> tuple[xarray.Dataset, dict[str, Any]]:
        """All records that these options of `farmctl export` select, and their description."""
        _optional.require("data", "xarray")
        import xarray

        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder, "records.npz")
            _programs.farmctl([*self._farm._arguments(), "export", self.name, "--npz", str(path), *options])
            with np.load(path) as archive:
                about = json.loads(archive["about.json"])
                arrays = {name: archive[name] for name in archive.files if name != "about.json"}
        dims = about["axes"]
        coords = {name: arrays.pop(name) for name in dims}
        units = about["units"]
        # Arrays with a unit have all axes, others only that of the variants.
        variables = {
            name: (dims, values, {"units": units[name]}) if name in units else (dims[:1], values)
            for name, values in arrays.items()
        }
        dataset = xarray.Dataset(variables, coords)
        for name in dims:
            if name in units:
                dataset[name].attrs["units"] = units[name]
        return dataset, about

    def __repr__(self) -> str:
        return _display.short(
            self, f"{self.name}: {self.state}, {self.records_done:,} of {self.records_total:,} records"
        )

    def _repr_html_(self) -> str:
        rows = [[name, _display.axis(values)] for name, values in self.axes.items()]
        rows.append(["channels", _display.names(self.channels)])
        caption = f"{self.name}: {self.state}, {self.records_done:,} of {self.records_total:,} records"
        return _display.html_table(("axis", "values"), rows, caption)


def _of_bytes(farm: FarmAccess, status: bytes) -> Dictionary:
    return Dictionary(farm, wire.Dictionary.FromString(status))


class _Progress:
    """A line that is overwritten: on standard error in a terminal, as a separate display in a notebook."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._shown = ""
        self._handle: Any = None

    def show(self, dictionary: Dictionary) -> None:
        left = f", {dictionary.eta_s:.0f} s left" if dictionary.eta_s and dictionary.state == "running" else ""
        line = f"{self._name}: {100 * dictionary.work_done:.0f} % of the work{left}"
        if line == self._shown:
            return
        if "ipykernel" in sys.modules:
            self._show_in_notebook(line)
        elif sys.stderr.isatty():
            print("\r" + line.ljust(len(self._shown)), end="", file=sys.stderr, flush=True)
        self._shown = line

    def _show_in_notebook(self, line: str) -> None:
        data = {"text/plain": line}
        if self._handle is None:
            display = importlib.import_module("IPython.display").display
            self._handle = display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)

    def end(self) -> None:
        if self._shown and self._handle is None and sys.stderr.isatty():
            print(file=sys.stderr)
