"""A list of pairs as JSON, such as programs that make data sets write: its entries as the cells of a table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torchreg.io.checks import excerpt, refuse, require

_TRUTH = "T"


def cells_of_list(text: str, file: Path) -> list[dict[str, str]]:
    """The entries of a list of pairs, each as texts by the name of a column in lower case.

    The list stands under ``pairs`` of an object. Its entries are objects; ``T`` is their truth, sixteen numbers in four
    rows or in one, beside which a text under ``truth`` counts for nothing. Numbers and true or false become texts,
    lists and objects are left out.

    Raises:
        CloudFileError: not such a list; the message names the file and the pair.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        refuse(file, "a list of pairs as JSON", str(error))
    listed = content.get("pairs") if isinstance(content, dict) else None
    if not isinstance(listed, list):
        refuse(file, "an object with a list under pairs", excerpt(text.strip()))
    return [_cells(entry, f"{file}, pair {number}") for number, entry in enumerate(listed, start=1)]


def _cells(entry: Any, where: str) -> dict[str, str]:  # noqa: ANN401
    require(isinstance(entry, dict), where, "an object", excerpt(repr(entry)))
    cells = {name.strip().lower(): _text(value, f"{where}, {name}") for name, value in entry.items() if name != _TRUTH}
    require("" not in cells, where, "a name for every value", "none")
    for column in ("source", "target"):
        require(column in cells, where, f"a file under {column}", ", ".join(cells) or "nothing")
    if _TRUTH in entry:
        cells["truth"] = _numbers(entry[_TRUTH], f"{where}, {_TRUTH}")
    return cells


def _text(value: Any, where: str) -> str:  # noqa: ANN401
    if isinstance(value, str):
        bad = next((letter for letter in value if letter == "\0" or "\ud800" <= letter <= "\udfff"), None)
        require(bad is None, where, "a text in Unicode", f"the letter {bad!r}")
        return value.replace("\r\n", "\n").replace("\r", "\n").strip()
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, (int, float)) else ""


def _numbers(rows: Any, where: str) -> str:  # noqa: ANN401
    """Sixteen numbers with spaces between; the empty text for null."""
    if rows is None:
        return ""
    flat = (
        [value for row in rows for value in (row if isinstance(row, list) else [row])] if isinstance(rows, list) else []
    )
    known = len(flat) == 16 and all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in flat)
    require(known, where, "four rows of four numbers", excerpt(repr(rows)))
    return " ".join(map(repr, flat))
