"""Simulated and predicted edge profiles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from resin_farm import _display, _optional, _plots, _programs
from resin_farm.medium import Array, Medium

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


# eq=False: the equality of arrays has no single truth value.
@dataclass(frozen=True, eq=False)
class Profile:
    """The radiance factors of a slab across the edge. `profile["R"]` are those of a channel."""

    medium: Medium
    """The slab's medium."""
    thickness_mm: float
    """The slab's thickness, in mm."""
    x_mm: Array = field(repr=False)
    """Centres of the pixels, rising; 0 at the edge, negative on the dark side."""
    channels: Mapping[str, Array] = field(repr=False)
    """Radiance factors of each channel, one for each pixel."""
    std_errors: Mapping[str, Array] = field(repr=False)
    """Standard errors from the noise of the walks; missing for a channel if they are unknown."""
    recorded: bool = False
    """The dictionary has a record of this medium and thickness; otherwise it lies between records."""

    def __repr__(self) -> str:
        channels = f"{_display.names(list(self.channels))} on {self.x_mm.size} pixels"
        where = ", at a record" if self.recorded else ""
        return _display.short(self, f"{self.medium}, {self.thickness_mm:g} mm{where}: {channels}")

    def __getitem__(self, channel: str) -> Array:
        """The radiance factors of a channel.

        Args:
            channel: its name.

        Raises:
            KeyError: if the profile has no such channel.
        """
        return self.channels[channel]

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each pixel of each channel: channel, x_mm, value, std_error.

        Raises:
            ImportError: if pandas is not installed.
        """
        _optional.require("data", "pandas")
        import pandas

        frames = []
        for channel, values in self.channels.items():
            errors = self.std_errors.get(channel, np.full(values.shape, np.nan))
            columns = {"channel": channel, "x_mm": self.x_mm, "value": values, "std_error": errors}
            frames.append(pandas.DataFrame(columns))
        return pandas.concat(frames, ignore_index=True)

    def plot(self) -> Figure:
        """All channels, with bands of two standard errors.

        Raises:
            ImportError: if matplotlib is not installed.
        """
        m = self.medium
        title = f"{_plots.SIGMA_T} {m.sigma_t_per_mm:g} /mm, α {m.albedo:g}, g {m.g:g}, {self.thickness_mm:g} mm"
        return _plots.profile(title, self.x_mm, self.channels, self.std_errors)


def simulate(
    *,
    sigma_t_per_mm: float,
    albedo: float,
    g: float,
    thickness_mm: float,
    scene: str = "lab",
    sample_ior: float = 1.53,
    walks: int = 50_000,
    seed: int = 1,
) -> Profile:
    """Traces the profile of one medium, without a farm or a dictionary; the same numbers give the same bits everywhere.

    Args:
        sigma_t_per_mm: extinction coefficient, in 1/mm.
        albedo: single-scattering albedo.
        g: anisotropy, the mean cosine of the phase function, whose shape is the scene's.
        thickness_mm: thickness of the slab, in mm.
        scene: "lab", "paper", "smooth" or the path of a scene file.
        sample_ior: refractive index of the slab.
        walks: random walks, a multiple of 500 from 1,000 on.
        seed: seed of the random numbers.

    Raises:
        InvalidArgument: if an argument is not valid; it names it.
    """
    options: dict[str, Any] = {
        "--sigma-t": sigma_t_per_mm,
        "--albedo": albedo,
        "--g": g,
        "--thickness": thickness_mm,
        "--scene": scene,
        "--sample-ior": sample_ior,
        "--walks": walks,
        "--seed": seed,
    }
    found = _programs.farmctl(["simulate", *(f"{option}={value}" for option, value in options.items())])
    profiles = {one["channel"]: one for one in found["channels"]}
    return Profile(
        medium=Medium(sigma_t_per_mm, albedo, g),
        thickness_mm=thickness_mm,
        x_mm=np.array(found["x_mm"]),
        channels={name: np.array(one["values"]) for name, one in profiles.items()},
        std_errors={name: np.array(one["std_errors"]) for name, one in profiles.items()},
    )
