"""Text files of one point a line: XYZ, TXT, CSV, ASC and PTS.

Columns are those that the caller names, or a header does, or what the numbers of the first lines look like; a note says
which were taken. Blanks, tabs, commas or semicolons separate them; with semicolons or tabs the decimal point may be a
comma. PTS begins with the number of its points; its intensities may be negative.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TextIO

import numpy as np

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import excerpt, refuse, require
from torchreg.io.placement import Scanner
from torchreg.io.stream import CHUNK_ROWS, ScanStream
from torchreg.io.text_columns import TextLayout, guessed_layout, header_layout, named_layout
from torchreg.io.text_lines import COMMENTS, Dialect, chunks_of_lines, dialect_of, is_comment, numbers_of, open_text
from torchreg.io.thin import CloudRows
from torchreg.io.viewpoint_line import scanner_of_line

_LONGEST_HEADER = 100  # lines
_SAMPLE = 1000  # lines that a layout is guessed from
_LONGEST_COUNT = 15  # digits


@dataclass(frozen=True, kw_only=True)
class _Start:
    """What the lines before and of the first points tell."""

    dialect: Dialect
    layout: TextLayout
    skip: int  # lines before the first point
    count: int | None  # of points, where a line says it
    scanner: Scanner | None  # where a comment says it


def read_text(path: Path) -> Iterator[ScanStream]:
    """Read a text file whose columns a header or the numbers tell.

    Raises:
        CloudFileError: no lines of at least three numbers, a line that differs from the first, fewer points than
            the file declares.
    """
    yield _stream(path, None)


def read_named_text(path: Path, columns: str) -> Iterator[ScanStream]:
    """Read a text file whose columns are named; errors are those of ``read_text``, or names that mean nothing."""
    yield _stream(path, columns)


def _stream(path: Path, columns: str | None) -> ScanStream:
    with open_text(path) as file:
        start = _start(file, path, columns)
    found: list[str] = []
    kind = path.suffix.lower().lstrip(".")
    head = RawCloud(
        name=str(path),
        format=f"{kind} text",
        points=np.empty((0, 3)),
        scanner=start.scanner,
        unit=start.layout.unit,
        notes=start.layout.notes,
    )
    return ScanStream(head=head, rows=start.count, chunks=lambda: _chunks(path, start, found), found=found)


def _chunks(path: Path, start: _Start, found: list[str]) -> Iterator[CloudRows]:
    layout, declared, rows, sections, line = start.layout, start.count, 0, 1, start.skip + 1
    with open_text(path) as file:
        for _ in range(start.skip):
            file.readline()
        for chunk in chunks_of_lines(file, CHUNK_ROWS):
            if declared is not None:
                counts = [one for one in chunk if _is_count(one)]
                sections += len(counts)
                declared += sum(int(one.strip()) for one in counts)
                points = [one for one in chunk if not _is_count(one)] if counts else chunk
            else:
                points = chunk
            if points:
                _expect_width(path, points[0], start)
                table = numbers_of(points, start.dialect, path, line, layout.columns)
                rows += len(table)
                yield layout.rows(table)
            line += len(chunk)
    if declared is None:
        return
    require(rows >= declared, path, f"{declared} points, as it declares", f"{rows}")
    if rows > declared:
        found.append(f"the file declares {declared} points and holds {rows}: all were read")
    if sections > 1:
        found.append(f"{sections} lists of points were joined")


def _start(file: TextIO, path: Path, columns: str | None) -> _Start:
    header: TextLayout | None = None
    count: int | None = None
    scanner: Scanner | None = None
    for skip, line in enumerate(file):
        if skip >= _LONGEST_HEADER:
            break
        if _is_count(line) and count is None:
            count = int(line.strip())
            continue
        dialect = dialect_of(line)
        words = dialect.words(line)
        if is_comment(line) or not _is_data(words, dialect, columns, header):
            bare = line.lstrip("".join(COMMENTS))
            header = header_layout(dialect.words(bare)) or header
            scanner = scanner_of_line(bare.split()) or scanner
            continue
        layout = named_layout(path, columns) if columns is not None else header
        if layout is None:
            layout = _guess(path, chain([line], file), dialect)
        widest = max(layout.columns)
        require(len(words) > widest, path, f"at least {widest + 1} columns", f"{len(words)}: {excerpt(line.strip())}")
        return _Start(dialect=dialect, layout=layout, skip=skip, count=count, scanner=scanner)
    return refuse(path, f"lines of numbers x y z, after at most {_LONGEST_HEADER} others", "none")


def _is_data(words: list[str], dialect: Dialect, columns: str | None, header: TextLayout | None) -> bool:
    """Whether the words of a line are those of a point: numbers, but for columns that nobody reads."""
    numbers = [dialect.number(word) is not None for word in words]
    if header is not None or columns is not None:
        return len(words) >= 3 and sum(numbers) >= 3
    return len(words) >= 3 and all(numbers)


def _guess(path: Path, lines: Iterator[str], dialect: Dialect) -> TextLayout:
    sample = [line for line in next(chunks_of_lines(lines, _SAMPLE)) if not _is_count(line)]
    return guessed_layout(path, numbers_of(sample, dialect, path, 1), intensity_first=path.suffix.lower() == ".pts")


def _expect_width(path: Path, line: str, start: _Start) -> None:
    """Raise ``CloudFileError`` where lines become longer or shorter than the layout was guessed from."""
    width, got = start.layout.width, len(start.dialect.words(line))
    if width is not None:
        require(got == width, path, f"{width} numbers in every line", f"{got}: {excerpt(line.strip())}")


def _is_count(line: str) -> bool:
    """Whether a line is one whole number: how many points follow."""
    word = line.strip()
    return len(word) <= _LONGEST_COUNT and word.isascii() and word.isdigit()
