"""Formats tables for terminals and notebooks."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table with aligned columns: the first two to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]

    def line(row: Sequence[str]) -> str:
        cells = [cell.ljust(w) if i < 2 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))]
        return "  ".join(cells).rstrip()

    return "\n".join([line(head), "─" * len(line(head)), *map(line, rows)])


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    def cells(tag: str, row: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"

    body = "".join(cells("td", row) for row in rows)
    title = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f"<table>{title}<thead>{cells('th', head)}</thead><tbody>{body}</tbody></table>"


def html_lines(lines: Sequence[str]) -> str:
    return "".join(f"<p>{html.escape(line)}</p>" for line in lines)


def number(value: float, digits: int = 3) -> str:
    """A value with this number of significant digits."""
    return f"{value:.{digits}g}"


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
