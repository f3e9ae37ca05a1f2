"""Lines of text at the start of a file whose body may be binary."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"  # of UTF-8; editors put it at the start of a text


class HeaderLine(NamedTuple):
    """The words of a line, and the byte of the file at which the next one starts."""

    words: list[str]
    end: int


def header_lines(path: Path, longest: int) -> Iterator[HeaderLine]:
    """The lines within the first ``longest`` bytes of a file, a byte order mark left out.

    They end in LF, CR LF, or CR alone: what the first of them ends in, all do, since the bytes of a binary body that
    follows may look like another line end. A last line without an end is none.
    """
    with path.open("rb") as file:
        head = file.read(longest)
    start = len(_BYTE_ORDER_MARK) if head.startswith(_BYTE_ORDER_MARK) else 0
    end_of_line = _end_of_line(head)
    while (end := head.find(end_of_line, start) + 1) > 0:
        yield HeaderLine(head[start:end].decode("latin-1").split(), end)
        start = end


def _end_of_line(head: bytes) -> bytes:
    feed, carriage = head.find(b"\n"), head.find(b"\r")
    is_mac = carriage >= 0 and (feed < 0 or carriage + 1 < feed)
    return b"\r" if is_mac else b"\n"
