"""The header of a PLY file: its encoding, its elements and their properties."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from torchreg.io.checks import count_of, excerpt, refuse, require
from torchreg.io.columns import Column
from torchreg.io.header_lines import header_lines
from torchreg.io.placement import Scanner
from torchreg.io.viewpoint_line import scanner_of_line

BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 20  # bytes
_TYPES = {
    **{"char": "i1", "short": "i2", "int": "i4", "uchar": "u1", "ushort": "u2", "uint": "u4"},
    **{"int8": "i1", "int16": "i2", "int32": "i4", "uint8": "u1", "uint16": "u2", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
    # beyond the standard, but what they mean is plain
    **{"int64": "i8", "uint64": "u8", "long": "i8", "ulong": "u8", "half": "f2", "float16": "f2"},
}


@dataclass(frozen=True)
class ListColumn:
    """A list in every row: how long it is, then its numbers."""

    name: str
    length: np.dtype[Any]
    dtype: np.dtype[Any]


@dataclass
class PlyElement:
    """One kind of rows: its name, how many there are, and what each holds, in order."""

    name: str
    rows: int
    properties: list[Column | ListColumn] = field(default_factory=list)

    @property
    def columns(self) -> list[Column]:
        """The properties of one number."""
        return [each for each in self.properties if isinstance(each, Column)]

    @property
    def has_list(self) -> bool:
        """Whether a row holds a list."""
        return len(self.columns) < len(self.properties)


@dataclass
class PlyHeader:
    """What a header says.

    Attributes:
        encoding: a key of ``BYTE_ORDERS``.
        elements: in the order of their rows.
        scanner: what a comment of ``write_cloud`` says of it.
        size: bytes up to the first row.
    """

    encoding: str = ""
    elements: list[PlyElement] = field(default_factory=list)
    scanner: Scanner | None = None
    size: int = 0


def read_header(path: Path) -> PlyHeader:
    """Read the header of a PLY file; its lines end in LF, CR LF or CR.

    Raises:
        CloudFileError: not a PLY file, or a line that no header has.
    """
    lines = header_lines(path, _LONGEST_HEADER)
    first = next(lines, None)
    if first is None or first.words != ["ply"]:
        with path.open("rb") as file:
            refuse(path, "a PLY file, which starts with the line 'ply'", excerpt(file.read(80)))
    header = PlyHeader()
    for line in lines:
        if line.words == ["end_header"]:
            require(header.encoding != "", path, "a line 'format' in its header", "none")
            header.size = line.end
            return header
        _take_line(header, line.words, path)
    return refuse(path, "a line 'end_header' in its first megabyte", "none")


def vertices_of(header: PlyHeader, path: Path) -> tuple[int, tuple[str, ...]]:
    """Which element holds the points, and a note where it has another name than "vertex".

    Raises:
        CloudFileError: none has this name, and none the properties x, y, z.
    """
    names = [element.name for element in header.elements]
    if "vertex" in names:
        return names.index("vertex"), ()
    for i, element in enumerate(header.elements):
        if {"x", "y", "z"} <= {column.name.lower() for column in element.columns}:
            return i, (f"no element 'vertex': the points are those of {excerpt(element.name)}",)
    return refuse(path, "an element 'vertex' in its header", ", ".join(names) or "no element")


def _take_line(header: PlyHeader, words: list[str], path: Path) -> None:
    match words:
        case [] | ["obj_info", *_]:
            pass
        case ["comment", *comment] if (scanner := scanner_of_line(comment)) is not None:
            header.scanner = scanner
        case ["comment", *_]:
            pass
        case ["format", encoding, version] if encoding in BYTE_ORDERS and version.startswith("1."):
            require(header.encoding == "", path, "one line 'format'", "two")
            header.encoding = encoding
        case ["element", name, rows]:
            header.elements.append(PlyElement(name, count_of(rows, path, f"the number of elements {name!r}")))
        case ["property", "list", length, kind, name] if header.elements and {length, kind} <= _TYPES.keys():
            counted = _TYPES[length][0] in "iu"
            require(counted, path, "a list whose length is a whole number", excerpt(" ".join(words)))
            one = ListColumn(name, _dtype(header, length, path), _dtype(header, kind, path))
            header.elements[-1].properties.append(one)
        case ["property", kind, name] if kind in _TYPES and header.elements:
            header.elements[-1].properties.append(Column(name, _dtype(header, kind, path)))
        case _:
            refuse(path, "a line of a PLY 1.0 header", excerpt(" ".join(words)))


def _dtype(header: PlyHeader, kind: str, path: Path) -> np.dtype[Any]:
    require(header.encoding != "", path, "the line 'format' before the elements", "it comes later")
    return np.dtype(f"{BYTE_ORDERS[header.encoding]}{_TYPES[kind]}")
