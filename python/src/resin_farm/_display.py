"""Formats tables for terminals and notebooks, and short forms of objects. Values are rounded for reading."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Any


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table with aligned columns: the first two to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]

    def line(row: Sequence[str]) -> str:
        cells = [cell.ljust(w) if i < 2 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))]
        return "  ".join(cells).rstrip()

    return "\n".join([line(head), "─" * len(line(head)), *map(line, rows)])


def html_table(
    head: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "", marked: Sequence[int] = ()
) -> str:
    """A table without scripts; it has the notebook's colours, and a bar in front of the marked rows."""

    def cells(tag: str, row: Sequence[str], style: str = "") -> str:
        first, *rest = (html.escape(cell) for cell in row)
        return f"<tr><{tag}{style}>{first}</{tag}>" + "".join(f"<{tag}>{cell}</{tag}>" for cell in rest) + "</tr>"

    body = "".join(cells("td", row, _BAR if place in marked else "") for place, row in enumerate(rows))
    title = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f'<table style="white-space: nowrap">{title}<thead>{cells("th", head)}</thead><tbody>{body}</tbody></table>'


# Visible on white and on black.
_BAR = ' style="border-left: 4px solid #d55e00"'


def html_lines(lines: Sequence[str]) -> str:
    return "".join(f"<p>{html.escape(line)}</p>" for line in lines)


def short(thing: object, text: str) -> str:
    """A short form for prompts: the type and a description."""
    return f"<{type(thing).__name__} {text}>"


def names(all_names: Sequence[str], most: int = 4) -> str:
    """The names, or of more than `most` the first, the last and their number."""
    if len(all_names) <= most:
        return ", ".join(all_names)
    return f"{all_names[0]} … {all_names[-1]} ({len(all_names)})"


def axis(values: Sequence[float] | Any, most: int = 4) -> str:
    """The numbers of an axis, or of more than `most` the first, the last and their number."""
    return names([f"{value:g}" for value in values], most)


def coefficients(sigma_t_per_mm: float, alpha: float, g: float) -> str:
    return f"σ_t {number(sigma_t_per_mm)} /mm, α {albedo(alpha)}, g {number(g)}"


def number(value: float, digits: int = 3) -> str:
    """A value with this number of significant digits."""
    return f"{value:.{digits}g}"


def estimate(value: float, std_error: float) -> str:
    """A value with its standard error, which has two digits."""
    if not (math.isfinite(std_error) and std_error > 0):
        return number(value, 4)
    places = max(0, 1 - math.floor(math.log10(std_error)))
    return f"{value:.{places}f} ± {std_error:.{places}f}"


def ends(low: float, high: float) -> tuple[str, str]:
    """Both ends of an interval, with two digits of its width."""
    places = max(0, 1 - math.floor(math.log10(high - low))) if high > low else 3
    return f"{low:.{places}f}", f"{high:.{places}f}"


def end(value: float) -> str:
    """The only end of an interval: three digits, for an albedo near 1 three of 1 − α."""
    return albedo(value) if 0.9 < value < 1 else number(value)


def albedo(value: float) -> str:
    """An albedo with three digits of 1 − α."""
    missing = 1 - value
    places = 3 if missing <= 0 or missing >= 0.1 else min(9, 3 + max(0, int(f"{missing:e}".split("e-")[1]) - 1))
    return f"{value:.{places}f}"
