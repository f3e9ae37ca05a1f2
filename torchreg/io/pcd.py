"""PCD 0.5 to 0.7: a header of fields, then the points as text, packed records or LZF-compressed columns.

The header is read as PCL reads it: TYPE and DATA in either case, fields without SIZE or TYPE as floats of four bytes,
unknown keys ignored.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import count_of, excerpt, refuse, require
from torchreg.io.column_colors import PACKED_COLORS, are_numbers
from torchreg.io.columns import (
    Column,
    Columns,
    columns_of_lines,
    lines_of_rows,
    raw_from_columns,
    read_binary,
    record_size,
    surplus,
    take,
)
from torchreg.io.foreign import package
from torchreg.io.header_lines import header_lines
from torchreg.io.placement import Scanner, scanner_of_file
from torchreg.io.viewpoint_line import scanner_of_line

_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_TYPES = {*(("F", size) for size in "248"), *((kind, size) for kind in "UI" for size in "1248")}
_LONGEST_HEADER = 1 << 16  # bytes
_LARGEST_RATIO = 88  # the longest reference of LZF: 264 bytes from 3


@dataclass(frozen=True, eq=False)
class _PcdHeader:
    encoding: str
    columns: list[Column]
    rows: int
    scanner: Scanner | None
    size: int  # bytes, up to the first point
    notes: tuple[str, ...]


def read_pcd(path: Path) -> Iterator[RawCloud]:
    """Read a PCD file. Its VIEWPOINT counts where the position is not zero, which is its default.

    The comment that ``write_cloud`` leaves counts before it.

    Raises:
        CloudFileError: not a PCD file, a header that is wrong or that promises more than the file holds,
            no x, y, z, or no points.
    """
    header = _read_header(path)
    require(header.rows > 0, path, "at least one point", "0")
    notes: tuple[str, ...] = ()
    if header.encoding == "ascii":
        lines = lines_of_rows(path, header.rows, header.size)
        columns, notes = columns_of_lines(path, header.columns, lines)
        notes += _pack_text_colors(columns, header.columns)
    elif header.encoding == "binary":
        columns = read_binary(path, header.columns, header.rows, header.size)
        notes = surplus(path, header.columns, header.rows, header.size)
    else:
        columns = _read_compressed(path, header.columns, header.rows, header.size)
    yield raw_from_columns(str(path), f"pcd {header.encoding}", columns, header.scanner, (*header.notes, *notes))


def _read_header(path: Path) -> _PcdHeader:
    lines: dict[str, list[str]] = {}
    commented: Scanner | None = None
    for line in header_lines(path, _LONGEST_HEADER):
        if line.words and line.words[0].startswith("#"):
            commented = scanner_of_line(line.words[1:]) or commented
            continue
        key = line.words[0].upper() if line.words else ""
        key = "FIELDS" if key == "COLUMNS" else key
        if key in _KEYS:
            require(key not in lines, path, f"one line {key} in a PCD header", excerpt(" ".join(line.words)))
            lines[key] = line.words[1:]
        if key == "DATA":
            break
    else:
        refuse(path, "a PCD header, which ends with a line 'DATA'", "none in its first 64 KiB")
    encoding = " ".join(lines["DATA"]).lower()
    require(encoding in _ENCODINGS, path, "DATA " + " or ".join(_ENCODINGS), excerpt(encoding))
    scanner, notes = _scanner(lines)
    return _PcdHeader(encoding, _columns(lines, path), _rows(lines, path), commented or scanner, line.end, notes)


def _columns(lines: dict[str, list[str]], path: Path) -> list[Column]:
    fields = lines.get("FIELDS", [])
    sizes = lines.get("SIZE", ["4"] * len(fields))
    types = lines.get("TYPE", ["F" if size in ("4", "8") else "U" for size in sizes])
    counts = lines.get("COUNT", ["1"] * len(fields))
    lengths = [len(fields), len(sizes), len(types), len(counts)]
    equal = len(fields) > 0 and len(set(lengths)) == 1
    require(equal, path, "as many FIELDS as SIZE, TYPE, COUNT", str(lengths))
    columns = []
    for name, size, kind, text in zip(fields, sizes, types, counts, strict=True):
        kind = kind.upper()
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


def _scanner(lines: dict[str, list[str]]) -> tuple[Scanner | None, tuple[str, ...]]:
    """The position that VIEWPOINT gives, zero being its default, and a note where it gives none."""
    words = lines.get("VIEWPOINT", ["0"] * 7)
    try:
        position = np.array([float(word) for word in words])
    except ValueError:
        position = np.zeros(0)
    if len(position) != 7:
        return None, (f"the header's VIEWPOINT is no seven numbers and was ignored: {excerpt(' '.join(words))}",)
    return (scanner_of_file(position[:3], assumed=False) if position[:3].any() else None), ()


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
                values = np.where(known, values, 0)
                columns[name] = values if are_numbers(values) else values.astype(dtypes[name].newbyteorder("="))
    return (f"{lost} packed colors are no numbers and were made black",) * (lost > 0)


def _read_compressed(path: Path, columns: Sequence[Column], rows: int, offset: int) -> Columns:
    """Read a compressed body: two sizes, then all columns one after another, packed as LZF.

    LibLZF unpacks it, behind checks of both sizes: Open3D 0.20 crashes on some damaged headers, and where x, y, z
    differ in type it finds no points. Arguments and result are those of ``read_binary``; ``CloudFileError`` for sizes
    that disagree with the header or the file, and for bytes that are no LZF.
    """
    lzf = package(path, "lzf", "python-neo-lzf")
    with path.open("rb") as file:
        file.seek(offset)
        body = file.read()
    require(len(body) >= 8, path, "8 bytes with the sizes of the compressed points", f"{len(body)} bytes")
    packed, full = (int(size) for size in np.frombuffer(body, "<u4", count=2))
    wanted = rows * record_size(columns, path)
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
        take(by_name, column, values.reshape(rows, column.count))
        start += values.nbytes
    return by_name
