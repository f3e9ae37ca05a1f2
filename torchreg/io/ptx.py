"""PTX, Leica's text for scans on a grid: a header of poses before the rows of every scan, many scans a file.

Ten lines of a header, then columns x rows lines "x y z intensity" or "x y z intensity red green blue":

    columns, rows                               one number a line
    position of the scanner, its three axes     x y z a line
    T_file_scan transposed                      4 lines of 4 numbers: the translation is the last of them

The points, which are in the scan's own frame, get this transform applied. "0 0 0" is a beam without a return, and the
colors "0 0 0" of all points are none. Where the position of the scanner or the translation is not zero, the scanner is
known.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import count_of, excerpt, refuse, require
from torchreg.io.placement import FARTHEST_COORDINATE, scanner_of_file
from torchreg.io.stream import CHUNK_ROWS, ScanStream
from torchreg.io.text_lines import Dialect, chunks_of_lines, numbers_of
from torchreg.io.thin import CloudRows

_HEADER_LINES = 10
_LONGEST_LINE = 1 << 16  # bytes
_BLOCK = 1 << 20  # bytes that are searched for ends of lines at once
_BLANKS = Dialect()
_NEAR = 1e-3  # by which the position of the scanner may differ from the translation, in meters


@dataclass(frozen=True, eq=False, kw_only=True)
class _PtxHeader:
    number: int  # of the scan
    rows: int
    T: NDArray[Any]  # (4, 4) T_file_scan
    position: NDArray[Any]  # (3,) of the scanner in the file's frame
    notes: tuple[str, ...]
    line: int  # number of its first row, counted from 1
    offset: int  # byte of that row


def read_ptx(path: Path) -> Iterator[ScanStream]:
    """Read the scans of a PTX file.

    Raises:
        CloudFileError: a header that is none, a matrix that is not rigid, fewer rows than the header declares, rows of
            another form.
    """
    offset, line, number = 0, 1, 0
    while True:
        with path.open("rb") as file:
            file.seek(offset)
            header = _header(file, path, number, line)
            if header is None:
                require(number > 0, path, "a PTX header of 10 lines", "nothing")
                return
            offset = _after(file, path, header)
        yield _stream(path, header)
        line, number = header.line + header.rows, number + 1


def _stream(path: Path, header: _PtxHeader) -> ScanStream:
    moved = bool(header.position.any())
    head = RawCloud(
        name=str(path),
        format=f"ptx, scan {header.number}",
        points=np.empty((0, 3)),
        scanner=scanner_of_file(header.position, assumed=False) if moved else None,
        pose=header.T,
        notes=header.notes,
    )
    return ScanStream(head=head, rows=header.rows, chunks=lambda: _chunks(path, header))


def _chunks(path: Path, header: _PtxHeader) -> Iterator[CloudRows]:
    R, t = header.T[:3, :3], header.T[:3, 3]
    is_identity = np.array_equal(header.T, np.eye(4))
    line, width, rows = header.line, 0, 0
    with path.open("rb") as file:
        file.seek(header.offset)
        text = io.TextIOWrapper(file, encoding="latin-1")
        for chunk in chunks_of_lines(islice(text, header.rows), CHUNK_ROWS):
            table = numbers_of(chunk, _BLANKS, path, line)
            width = width or table.shape[1]
            legal = width in (4, 7) and table.shape[1] == width
            require(legal, path, "4 or 7 numbers in every row", f"{table.shape[1]} at line {line}")
            line, rows = line + len(chunk), rows + len(table)
            there = table[:, :3].any(axis=1)  # NaN is there, and dropped later
            table = table if there.all() else table[there]
            local = table[:, :3]
            yield CloudRows(
                local if is_identity else np.einsum("ni,ji->nj", local, R) + t,
                table[:, 4:7] if width == 7 else None,
                None,
                table[:, 3],
                left_out=int((~there).sum()),
            )
    require(rows == header.rows, path, f"{header.rows} rows in scan {header.number}, as it declares", f"{rows}")


def _header(file: BinaryIO, path: Path, number: int, line: int) -> _PtxHeader | None:
    """The header that follows; ``None`` where only blank lines do."""
    lines: list[str] = []
    read = 0
    while len(lines) < _HEADER_LINES:
        text = file.readline(_LONGEST_LINE)
        if not text:
            break
        read += 1
        words = text.decode("latin-1").strip().removeprefix("\xef\xbb\xbf")
        if words or lines:
            lines.append(words)
    if not lines:
        return None
    whole = len(lines) == _HEADER_LINES
    require(whole, path, f"a header of {_HEADER_LINES} lines before scan {number}", f"{len(lines)} lines")
    columns = count_of(lines[0], path, f"the number of columns of scan {number}")
    rows = count_of(lines[1], path, f"the number of rows of scan {number}")
    position = _floats(path, lines[2], 3)
    T, notes = _transform(path, [_floats(path, text, 4) for text in lines[6:]], number)
    apart = float(np.linalg.norm(position - T[:3, 3]))
    if apart > _NEAR and position.any() and T[:3, 3].any():
        notes = (*notes, f"the position of the scanner is {apart:.3g} m from the translation of its pose, which counts")
    return _PtxHeader(
        number=number,
        rows=columns * rows,
        T=T,
        position=T[:3, 3].copy() if T[:3, 3].any() else position,
        notes=notes,
        line=line + read,
        offset=file.tell(),
    )


def _transform(path: Path, rows: list[NDArray[Any]], number: int) -> tuple[NDArray[Any], tuple[str, ...]]:
    """``T_file_scan``; files that do not transpose it are told by its last row."""
    written = np.stack(rows)
    unit = np.array([0.0, 0.0, 0.0, 1.0])
    upright = np.array_equal(written[3], unit) and not np.array_equal(written[:, 3], unit)
    T = written if upright else written.T
    R = T[:3, :3]
    rigid = (
        np.array_equal(T[3], unit)
        and bool((np.abs(T) < FARTHEST_COORDINATE).all())
        and bool(np.abs(R @ R.T - np.eye(3)).max() < _NEAR)
        and np.linalg.det(R) > 0
    )
    require(rigid, path, f"a rigid 4x4 matrix in the header of scan {number}", excerpt(str(written.tolist())))
    notes = (f"the matrix of scan {number} is not transposed, as PTX has it: read with its translation last",) * upright
    return np.ascontiguousarray(T), notes


def _floats(path: Path, text: str, count: int) -> NDArray[Any]:
    numbers = [number for word in text.split() if (number := _BLANKS.number(word)) is not None]
    if len(numbers) != count or len(text.split()) != count:
        refuse(path, f"{count} numbers in a line of a PTX header", excerpt(text))
    require(max(map(abs, numbers)) < FARTHEST_COORDINATE, path, "lengths in meters in its PTX header", excerpt(text))
    return np.array(numbers)


def _after(file: BinaryIO, path: Path, header: _PtxHeader) -> int:
    """The byte after the rows of a scan, of which there must be as many as it declares."""
    left, offset = header.rows, file.tell()
    while left > 0:
        block = file.read(_BLOCK)
        if not block:
            break
        ends = block.count(b"\n")
        if ends >= left:
            places = np.flatnonzero(np.frombuffer(block, np.uint8) == 10)
            return offset + int(places[left - 1]) + 1
        left, offset = left - ends, offset + len(block)
    if left == 1 and header.rows and not _ends_with_newline(file, offset):
        left = 0
    got = header.rows - left
    require(left == 0, path, f"{header.rows} rows in scan {header.number}, as it declares", f"{got}")
    return offset


def _ends_with_newline(file: BinaryIO, end: int) -> bool:
    file.seek(end - 1)
    return file.read(1) == b"\n"
