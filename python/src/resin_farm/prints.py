"""Predictions of prints of measured media: reflectance and colour, with standard errors."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from resin_farm import _programs

Lab = tuple[float, float, float]


@dataclass(frozen=True)
class Reflectance:
    """The radiance factor of a print in one channel over one base."""

    channel: str
    base: str
    radiance_factor: float
    std_error: float


@dataclass(frozen=True)
class PrintColour:
    """The CIELAB colour of a print over one base, and its sRGB (None for the 10° observer)."""

    base: str
    lab: Lab
    lab_std_errors: Lab
    srgb: tuple[int, int, int] | None


@dataclass(frozen=True)
class Prediction:
    """How a print looks."""

    reflectances: tuple[Reflectance, ...]
    colours: tuple[PrintColour, ...]
    """Empty unless the channels are wavelengths that cover the visible range."""

    def radiance_factor(self, channel: str, base: str) -> float:
        """The radiance factor in a channel over a base.

        Raises:
            KeyError: if it was not predicted.
        """
        for found in self.reflectances:
            if (found.channel, found.base) == (channel, base):
                return found.radiance_factor
        raise KeyError(f"{channel} over {base}")


Slab = str | tuple[str | Mapping[str, float], float]


def predict(
    media: str | os.PathLike[str],
    slabs: Sequence[Slab],
    *,
    over: Sequence[str | float] = ("black", "white"),
    geometry: str = "session",
    roughness: float | None = None,
    illuminant: str = "d50",
    observer: int = 2,
) -> Prediction:
    """Predicts a print of measured media, as `farmctl predict` does.

    Args:
        media: `media.json` of a measurement, or the folder that contains it.
        slabs: from top to bottom; each is a text such as "white:0.5", or a material, or a mixture such as
            {"white": 0.9, "cyan": 0.1} by volume, with a thickness in mm.
        over: bases: reflectances, "black", "white", or "light" and "dark", the sides of the measured board.
        geometry: "session", "45:0" or "d:8".
        roughness: GGX α of a bare print's faces.
        illuminant: "d50" or "d65".
        observer: 2 or 10 degrees.

    Raises:
        FarmError: if farmctl refuses an argument.
    """
    arguments = ["predict", os.fspath(media), *map(_text, slabs)]
    arguments += ["--over", ",".join(map(str, over)), "--geometry", geometry]
    arguments += ["--illuminant", illuminant, "--observer", str(observer)]
    if roughness is not None:
        arguments += ["--roughness", str(roughness)]
    data = _programs.farmctl(arguments)
    reflectances = tuple(
        Reflectance(channel["channel"], base["base"], base["radiance_factor"], base["std_error"])
        for channel in data["channels"]
        for base in channel["bases"]
    )
    colours = tuple(
        PrintColour(
            colour["base"],
            tuple(colour["lab"]),
            tuple(colour["lab_std_errors"]),
            tuple(colour["srgb"]) if colour["srgb"] else None,
        )
        for colour in (data["colours"] or {"bases": []})["bases"]
    )
    return Prediction(reflectances, colours)


def _text(slab: Slab) -> str:
    if isinstance(slab, str):
        return slab
    material, thickness_mm = slab
    if isinstance(material, str):
        return f"{material}:{thickness_mm}"
    return ",".join(f"{name}={share}" for name, share in material.items()) + f":{thickness_mm}"
