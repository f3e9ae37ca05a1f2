"""Rows of a PLY file that hold lists, and are therefore of several lengths: lists are skipped, numbers kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.io.checks import require
from torchreg.io.columns import Column, Columns, columns_of_lines, take
from torchreg.io.ply_header import ListColumn, PlyElement


class ListRows:
    """The body of a binary file, read element by element.

    Args:
        path: the file.
        offset: byte at which the first row starts.
    """

    def __init__(self, path: Path, offset: int) -> None:
        self._path = path
        self._body = np.fromfile(path, np.uint8, offset=offset)
        self._at = 0

    def skip(self, element: PlyElement) -> None:
        """Move behind the rows of an element; ``CloudFileError`` where the file ends before them."""
        self._starts(element)

    def read(self, element: PlyElement) -> Columns:
        """The numbers of an element's rows, beside its lists, as of ``columns.read_binary``; errors as of ``skip``."""
        by_name: Columns = {}
        for column, start in zip(element.properties, self._starts(element), strict=True):
            if isinstance(column, Column):
                take(by_name, column, self._numbers(start, column.dtype)[:, None])
        return by_name

    def _starts(self, element: PlyElement) -> list[NDArray[np.int64]]:
        """Where each property of each row starts, (rows,) each."""
        least = sum(_smallest(each) for each in element.properties)
        self._require(self._at + least * element.rows <= len(self._body), element)
        if least == 0:
            return []
        if not element.has_list:
            first = self._at + least * np.arange(element.rows)
            self._at += least * element.rows
            sizes = [_smallest(each) for each in element.properties]
            return [first + before for before in np.cumsum([0, *sizes[:-1]]).tolist()]
        return self._equal(element) or self._one_by_one(element)

    def _equal(self, element: PlyElement) -> list[NDArray[np.int64]] | None:
        """The starts where all rows have lists as long as the first row's, as triangles have; else ``None``."""
        at, offsets = self._at, []
        lengths: list[tuple[int, ListColumn, int]] = []
        for each in element.properties if element.rows > 0 else ():
            offsets.append(at - self._at)
            if isinstance(each, ListColumn):
                self._require(at + each.length.itemsize <= len(self._body), element)
                count = int(self._numbers(np.array([at]), each.length)[0])
                lengths.append((at - self._at, each, count))
                at += max(count, 0) * each.dtype.itemsize
            at += _smallest(each)
        size = at - self._at
        if element.rows * size > len(self._body) - self._at or any(count < 0 for _, _, count in lengths):
            return None
        first = self._at + size * np.arange(element.rows)
        for offset, each, count in lengths:
            if (self._numbers(first + offset, each.length) != count).any():
                return None
        self._at += size * element.rows
        return [first + offset for offset in offsets]

    def _one_by_one(self, element: PlyElement) -> list[NDArray[np.int64]]:
        """The starts, row after row."""
        starts = np.empty((len(element.properties), element.rows), np.int64)
        body, at = self._body.tobytes(), self._at
        steps = [_step(each) for each in element.properties]
        for row in range(element.rows):
            for i, (fixed, length, signed, order, item) in enumerate(steps):
                starts[i, row] = at
                if length:
                    count = int.from_bytes(body[at : at + length], order, signed=signed)
                    self._require(0 <= count <= len(body), element)
                    at += count * item
                at += fixed
            self._require(at <= len(body), element)
        self._at = at
        return list(starts)

    def _numbers(self, starts: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
        """The numbers (rows,) that start at these bytes."""
        wide = self._body[starts[:, None] + np.arange(dtype.itemsize)]  # (rows, itemsize)
        return np.ascontiguousarray(wide).view(dtype)[:, 0]

    def _require(self, condition: bool, element: PlyElement) -> None:
        expected = f"{element.rows} rows of the element {element.name!r}, as its header declares"
        require(condition, self._path, expected, f"{len(self._body)} bytes after the header")


def columns_of_list_lines(path: Path, element: PlyElement, lines: list[str]) -> tuple[Columns, tuple[str, ...]]:
    """The numbers beside the lists in lines of text, one row each, as of ``columns.columns_of_lines``.

    Raises:
        CloudFileError: a list without its length or its numbers, and what ``columns_of_lines`` refuses.
    """
    return columns_of_lines(path, element.columns, [_without_lists(path, element, line) for line in lines])


def _without_lists(path: Path, element: PlyElement, line: str) -> str:
    words, kept = line.split(), []
    at = 0
    for each in element.properties:
        require(at < len(words), path, f"a word for {each.name} in every line of {element.name!r}", "a shorter line")
        if isinstance(each, Column):
            kept.append(words[at])
            at += 1
        else:
            word = words[at]
            require(
                word.isascii() and word.isdigit() and len(word) < 10, path, f"the length of {each.name}", repr(word)
            )
            at += 1 + int(word)
    require(at == len(words), path, f"{at} words in a line of {element.name!r}, as its lists say", f"{len(words)}")
    return " ".join(kept)


def _smallest(each: Column | ListColumn) -> int:
    """The bytes of a property in a row, the numbers of a list left out."""
    return each.length.itemsize if isinstance(each, ListColumn) else each.dtype.itemsize


def _step(each: Column | ListColumn) -> tuple[int, int, bool, Any, int]:
    """Its fixed bytes, and of a list: the bytes of its length, whether that is signed, its byte order, its item."""
    if isinstance(each, Column):
        return each.dtype.itemsize, 0, False, "little", 0
    order = "big" if each.length.byteorder == ">" else "little"
    return each.length.itemsize, each.length.itemsize, each.length.kind == "i", order, each.dtype.itemsize
