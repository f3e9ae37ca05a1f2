"""Tables with rows about the scans of a site: CSV with a header, and which scan a cell means."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn

from torchreg.errors import CloudFileError
from torchreg.io.checks import excerpt, readable_file, refuse, require

_LARGEST_FILE = 1 << 26  # bytes; beyond it somebody named a cloud where a table was meant
_LISTED = 8  # names in a message
_OF_SEVERAL = re.compile(r"(.*?\.\w+) \[(.*)\]", re.DOTALL)  # a file of several scans, and the name of one there


class ScanRow(NamedTuple):
    """One row of a table."""

    where: str  # file and line, for messages
    cells: dict[str, str]  # by column, without the white space around them

    def numbers(self, columns: Sequence[str]) -> tuple[float, ...]:
        """The numbers in some columns.

        Raises:
            CloudFileError: a cell that is no finite number.
        """
        values = []
        for column in columns:
            try:
                value = float(self.cells[column])
            except ValueError:
                value = math.nan
            require(math.isfinite(value), self.where, f"a number in the column {column}", excerpt(self.cells[column]))
            values.append(value)
        return tuple(values)


def read_scan_table(path: str | os.PathLike[str], columns: Sequence[str]) -> list[ScanRow]:
    """Read a CSV table that has at least these columns, by names in which upper and lower case differ.

    Raises:
        CloudFileError: the file cannot be read, lacks a column or has rows of another length.
    """
    file = readable_file(path)
    require(file.stat().st_size < _LARGEST_FILE, file, "a table", f"{file.stat().st_size:,} bytes")
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
        table = [(number, row) for number, row in enumerate(csv.reader(lines, strict=True), start=1) if any(row)]
    except UnicodeDecodeError:
        refuse(file, "text in UTF-8", "other bytes")
    except csv.Error as error:
        refuse(file, "a table of comma-separated values", str(error))
    require(bool(table), file, "a header", "blank lines")
    header = [name.strip() for name in table[0][1]]
    missing = [name for name in columns if header.count(name) != 1]
    require(not missing, file, f"a header with {', '.join(columns)}", excerpt(",".join(header)))
    rows = []
    for number, cells in table[1:]:
        where = f"{file}, line {number}"
        require(len(cells) == len(header), where, f"{len(header)} cells", str(len(cells)))
        rows.append(ScanRow(where, dict(zip(header, (cell.strip() for cell in cells), strict=True))))
    return rows


def scan_number(text: str, names: Sequence[str], where: str) -> int:
    """The number of the scan that a text means: by its name, with or without folders and file, or by its number.

    Args:
        text: such as ``hall.e57``, ``site.e57 [cellar/2]``, ``cellar/2`` or ``3``.
        names: of the scans; those of a file of several scans have their own names there in brackets.
        where: the option, or the file and line, for the message.

    Raises:
        CloudFileError: no scan or several of that name, or a number that is the own name of another scan; the message
            lists names.
    """
    for alike in (str, _last, _stem):
        fits = [scan for scan, name in enumerate(names) if alike(name) == text]
        if len(fits) == 1:
            return fits[0]
        if fits:
            _refuse_several(text, [names[scan] for scan in fits], where)
    fits = [scan for scan, name in enumerate(names) if _own(name) == text]
    number = int(text) if text.isascii() and text.isdigit() and int(text) < len(names) else None
    if number is None and len(fits) == 1:
        return fits[0]
    if number is not None and (not fits or number in fits):
        return number
    if number is not None:
        fits = sorted({*fits, number})
    if fits:
        _refuse_several(text, [names[scan] for scan in fits], where)
    expected = f"the name of a scan or a number from 0 to {len(names) - 1}"
    raise CloudFileError(f"{where}: expected {expected}, got {excerpt(text)}; the names are {_listed(names)}")


def _refuse_several(text: str, names: Sequence[str], where: str) -> NoReturn:
    some = f"which {len(names)} have: {_listed(names)}"
    raise CloudFileError(f"{where}: expected the name of one scan, got {excerpt(text)}, {some}")


def _listed(names: Sequence[str]) -> str:
    """Some names as they may be given: without folders where this leaves them different."""
    short = [_last(name) for name in names]
    listed = ", ".join(map(repr, (short if len(set(short)) == len(names) else names)[:_LISTED]))
    return listed + (", ..." if len(names) > _LISTED else "")


def _parts(name: str) -> tuple[str, str | None]:
    """A scan's file, and its own name there, where the file has several."""
    found = _OF_SEVERAL.fullmatch(name)
    return (name, None) if found is None else (found[1], found[2])


def _own(name: str) -> str | None:
    """The own name of a scan in a file of several, or its number there."""
    return _parts(name)[1]


def _last(name: str) -> str:
    """A name without the folders of its file."""
    file, own = _parts(name)
    return Path(file).name if own is None else f"{Path(file).name} [{own}]"


def _stem(name: str) -> str:
    """A name without the folders and the suffix of its file."""
    file, own = _parts(name)
    return Path(file).stem if own is None else f"{Path(file).stem} [{own}]"
