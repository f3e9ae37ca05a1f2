"""PCD 0.6 and 0.7: a header of fields, then the points as text, packed records or LZF-compressed columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import lzf
import numpy as np

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import count_of, excerpt, refuse, require
from torchreg.io.columns import (
    PACKED_COLORS,
    Column,
    Columns,
    raw_from_columns,
    read_ascii,
    read_binary,
    record_dtype,
    surplus,
)
from torchreg.io.placement import Scanner, scanner_of_file

_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_TYPES = {("F", "4"), ("F", "8"), *((kind, size) for kind in "UI" for size in "1248")}
_LONGEST_HEADER = 1 << 16  # bytes
_LARGEST_RATIO = 88  # the longest reference of LZF: 264 bytes from 3


@dataclass(frozen=True, eq=False)
class _PcdHeader:
    encoding: str
    columns: list[Column]
    rows: int
    scanner: Scanner | None
    size: int  # bytes, up to the first point


def read_pcd(path: Path) -> Iterator[RawCloud]:
    """Read a PCD file. Its VIEWPOINT counts where the position is not zero, which is its default.

    Raises:
        CloudFileError: not a PCD file, a header that is wrong or that promises more than the file holds,
            no x, y, z, or no points.
    """
    with path.open("rb") as file:
        header = _read_header(file, path)
    require(header.rows > 0, path, "at least one point", "0")
    notes: tuple[str, ...] = ()
    if header.encoding == "ascii":
        columns = read_ascii(path, header.columns, header.rows, header.size)
        notes = _pack_text_colors(columns, header.columns)
    elif header.encoding == "binary":
        columns = read_binary(path, header.columns, header.rows, header.size)
        notes = surplus(path, header.columns, header.rows, header.size)
    else:
        columns = _read_compressed(path, header.columns, header.rows, header.size)
    yield raw_from_columns(str(path), f"pcd {header.encoding}", columns, header.scanner, notes)


def _read_header(file: BinaryIO, path: Path) -> _PcdHeader:
    lines: dict[str, list[str]] = {}
    while "DATA" not in lines:
        line = file.readline(_LONGEST_HEADER)
        words = line.decode("latin-1").split()
        require(line.endswith(b"\n"), path, "a PCD header, which ends with a line 'DATA'", excerpt(line))
        if not words or words[0].startswith("#"):
            continue
        key = "FIELDS" if words[0] == "COLUMNS" else words[0]
        require(key in _KEYS and key not in lines, path, "a line of a PCD header", excerpt(line))
        lines[key] = words[1:]
        require(file.tell() < _LONGEST_HEADER, path, "a PCD header of a few lines", "64 KiB without 'DATA'")
    encoding = " ".join(lines["DATA"])
    known = ("ascii", "binary", "binary_compressed")
    require(encoding in known, path, "DATA " + " or ".join(known), excerpt(encoding))
    return _PcdHeader(encoding, _columns(lines, path), _rows(lines, path), _scanner(lines, path), file.tell())


def _columns(lines: dict[str, list[str]], path: Path) -> list[Column]:
    fields, sizes, types = (lines.get(key, []) for key in ("FIELDS", "SIZE", "TYPE"))
    counts = lines.get("COUNT", ["1"] * len(fields))
    lengths = [len(fields), len(sizes), len(types), len(counts)]
    equal = len(fields) > 0 and len(set(lengths)) == 1
    require(equal, path, "as many FIELDS as SIZE, TYPE, COUNT", str(lengths))
    columns = []
    for name, size, kind, text in zip(fields, sizes, types, counts, strict=True):
        require((kind, size) in _TYPES, path, f"a TYPE and SIZE for {name} such as F 4", f"{kind} {size}")
        count = count_of(text, path, f"the COUNT of {name}")
        require(1 <= count <= 1 << 20, path, f"a COUNT of {name} from 1 to 2^20", text)
        columns.append(Column(name, np.dtype(f"<{kind.lower()}{size}"), count))
    return columns


def _rows(lines: dict[str, list[str]], path: Path) -> int:
    keys = [key for key in ("WIDTH", "HEIGHT", "POINTS") if key in lines]
    counts = {key: count_of(" ".join(lines[key]), path, key) for key in keys}
    grid = counts["WIDTH"] * counts.get("HEIGHT", 1) if "WIDTH" in counts else None
    points = counts.get("POINTS", grid)
    if points is None:
        refuse(path, "a line POINTS or WIDTH", "neither")
    require(grid in (None, points), path, "POINTS equal to WIDTH times HEIGHT", f"{points} and {grid}")
    return points


def _scanner(lines: dict[str, list[str]], path: Path) -> Scanner | None:
    words = lines.get("VIEWPOINT", ["0"] * 7)
    try:
        position = np.array([float(word) for word in words])[:3]
    except ValueError:
        position = np.zeros(0)
    fits = len(words) == 7 and len(position) == 3 and bool(np.isfinite(position).all())
    require(fits, path, "7 numbers after VIEWPOINT", excerpt(" ".join(words)))
    return scanner_of_file(position, assumed=False) if position.any() else None


def _pack_text_colors(columns: Columns, declared: list[Column]) -> tuple[str, ...]:
    """Give packed colors in text their four bytes back; "nan" has lost them and becomes black."""
    dtypes = {column.name.lower(): column.dtype for column in declared}
    lost = 0
    for name in PACKED_COLORS:
        if name in columns and dtypes[name].kind == "f":
            values = columns[name]
            known = np.isfinite(values)
            lost += int((~known & np.isfinite(columns.get("x", values))).sum())
            with np.errstate(over="ignore"):
                columns[name] = np.where(known, values, 0).astype(dtypes[name].newbyteorder("="))
    return (f"{lost} packed colors are no numbers and were made black",) * (lost > 0)


def _read_compressed(path: Path, columns: Sequence[Column], rows: int, offset: int) -> Columns:
    """Read a compressed body: two sizes, then all columns one after another, packed as LZF.

    LibLZF unpacks it, behind checks of both sizes: Open3D 0.20 crashes on some damaged headers, and where x, y, z
    differ in type it finds no points. Arguments and result are those of ``read_binary``; ``CloudFileError`` for sizes
    that disagree with the header or the file, and for bytes that are no LZF.
    """
    with path.open("rb") as file:
        file.seek(offset)
        body = file.read()
    require(len(body) >= 8, path, "8 bytes with the sizes of the compressed points", f"{len(body)} bytes")
    packed, full = (int(size) for size in np.frombuffer(body, "<u4", count=2))
    wanted = rows * record_dtype(columns).itemsize
    require(full == wanted, path, f"{wanted} bytes when uncompressed, as its header declares", f"{full}")
    require(packed <= len(body) - 8, path, f"{packed} compressed bytes", f"{len(body) - 8}")
    possible = full <= packed * _LARGEST_RATIO  # before LibLZF takes memory for them
    require(possible, path, f"{full} bytes when uncompressed", f"{packed} compressed bytes, too few for so many")
    try:
        plain = lzf.decompress(body[8 : 8 + packed], full)  # None where there are more
    except ValueError as error:
        refuse(path, "LZF-compressed points", str(error))
    if plain is None or len(plain) != full:
        refuse(path, f"{full} bytes when uncompressed", "more" if plain is None else f"{len(plain)}")
    by_name: Columns = {}
    start = 0
    for column in columns:
        values = np.frombuffer(plain, column.dtype, count=rows * column.count, offset=start)
        first = values.reshape(rows, column.count)[:, 0]
        by_name.setdefault(column.name.lower(), first.astype(column.dtype.newbyteorder("=")))
        start += values.nbytes
    return by_name
