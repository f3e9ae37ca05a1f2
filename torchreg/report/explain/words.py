"""Numbers as words, and columns of plain text that stand below each other."""

from __future__ import annotations

import math
from collections.abc import Sequence

_LABEL = 12  # characters, the longest label and two spaces
_MOST_ODDS = 1e6


def line(label: str, text: str) -> str:
    """A label and what is said of it, in two columns."""
    return f"{label:<{_LABEL}}{text}"


def indented(text: str) -> str:
    """Text below that of ``line``."""
    return " " * _LABEL + text


def meters(value: float) -> str:
    """Such as ``0.3679 m``: four digits that count."""
    return f"{value:.4g} m"


def percent(share: float) -> str:
    """Such as ``12.3 %``; small shares keep two digits."""
    value = 100 * share
    return f"{value:.0f} %" if value >= 99.95 or value == 0 else f"{value:.3g} %" if value >= 10 else f"{value:.2g} %"


def part(count: int, whole: int) -> str:
    """Such as ``310 of 2,104 (14.7 %)``."""
    return f"{count:,} of {whole:,} ({percent(count / whole)})" if whole else f"{count:,} of 0"


def chance(probability: float) -> str:
    """A probability to three digits, and no certainty where there is none: ``0.99996`` stays below 1."""
    if math.isnan(probability):
        return "-"
    if 0 < probability < 0.001:
        return f"{probability:.1e}"
    digits = 3
    while round(probability, digits) == 1 and probability < 1 and digits < 9:
        digits += 1
    return f"{probability:.{digits}f}"


def odds(margin: float) -> str:
    """Odds in words, from log-odds: ``about 180 to 1``."""
    if margin > math.log(_MOST_ODDS):
        return "more than a million to 1"
    return f"about {math.exp(margin):.2g} to 1" if margin < math.log(100) else f"about {math.exp(margin):,.0f} to 1"


def number(value: float, digits: int = 2) -> str:
    """A number with so many decimals, ``-`` for one that nothing speaks of."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of equally many cells as lines: the first column flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if place == 0 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
