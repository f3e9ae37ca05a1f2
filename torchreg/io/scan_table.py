"""Tables with rows about the scans of a site: CSV with a header, and which scan a cell means."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from torchreg.errors import CloudFileError
from torchreg.io.checks import excerpt, readable_file, refuse, require

_LARGEST_FILE = 1 << 26  # bytes; beyond it somebody named a cloud where a table was meant


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
    """The number of the scan that a text means: by its name, by the name of its file alone, or by its number.

    Args:
        text: such as ``hall.e57``, ``site.e57 [2]`` or ``3``; a name counts before a number.
        names: of the scans.
        where: the option, or the file and line, for the message.

    Raises:
        CloudFileError: no scan or several of that name.
    """
    for alike in (str, _last, _stem):
        fits = [scan for scan, name in enumerate(names) if alike(name) == text]
        if len(fits) == 1:
            return fits[0]
        if fits:
            raise CloudFileError(f"{where}: expected the name of one scan, got {excerpt(text)}, which {len(fits)} have")
    if text.isascii() and text.isdigit() and int(text) < len(names):
        return int(text)
    expected = f"the name of a scan or a number from 0 to {len(names) - 1}"
    raise CloudFileError(f"{where}: expected {expected}, got {excerpt(text)}")


def _last(name: str) -> str:
    """A name without folders."""
    return Path(name).name


def _stem(name: str) -> str:
    """A name without folders and suffix."""
    return Path(name).stem
