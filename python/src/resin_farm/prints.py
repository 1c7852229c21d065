"""Predictions of prints of measured media: reflectance and colour, with standard errors."""

from __future__ import annotations

import html
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from resin_farm import _display, _programs

Lab = tuple[float, float, float]
"""L*, a* and b* of CIELAB."""


@dataclass(frozen=True)
class Reflectance:
    """The radiance factor of a print in one channel over one base."""

    channel: str
    """The channel's name."""
    base: str
    """The base, as it was given."""
    radiance_factor: float
    """The radiance factor, 1 for a perfect white Lambertian surface."""
    std_error: float
    """Its standard error."""

    def __repr__(self) -> str:
        value = _display.estimate(self.radiance_factor, self.std_error)
        return _display.short(self, f"{self.channel} over {self.base}: {value}")


@dataclass(frozen=True)
class PrintColour:
    """The colour of a print over one base."""

    base: str
    """The base, as it was given."""
    lab: Lab
    """The CIELAB colour."""
    lab_std_errors: Lab
    """Standard errors of L*, a* and b*."""
    srgb: tuple[int, int, int] | None
    """The sRGB colour, 0 to 255; None for the 10° observer."""

    def __repr__(self) -> str:
        return _display.short(self, f"over {self.base}: {_lab(self)}")


@dataclass(frozen=True)
class Prediction:
    """The predicted reflectance and colour of a print."""

    reflectances: tuple[Reflectance, ...]
    """One for each channel and base."""
    colours: tuple[PrintColour, ...]
    """Empty unless the channels are wavelengths that cover the visible range."""

    def __str__(self) -> str:
        return "\n".join([_display.text_table(self._head(), self._rows()), *self._notes()])

    def __repr__(self) -> str:
        channels = _display.names(self._channels())
        colours = "" if self.colours else "; no colours"
        return _display.short(self, f"{channels} over {_display.names(self._bases())}{colours}")

    def _repr_html_(self) -> str:
        caption = "radiance factors ± standard errors"
        table = _display.html_table(self._head(), self._rows(), caption)
        return table + "".join(
            f"<p>{_swatch(one)}{html.escape(note)}</p>" for one, note in zip(self.colours, self._notes(), strict=True)
        )

    def _channels(self) -> list[str]:
        return list(dict.fromkeys(one.channel for one in self.reflectances))

    def _bases(self) -> list[str]:
        return list(dict.fromkeys(one.base for one in self.reflectances))

    def _head(self) -> list[str]:
        return ["channel", *(f"over {base}" for base in self._bases())]

    def _rows(self) -> list[list[str]]:
        found = {
            (one.channel, one.base): _display.estimate(one.radiance_factor, one.std_error) for one in self.reflectances
        }
        return [[channel, *(found.get((channel, base), "") for base in self._bases())] for channel in self._channels()]

    def _notes(self) -> list[str]:
        return [f"over {colour.base}: {_lab(colour)}" for colour in self.colours]

    def radiance_factor(self, channel: str, base: str) -> float:
        """The radiance factor in a channel over a base.

        Args:
            channel: the channel's name.
            base: the base, as it was given to `predict`, as a text.

        Raises:
            KeyError: if it was not predicted.
        """
        for found in self.reflectances:
            if (found.channel, found.base) == (channel, base):
                return found.radiance_factor
        raise KeyError(f"{channel} over {base}")


Slab = str | tuple[str | Mapping[str, float], float]
"""A layer of a print: "white:0.5", or a material or a mixture with a thickness in mm."""


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


def _lab(colour: PrintColour) -> str:
    values = [_display.estimate(value, error) for value, error in zip(colour.lab, colour.lab_std_errors, strict=True)]
    return ", ".join(f"{name} {value}" for name, value in zip(("L*", "a*", "b*"), values, strict=True))


def _swatch(colour: PrintColour) -> str:
    """A patch of the colour; nothing without sRGB."""
    if colour.srgb is None:
        return ""
    red, green, blue = colour.srgb
    style = (
        f"display: inline-block; width: 2em; height: 1em; margin-right: 0.5em; background: rgb({red}, {green}, {blue})"
    )
    return f'<span style="{style}"></span>'


def _text(slab: Slab) -> str:
    if isinstance(slab, str):
        return slab
    material, thickness_mm = slab
    if isinstance(material, str):
        return f"{material}:{thickness_mm}"
    return ",".join(f"{name}={share}" for name, share in material.items()) + f":{thickness_mm}"
