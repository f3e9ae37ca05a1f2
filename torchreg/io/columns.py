"""Points as rows of named numbers, as PLY and PCD store them: packed binary records or one line of text each.

Every size is checked against the file before anything is allocated: a header may claim anything.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import refuse, require
from torchreg.io.column_colors import PACKED_COLORS, colors_of
from torchreg.io.number_words import numbers_of
from torchreg.io.placement import Scanner

COORDINATES = (("x", "y", "z"), ("px", "py", "pz"))
NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
_COMMENTS = ("#", "comment ")
_LARGEST_RECORD = 1 << 30  # bytes; numpy counts those of a record in 32 bits, and wraps


@dataclass(frozen=True)
class Column:
    """One named number (or ``count`` of them) in every row; ``dtype`` includes the byte order."""

    name: str
    dtype: np.dtype[Any]
    count: int = 1


Columns = dict[str, NDArray[Any]]


def record_size(columns: Sequence[Column], path: Path) -> int:
    """The bytes of one packed binary row; ``CloudFileError`` where they are more than any row has."""
    size = sum(column.dtype.itemsize * column.count for column in columns)
    require(size <= _LARGEST_RECORD, path, f"points of at most {_LARGEST_RECORD} bytes", f"{size} bytes")
    return size


def record_dtype(columns: Sequence[Column]) -> np.dtype[Any]:
    """The dtype of one packed binary row of ``record_size``; its fields are named by their number."""
    return np.dtype([(str(i), column.dtype, (column.count,)) for i, column in enumerate(columns)])


def read_binary(path: Path, columns: Sequence[Column], rows: int, offset: int) -> Columns:
    """Read packed binary rows.

    Args:
        path: the file.
        columns: what a row holds, in order.
        rows: how many the header declares.
        offset: byte at which the first row starts.

    Returns:
        (rows,) arrays by lower-case name (``take``).

    Raises:
        CloudFileError: the file ends before the last declared row.
    """
    size = record_size(columns, path)
    available = path.stat().st_size - offset
    expected = f"{rows} points of {size} bytes after the header, as it declares"
    require(rows * size <= available, path, expected, f"{max(available, 0)} bytes")
    table = np.fromfile(path, record_dtype(columns), count=rows, offset=offset)
    by_name: Columns = {}
    for i, column in enumerate(columns):
        take(by_name, column, table[str(i)])
    return by_name


def take(by_name: Columns, column: Column, values: NDArray[Any]) -> None:
    """Add the values (rows, count) of a column, in the machine's byte order: the first of each row.

    A packed color of several numbers is its channels. A name that is there already keeps its values.
    """
    native = column.dtype.newbyteorder("=")
    name = column.name.lower()
    is_channels = name in PACKED_COLORS and column.count in (3, 4)
    for i, one in enumerate(("red", "green", "blue") if is_channels else (name,)):
        if one not in by_name:
            by_name[one] = values[:, i].astype(native)


def surplus(path: Path, columns: Sequence[Column], rows: int, offset: int) -> tuple[str, ...]:
    """A note where one more binary row would fit between the last declared one and the file's end."""
    size = record_size(columns, path)
    spare = (path.stat().st_size - offset) // size - rows
    note = f"the header declares {rows} points; bytes for {spare} more follow and were not read"
    return (note,) * (spare > 0)


def lines_of_rows(path: Path, rows: int, offset: int, skip: int = 0) -> list[str]:
    """The lines of ``rows`` rows of text, behind those of ``skip`` others; blank lines and comments do not count.

    Raises:
        CloudFileError: the file ends before the last declared row.
    """
    size = path.stat().st_size  # a line has at least one byte
    expected = f"{rows} lines of points, as its header declares"
    require(skip + rows <= size, path, expected, f"a file of {size} bytes")
    with path.open("rb") as file:
        file.seek(offset)
        with io.TextIOWrapper(file, encoding="latin-1") as text:
            lines = (line for line in text if not line.isspace() and not line.startswith(_COMMENTS))
            body = list(islice(lines, skip, skip + rows))
    require(len(body) == rows, path, expected, f"{len(body)}")
    return body


def columns_of_lines(path: Path, columns: Sequence[Column], lines: list[str]) -> tuple[Columns, tuple[str, ...]]:
    """Read the numbers in lines of text, one row each.

    Integers come back in their declared dtype, where all of them fit it; everything else in float64, which keeps
    digits that a declared ``float`` would lose.

    Returns:
        The columns, as of ``read_binary``, and notes.

    Raises:
        CloudFileError: a line with another number of words or with a word that is no number, or a coordinate
            that does not fit its declared dtype.
    """
    width = sum(column.count for column in columns)
    try:
        table, notes = numbers_of(lines)  # (rows, width)
    except ValueError as error:
        refuse(path, f"{width} numbers in every line of points", str(error).split(";")[0])
    require(table.shape == (len(lines), width), path, f"{width} numbers in every line", f"{table.shape[1]}")
    by_name: Columns = {}
    first = 0
    for column in columns:
        values = table[:, first : first + column.count]
        take(by_name, _as_written(column, values, path), values)
        first += column.count
    return by_name, notes


def _as_written(column: Column, values: NDArray[Any], path: Path) -> Column:
    """The column in float64, unless it is one of integers that all fit the dtype that the header declares."""
    wide = replace(column, dtype=np.dtype(np.float64))
    if column.dtype.kind not in "iu":
        return wide
    limits = np.iinfo(column.dtype)
    fits = (values >= float(limits.min)) & (values < float(limits.max) + 1) & (values == np.floor(values))
    if fits.all():
        return column
    if any(column.name.lower() in names for names in COORDINATES):
        row = int(np.argmin(fits.all(axis=1)))
        expected = f"{column.name} of type {column.dtype.name}, as its header declares"
        refuse(path, expected, f"{values[row, 0]:g} at point {row}")
    return wide


def raw_from_columns(
    name: str,
    kind: str,
    columns: Columns,
    scanner: Scanner | None = None,
    notes: tuple[str, ...] = (),
) -> RawCloud:
    """Pick coordinates, colors and normals by the names that files use.

    Raises:
        CloudFileError: one of x, y, z is missing.
    """
    points = _first_three(columns, COORDINATES)
    if points is None:
        refuse(name, "the properties x, y, z", ", ".join(columns) or "none")
    normals, colors = _first_three(columns, NORMALS), colors_of(columns)
    return RawCloud(
        name=name,
        format=kind,
        points=points.astype(np.float64),
        colors=colors.values,
        normals=None if normals is None else normals.astype(np.float64),
        scanner=scanner,
        notes=(*notes, *colors.notes),
    )


def _first_three(columns: Columns, choices: Sequence[tuple[str, ...]]) -> NDArray[Any] | None:
    """The columns of the first three names that are all there, (N, 3), or ``None``."""
    names = next((names for names in choices if all(name in columns for name in names)), None)
    return None if names is None else np.stack([columns[name] for name in names], axis=1)
