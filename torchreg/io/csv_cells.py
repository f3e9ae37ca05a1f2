"""Texts in the cells of a CSV file, none of which a spreadsheet takes for a formula."""

from __future__ import annotations

import re

# Some spreadsheets take the wide forms of the signs for the signs.
_FORMULA = re.compile(r"'*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def cell_of_text(text: str) -> str:
    """The cell that stands for a text: with an apostrophe before it where it begins as a formula does.

    A plain number keeps its sign. ``text_of_cell`` gives the text back, whatever it is.

    Example:
        >>> [cell_of_text(text) for text in ("hall", "=1+1", "-3.5", "'=1")]
        ['hall', "'=1+1", '-3.5', "''=1"]
    """
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def text_of_cell(cell: str) -> str:
    """The text that a cell stands for: without the apostrophe before what would be a formula.

    Example:
        >>> [text_of_cell(cell) for cell in ("hall", "'=1+1", "-3.5", "''=1", "'hall")]
        ['hall', '=1+1', '-3.5', "'=1", "'hall"]
    """
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell
