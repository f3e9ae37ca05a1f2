"""PLY: a header of elements and their properties, then their rows, as text or in either byte order.

Read here rather than by Open3D 0.20, whose tensor reader fills the rows that a truncated file lacks with
zeros, leaves 16-bit colors out and writes past its buffers where x, y, z (or the colors) differ in type.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import count_of, excerpt, refuse, require
from torchreg.io.columns import Column, raw_from_columns, read_ascii, read_binary, record_dtype, surplus
from torchreg.io.placement import FAR_COORDINATE, Scanner, scanner_of_file, viewpoint_or_nan
from torchreg.io.splats import holds_splats, raw_from_splats
from torchreg.types import Clouds

BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
# "comment viewpoint x y z": where the scanner stood, or is assumed to have stood; write_cloud leaves one of them
KNOWN_COMMENT, ASSUMED_COMMENT = "viewpoint", "viewpoint_assumed"
_LONGEST_HEADER = 1 << 20  # bytes
_TYPES = {
    **{"char": "i1", "short": "i2", "int": "i4", "uchar": "u1", "ushort": "u2", "uint": "u4"},
    **{"int8": "i1", "int16": "i2", "int32": "i4", "uint8": "u1", "uint16": "u2", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}


@dataclass
class _Element:
    name: str
    rows: int
    columns: list[Column] = field(default_factory=list)
    has_list: bool = False


@dataclass
class _PlyHeader:
    encoding: str = ""
    elements: list[_Element] = field(default_factory=list)
    scanner: Scanner | None = None
    size: int = 0  # bytes, up to the first row


def read_ply(path: Path) -> Iterator[RawCloud]:
    """Read the element "vertex" of a PLY file; elements before it are skipped, those after it ignored.

    Raises:
        CloudFileError: not a PLY file, a header that is wrong or that promises more than the file holds,
            no x, y, z, no vertices, or lists among or (in a binary file) before the vertices.
    """
    with path.open("rb") as file:
        header = _read_header(file, path)
    names = [element.name for element in header.elements]
    require("vertex" in names, path, "an element 'vertex' in its header", ", ".join(names) or "no element")
    before = header.elements[: names.index("vertex")]
    vertex = header.elements[len(before)]
    require(vertex.rows > 0, path, "at least one vertex", "0")
    require(not vertex.has_list, path, "vertices of single numbers", "a list property among them")
    require(len(vertex.columns) > 0, path, "the properties x, y, z", "none")
    notes: tuple[str, ...] = ()
    if header.encoding == "ascii":
        skip = sum(element.rows for element in before)
        columns = read_ascii(path, vertex.columns, vertex.rows, header.size, skip)
    else:
        listed = next((element.name for element in before if element.has_list), None)
        require(listed is None, path, "no lists before the vertices", f"the element {listed!r} with a list")
        skip = sum(element.rows * record_dtype(element.columns).itemsize for element in before)
        columns = read_binary(path, vertex.columns, vertex.rows, header.size + skip)
        if vertex is header.elements[-1]:
            notes = surplus(path, vertex.columns, vertex.rows, header.size + skip)
    make = raw_from_splats if holds_splats(columns) else raw_from_columns
    yield make(str(path), f"ply {header.encoding}", columns, header.scanner, notes)


def write_ply(file: BinaryIO, cloud: Clouds, dtype: torch.dtype) -> None:
    """Write one cloud as ``write_cloud`` describes it: doubles where floats would lose a digit, else floats."""
    points = (cloud.points + cloud.origin).detach().numpy()  # (N, 3) float64
    far = bool(cloud.origin.any()) or (len(points) > 0 and float(np.abs(points).max()) > FAR_COORDINATE)
    precise = dtype == torch.float64 or far
    groups: list[tuple[tuple[str, ...], str, NDArray[Any]]] = [
        (("x", "y", "z"), "<f8" if precise else "<f4", points),
    ]
    if cloud.normals is not None:
        groups.append((("nx", "ny", "nz"), "<f4", cloud.normals.detach().numpy()))
    if cloud.colors is not None:
        levels = np.round(np.clip(cloud.colors.detach().numpy(), 0, 1) * 255)
        groups.append((("red", "green", "blue"), "<u1", levels))
    table = np.empty(len(points), dtype=[(name, kind) for names, kind, _ in groups for name in names])
    for names, _, values in groups:
        for i, name in enumerate(names):
            table[name] = values[:, i]
    words = {"<f8": "double", "<f4": "float", "<u1": "uchar"}
    word = ASSUMED_COMMENT if bool(cloud.viewpoint_assumed[0]) else KNOWN_COMMENT
    x, y, z = (viewpoint_or_nan(cloud) + cloud.origin[0]).tolist()
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {word} {x:.17g} {y:.17g} {z:.17g}",
        f"element vertex {len(points)}",
        *(f"property {words[kind]} {name}" for names, kind, _ in groups for name in names),
        "end_header",
    ]
    file.write(("\n".join(header) + "\n").encode("ascii"))
    file.write(table.tobytes())


def _read_header(file: BinaryIO, path: Path) -> _PlyHeader:
    first = file.readline(80)
    require(first.strip() == b"ply", path, "a PLY file, which starts with the line 'ply'", excerpt(first))
    header = _PlyHeader()
    while file.tell() < _LONGEST_HEADER:
        line = file.readline(_LONGEST_HEADER)
        words = line.decode("latin-1").split()
        if not line.endswith(b"\n"):
            break
        if words == ["end_header"]:
            require(header.encoding != "", path, "a line 'format' in its header", "none")
            header.size = file.tell()
            return header
        _take_line(header, words, path)
    return refuse(path, "a line 'end_header' in its first megabyte", "none")


def _take_line(header: _PlyHeader, words: list[str], path: Path) -> None:
    match words:
        case [] | ["obj_info", *_]:
            pass
        case ["comment", word, *numbers] if word in (KNOWN_COMMENT, ASSUMED_COMMENT) and len(numbers) == 3:
            header.scanner = _scanner(numbers, assumed=word == ASSUMED_COMMENT)
        case ["comment", *_]:
            pass
        case ["format", encoding, "1.0"] if encoding in BYTE_ORDERS:
            header.encoding = encoding
        case ["element", name, rows]:
            header.elements.append(_Element(name, count_of(rows, path, f"the number of elements {name!r}")))
        case ["property", "list", _, _, _] if header.elements:
            header.elements[-1].has_list = True
        case ["property", kind, name] if kind in _TYPES and header.elements:
            order = BYTE_ORDERS.get(header.encoding)
            require(order is not None, path, "the line 'format' before the elements", "it comes later")
            header.elements[-1].columns.append(Column(name, np.dtype(f"{order}{_TYPES[kind]}")))
        case _:
            refuse(path, "a line of a PLY 1.0 header", excerpt(" ".join(words)))


def _scanner(words: list[str], *, assumed: bool) -> Scanner | None:
    """The position that a comment gives; any other comment may start with the same word."""
    try:
        return scanner_of_file(np.array([float(word) for word in words]), assumed=assumed)
    except ValueError:
        return None
