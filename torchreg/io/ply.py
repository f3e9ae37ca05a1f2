"""PLY: a header of elements and their properties, then their rows, as text or in either byte order.

Read here rather than by Open3D 0.20, whose tensor reader fills the rows that a truncated file lacks with
zeros, leaves 16-bit colors out and writes past its buffers where x, y, z (or the colors) differ in type.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import require
from torchreg.io.columns import (
    Columns,
    columns_of_lines,
    lines_of_rows,
    raw_from_columns,
    read_binary,
    record_size,
    surplus,
)
from torchreg.io.fields import PointFields
from torchreg.io.ply_header import PlyElement, PlyHeader, read_header, vertices_of
from torchreg.io.ply_lists import ListRows, columns_of_list_lines
from torchreg.io.splats import holds_splats, raw_from_splats
from torchreg.io.viewpoint_line import viewpoint_line
from torchreg.io.written import global_points, needs_doubles
from torchreg.types import Clouds


def read_ply(path: Path) -> Iterator[RawCloud]:
    """Read the element "vertex" of a PLY file, or where there is none, the first with x, y, z.

    Other elements and lists are skipped.

    Raises:
        CloudFileError: not a PLY file, a header that is wrong or that promises more than the file holds,
            no x, y, z, or no vertices.
    """
    header = read_header(path)
    place, notes = vertices_of(header, path)
    before, vertex = header.elements[:place], header.elements[place]
    require(vertex.rows > 0, path, "at least one vertex", "0")
    require(len(vertex.columns) > 0, path, "the properties x, y, z", "none")
    columns, more = (_text_rows if header.encoding == "ascii" else _binary_rows)(path, header, before, vertex)
    make = raw_from_splats if holds_splats(columns) else raw_from_columns
    yield make(str(path), f"ply {header.encoding}", columns, header.scanner, (*notes, *more))


def write_ply(file: BinaryIO, cloud: Clouds, dtype: torch.dtype, fields: PointFields | None = None) -> None:
    """Write one cloud as ``write_cloud`` describes it: doubles where floats would lose a digit, else floats."""
    points = global_points(cloud)
    precise = needs_doubles(cloud, points, dtype)
    groups: list[tuple[tuple[str, ...], str, NDArray[Any]]] = [
        (("x", "y", "z"), "<f8" if precise else "<f4", points),
    ]
    if cloud.normals is not None:
        groups.append((("nx", "ny", "nz"), "<f4", cloud.normals.detach().numpy()))
    if cloud.colors is not None:
        levels = np.round(np.clip(cloud.colors.detach().numpy(), 0, 1) * 255)
        groups.append((("red", "green", "blue"), "<u1", levels))
    if fields is not None and fields.intensity is not None:
        groups.append((("intensity",), "<f4", fields.intensity.numpy()[:, None]))
    if fields is not None and fields.scan is not None:  # as int: Open3D skips 16 bits
        groups.append((("scan",), "<i4", fields.scan.numpy()[:, None]))
    table = np.empty(len(points), dtype=[(name, kind) for names, kind, _ in groups for name in names])
    for names, _, values in groups:
        for i, name in enumerate(names):
            table[name] = values[:, i]
    words = {"<f8": "double", "<f4": "float", "<i4": "int", "<u1": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {viewpoint_line(cloud)}",
        f"element vertex {len(points)}",
        *(f"property {words[kind]} {name}" for names, kind, _ in groups for name in names),
        "end_header",
    ]
    file.write(("\n".join(header) + "\n").encode("ascii"))
    file.write(table.tobytes())


def _text_rows(
    path: Path, header: PlyHeader, before: list[PlyElement], vertex: PlyElement
) -> tuple[Columns, tuple[str, ...]]:
    lines = lines_of_rows(path, vertex.rows, header.size, sum(element.rows for element in before))
    if vertex.has_list:
        return columns_of_list_lines(path, vertex, lines)
    return columns_of_lines(path, vertex.columns, lines)


def _binary_rows(
    path: Path, header: PlyHeader, before: list[PlyElement], vertex: PlyElement
) -> tuple[Columns, tuple[str, ...]]:
    if any(element.has_list for element in (*before, vertex)):
        rows = ListRows(path, header.size)
        for element in before:
            rows.skip(element)
        return rows.read(vertex), ()
    offset = header.size + sum(element.rows * record_size(element.columns, path) for element in before)
    columns = read_binary(path, vertex.columns, vertex.rows, offset)
    is_last = vertex is header.elements[-1]
    return columns, surplus(path, vertex.columns, vertex.rows, offset) if is_last else ()
