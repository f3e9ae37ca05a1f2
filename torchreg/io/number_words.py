"""Numbers in lines of text, also as some programs spell them: NaN of Windows, a comma before the decimals."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

# -nan(ind) and nan(snan) of the C library of Windows; 1.#QNAN, -1.#IND00 and 1.#INF of the ones before
_NO_NUMBER = re.compile(r"[-+]?(?:nan\([^()\s]*\)|1\.#\w+)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")


def numbers_of(lines: list[str]) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """The table of numbers that lines of text hold, and notes on how they were read.

    The plain spelling is tried first. Commas are taken for decimal points only where not one number of all lines has
    a point, so that lists with commas between numbers are not read as fewer numbers.

    Args:
        lines: at least one, each of as many words.

    Returns:
        (len(lines), words) float64.

    Raises:
        ValueError: a word that is no number, or lines of several widths.
    """
    try:
        return _table(lines), ()
    except ValueError as error:
        plain = error
    lines = [_NO_NUMBER.sub("nan", line) for line in lines]
    if any("," in line for line in lines) and not any("." in line for line in lines):
        try:
            table = _table([_DECIMAL_COMMA.sub(".", line) for line in lines])
        except ValueError:
            raise plain from None
        return table, ("commas in its numbers were read as decimal points",)
    return _table(lines), ()


def _table(lines: list[str]) -> NDArray[np.float64]:
    table: NDArray[np.float64] = np.loadtxt(lines, dtype=np.float64, comments=None, ndmin=2)
    return table
