"""Lines of numbers: how a text file separates them, and the numbers of many lines at once."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from torchreg.io.checks import excerpt, refuse, require

COMMENTS = ("#", "//", "%", "!")
_LONGEST_LINE = 1 << 16  # bytes
_NOT_A_NUMBER = re.compile(r"[-+]?(?:1\.#\w+|nan\([^)\s]*\)|n/a|null|none)", re.IGNORECASE)  # as programs spell it
_ROW = re.compile(r"at row (\d+)")


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """What stands between the numbers of a line; ``None`` is any blanks. Some use a comma for the decimal point."""

    delimiter: str | None = None
    decimal_comma: bool = False

    def words(self, line: str) -> list[str]:
        """The words of a line, without quotes."""
        parts = line.strip().rstrip(self.delimiter or "").split(self.delimiter)
        return [part.strip().strip("\"'") for part in parts]

    def number(self, word: str) -> float | None:
        """The number that a word spells, or ``None``."""
        word = word.replace(",", ".") if self.decimal_comma else word
        try:
            return float(_NOT_A_NUMBER.sub("nan", word))
        except ValueError:
            return None


def dialect_of(line: str) -> Dialect:
    """How a line of numbers separates them: by semicolons, tabs or blanks, or commas."""
    if ";" in line:
        return Dialect(delimiter=";", decimal_comma="," in line and "." not in line)
    if "\t" in line.strip():
        return Dialect(decimal_comma="," in line and "." not in line)
    return Dialect(delimiter="," if "," in line else None)


def open_text(path: Path) -> TextIO:
    """Open a text file, whatever marks its byte order.

    Raises:
        CloudFileError: bytes that are no text, or a line that does not end.
    """
    with path.open("rb") as file:
        start = file.read(_LONGEST_LINE)
    wide = start.startswith((b"\xff\xfe", b"\xfe\xff"))
    require(wide or b"\0" not in start, path, "lines of text", "bytes that are no text: " + excerpt(start))
    ends = b"\n" in start or b"\r" in start or len(start) < _LONGEST_LINE
    require(ends, path, "lines of numbers", f"{_LONGEST_LINE} bytes without an end of line")
    return path.open(encoding="utf-16" if wide else "utf-8-sig", errors="replace")


def is_comment(line: str) -> bool:
    """Whether a line is blank or a comment."""
    return line.isspace() or line.lstrip().startswith(COMMENTS)


def numbers_of(
    lines: list[str], dialect: Dialect, path: Path, first_line: int, columns: tuple[int, ...] | None = None
) -> NDArray[Any]:
    """The numbers (n, w) of lines that all have equally many.

    Args:
        lines: at least one.
        dialect: of the file.
        path: the file.
        first_line: number of the first of them in the file, counted from 1; for the message.
        columns: which to read, counted from 0; the others may be words. ``None`` reads all.

    Raises:
        CloudFileError: a word that is no number, or lines of unequal length.
    """
    given = [_plain(line, dialect) for line in lines]
    try:
        return _loaded(given, dialect, columns)
    except ValueError:
        pass
    try:
        return _loaded([_NOT_A_NUMBER.sub("nan", line) for line in given], dialect, columns)
    except ValueError as error:
        text = _ROW.sub(lambda found: f"at line {first_line + int(found[1])} or soon after", str(error))
        refuse(path, "as many numbers in every line as in the first", text.split(";")[0])


def _loaded(lines: list[str], dialect: Dialect, columns: tuple[int, ...] | None) -> NDArray[Any]:
    table: NDArray[Any] = np.loadtxt(
        lines, dtype=np.float64, comments=None, delimiter=dialect.delimiter, ndmin=2, usecols=columns, quotechar='"'
    )
    return table


def _plain(line: str, dialect: Dialect) -> str:
    line = line.replace(",", ".") if dialect.decimal_comma else line
    return line.rstrip().rstrip(dialect.delimiter) if dialect.delimiter else line


def chunks_of_lines(lines: Iterator[str], size: int) -> Iterator[list[str]]:
    """Lines that are neither blank nor comments, so many at once."""
    chunk: list[str] = []
    for line in lines:
        if line.isspace() or line.lstrip().startswith(COMMENTS):
            continue
        chunk.append(line)
        if len(chunk) == size:
            yield chunk
            chunk = []
    if chunk:
        yield chunk
