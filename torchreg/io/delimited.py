"""A table of text with one named column per cell, as spreadsheets export it."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from torchreg.io.checks import excerpt, readable_file, refuse, require

_DELIMITERS = (",", ";", "\t")
_LARGEST_FILE = 1 << 26  # bytes; beyond it somebody named a cloud where a table was meant


@dataclass(frozen=True)
class TableRow:
    """One row below the header.

    Attributes:
        line: where the row begins, counted from 1 over all lines of the file.
        cells: by the name of the column, without the white space around them.
    """

    line: int
    cells: dict[str, str]


def read_delimited(path: str | os.PathLike[str], needed: tuple[str, ...]) -> tuple[TableRow, ...]:
    """Read a table whose cells are separated by commas, semicolons or tabs.

    The first line that counts is the header, and it decides on the separator: the first of the three under
    which it has all needed columns. Blank lines and lines that start with ``#`` do not count. Text is UTF-8,
    with or without its byte order mark; lines end in any of the three usual ways; cells may be quoted with
    ``"`` and then hold separators and, below the header, line ends.

    Args:
        path: the file.
        needed: columns that must be there. Names of columns are read in lower case.

    Returns:
        The rows in their order; none where there is only a header.

    Raises:
        CloudFileError: the file is missing, empty, no text, without one of the columns or with one twice, a
            row has too few or too many cells, or a quote is not closed. The message names the line.
    """
    file = readable_file(path)
    lines = enumerate(_lines(file), start=1)
    number, header = next(((n, line) for n, line in lines if _counts(line)), (0, ""))
    require(number > 0, file, "a header line", "nothing but blank lines and comments")
    mark, names = _columns(header, f"{file}, line {number}", needed)
    rows = []
    for number, line in lines:
        if not _counts(line):
            continue
        where = f"{file}, line {number}"
        # The reader takes further lines only where a quoted cell goes on in them.
        reader = csv.reader(chain([line], (more for _, more in lines)), delimiter=mark, strict=True)
        try:
            cells = next(reader)
        except csv.Error as error:
            refuse(where, "cells without quotes or within a pair of them", f"{excerpt(line.strip())} ({error})")
        require(len(cells) == len(names), where, f"{len(names)} cells, as the header has", f"{len(cells)}")
        rows.append(TableRow(number, {name: cell.strip() for name, cell in zip(names, cells, strict=True)}))
    return tuple(rows)


def _lines(file: Path) -> list[str]:
    """The lines with their ends, all of them a line feed."""
    require(file.stat().st_size <= _LARGEST_FILE, file, "a table of text", "a file above 64 MB")
    raw = file.read_bytes()
    zero = raw.find(b"\0")
    if zero >= 0:
        refuse(f"{file}, line {raw.count(10, 0, zero) + 1}", "text in UTF-8", "a NUL byte")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = f"the byte 0x{raw[error.start]:02x}"
        refuse(f"{file}, line {raw.count(10, 0, error.start) + 1}", "text in UTF-8", byte)
    plain = text.replace("\r\n", "\n").replace("\r", "\n")
    return [f"{line}\n" for line in plain.split("\n")]


def _counts(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _columns(header: str, where: str, needed: tuple[str, ...]) -> tuple[str, list[str]]:
    """The separator and the names of the columns."""
    names: dict[str, list[str]] = {}
    broken = ""
    for mark in _DELIMITERS:
        try:
            cells = next(csv.reader([header], delimiter=mark, strict=True))
        except csv.Error as error:
            broken, cells = str(error), []  # quotes may fit another separator
        names[mark] = [cell.strip().lower() for cell in cells]
        if set(needed) <= set(names[mark]):
            break
    else:
        if not any(names.values()):
            refuse(where, "a header on one line, in cells without quotes or within a pair of them", broken)
        most = max(names.values(), key=len)
        refuse(where, f"the columns {' and '.join(needed)}", ", ".join(most))
    found = names[mark]
    for column, name in enumerate(found, start=1):
        require(name != "", where, "a name for every column", f"none for column {column}")
        require(found.count(name) == 1, where, "every column once", f"{excerpt(name)} {found.count(name)} times")
    return mark, found
