"""Points as rows of named numbers, as PLY and PCD store them: packed binary records or one line of text each.

Every size is checked against the file before anything is allocated: a header may claim anything.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import refuse, require
from torchreg.io.placement import Scanner

COORDINATES = ("x", "y", "z")
NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
PACKED_COLORS = ("rgb", "rgba")  # one word 0x_RRGGBB, of PCD; often declared as a float


@dataclass(frozen=True)
class Column:
    """One named number (or ``count`` of them) in every row; ``dtype`` includes the byte order."""

    name: str
    dtype: np.dtype[Any]
    count: int = 1


Columns = dict[str, NDArray[Any]]


def record_dtype(columns: Sequence[Column]) -> np.dtype[Any]:
    """The dtype of one packed binary row; its fields are named by their number."""
    return np.dtype([(str(i), column.dtype, (column.count,)) for i, column in enumerate(columns)])


def read_binary(path: Path, columns: Sequence[Column], rows: int, offset: int) -> Columns:
    """Read packed binary rows.

    Args:
        path: the file.
        columns: what a row holds, in order.
        rows: how many the header declares.
        offset: byte at which the first row starts.

    Returns:
        (rows,) arrays by lower-case name, in the machine's byte order; of a column with several numbers,
        the first. A name that comes twice counts where it comes first.

    Raises:
        CloudFileError: the file ends before the last declared row.
    """
    record = record_dtype(columns)
    available = path.stat().st_size - offset
    expected = f"{rows} points of {record.itemsize} bytes after the header, as it declares"
    require(rows * record.itemsize <= available, path, expected, f"{max(available, 0)} bytes")
    table = np.fromfile(path, record, count=rows, offset=offset)
    by_name: Columns = {}
    for i, column in enumerate(columns):
        values = table[str(i)][:, 0]
        by_name.setdefault(column.name.lower(), values.astype(column.dtype.newbyteorder("=")))
    return by_name


def surplus(path: Path, columns: Sequence[Column], rows: int, offset: int) -> tuple[str, ...]:
    """A note where one more binary row would fit between the last declared one and the file's end."""
    size = record_dtype(columns).itemsize
    spare = (path.stat().st_size - offset) // size - rows
    note = f"the header declares {rows} points; bytes for {spare} more follow and were not read"
    return (note,) * (spare > 0)


def read_ascii(path: Path, columns: Sequence[Column], rows: int, offset: int, skip: int = 0) -> Columns:
    """Read rows of text, one line each; blank lines do not count, ``skip`` others come first.

    Integers come back in their declared dtype; everything else in float64, which keeps digits that a
    declared ``float`` would lose.

    Raises:
        CloudFileError: too few lines, a line with another number of words or with a word that is no number,
            or an integer that does not fit its declared dtype.
    """
    width = sum(column.count for column in columns)
    with path.open("rb") as file:
        file.seek(offset)
        with io.TextIOWrapper(file, encoding="latin-1") as text:
            body = list(islice((line for line in text if not line.isspace()), skip, skip + rows))
    require(len(body) == rows, path, f"{rows} lines of points, as its header declares", f"{len(body)}")
    try:
        table = np.loadtxt(body, dtype=np.float64, comments=None, ndmin=2)  # (rows, width)
    except ValueError as error:
        refuse(path, f"{width} numbers in every line of points", str(error).split(";")[0])
    require(table.shape == (rows, width), path, f"{width} numbers in every line", f"{table.shape[1]}")
    by_name: Columns = {}
    first = 0
    for column in columns:
        by_name.setdefault(column.name.lower(), _declared(table[:, first], column, path))
        first += column.count
    return by_name


def _declared(values: NDArray[Any], column: Column, path: Path) -> NDArray[Any]:
    """Integers in their declared dtype, refused where they do not fit."""
    if column.dtype.kind not in "iu":
        return values
    limits = np.iinfo(column.dtype)
    fits = (values >= float(limits.min)) & (values <= float(limits.max)) & (values == np.floor(values))
    if not fits.all():
        row = int(np.argmin(fits))
        expected = f"{column.name} of type {column.dtype.name}, as its header declares"
        refuse(path, expected, f"{values[row]:g} at point {row}")
    return values.astype(column.dtype.newbyteorder("="))


def raw_from_columns(
    name: str,
    kind: str,
    columns: Columns,
    scanner: Scanner | None = None,
    notes: tuple[str, ...] = (),
) -> RawCloud:
    """Pick coordinates, colors and normals by the names that files use.

    Raises:
        CloudFileError: one of x, y, z is missing, or the colors are not of one type.
    """
    points = _three(columns, COORDINATES)
    if points is None:
        refuse(name, "the properties x, y, z", ", ".join(columns) or "none")
    normals = next((three for names in NORMALS if (three := _three(columns, names)) is not None), None)
    return RawCloud(
        name=name,
        format=kind,
        points=points.astype(np.float64),
        colors=_colors(name, columns),
        normals=None if normals is None else normals.astype(np.float64),
        scanner=scanner,
        notes=notes,
    )


def _three(columns: Columns, names: tuple[str, ...]) -> NDArray[Any] | None:
    if not all(name in columns for name in names):
        return None
    return np.stack([columns[name] for name in names], axis=1)  # (N, 3)


def _colors(name: str, columns: Columns) -> NDArray[Any] | None:
    for names in COLORS:
        colors = _three(columns, names)
        if colors is not None:
            kinds = [columns[word].dtype.name for word in names]
            require(len(set(kinds)) == 1, name, f"{', '.join(names)} of one type", ", ".join(kinds))
            return colors
    packed = next((columns[word] for word in PACKED_COLORS if word in columns), None)
    if packed is None:
        return None
    require(packed.dtype.itemsize == 4, name, "packed colors of 4 bytes", str(packed.dtype))
    bits = packed.view(np.uint32)
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=1).astype(np.uint8)  # (N, 3)
