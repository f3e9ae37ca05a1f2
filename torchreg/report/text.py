"""Numbers, names and columns of plain text, as tables and explanations show them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.text import Text

_LABEL = 12  # characters, the longest label and two spaces
_MOST_ODDS = 1e6


def plain(text: str) -> Text:
    """Text from outside (a path, a message) as it is: no markup, and nothing that would steer a terminal."""
    return Text(legible(text))


def legible(text: str) -> str:
    r"""The text with what cannot be printed, such as an escape or a stray byte of a file name, as ``\x1b``."""
    return "".join(
        mark if mark.isprintable() or mark == "\n" else mark.encode("unicode_escape").decode() for mark in text
    )


def meters(value: float) -> str:
    """Such as ``0.3679 m``: four significant digits."""
    return f"{value:.4g} m"


def counted(count: int, what: str) -> str:
    """Such as ``15 pairs`` or ``1 pair``."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def millimeters(*values: float) -> str:
    """Such as ``0.74 mm`` or ``0.74, 1.6, 36 mm``: two significant digits at least, down to a nanometer."""
    return ", ".join(_in_millimeters(1000 * value) for value in values) + " mm"


def distance(value: float) -> str:
    """A distance that may be small or large: ``0.74 mm`` below a decimeter, ``0.3679 m`` from there on."""
    return millimeters(value) if value < 0.1 else meters(value)


def _in_millimeters(value: float) -> str:
    if value < 1e-6:
        return "0"
    return f"{value:#.2g}" if value < 0.995 else f"{value:.1f}" if value < 9.95 else f"{value:.0f}"


def share(part: int, whole: int) -> str:
    """Such as ``310 of 2,104 (14.7 %)``, with the digits of ``percent``."""
    return f"{part:,} of {whole:,} ({percent(part / whole)})" if whole else f"{part:,} of 0"


def percent(fraction: float) -> str:
    """Such as ``12.3 %``; small shares keep two digits."""
    value = 100 * fraction
    return f"{value:.0f} %" if value >= 99.95 or value == 0 else f"{value:.3g} %" if value >= 10 else f"{value:.2g} %"


def chance(probability: float) -> str:
    """A probability to three digits, more where three would round it to certainty: ``0.99996`` stays below 1."""
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


def decimal(value: float, digits: int = 2) -> str:
    """A number with so many decimals, ``-`` for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def line(label: str, text: str) -> str:
    """A label and its text in two columns; without a label, text below that of the line above."""
    return f"{label:<{_LABEL}}{text}"


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
