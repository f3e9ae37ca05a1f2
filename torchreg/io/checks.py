"""Errors about files, in one form: the name, what was expected, and what came."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NoReturn

from torchreg.errors import CloudFileError


def refuse(path: str | os.PathLike[str], expected: str, received: str) -> NoReturn:
    """Raise ``CloudFileError`` that names the file, what was expected and what came."""
    raise CloudFileError(f"{os.fspath(path)}: expected {_printable(expected)}, got {_printable(received)}")


def require(condition: bool, path: str | os.PathLike[str], expected: str, received: str) -> None:
    """Raise ``CloudFileError`` unless ``condition``."""
    if not condition:
        refuse(path, expected, received)


def readable_file(path: str | os.PathLike[str]) -> Path:
    """Return the path of a regular file that is not empty and may be read.

    Raises:
        CloudFileError: it is missing, a folder, a device, empty, or closed to this user.
    """
    file = Path(path)
    try:
        require(file.exists(), file, "a file", "nothing of this name")
        require(not file.is_dir(), file, "a file", "a folder")
        require(file.is_file(), file, "a regular file", "a device or pipe")
        require(file.stat().st_size > 0, file, "a file with content", "an empty one (0 bytes)")
        with file.open("rb"):
            pass
    except OSError as error:
        refuse(file, "a file that can be read", error.strerror or str(error))
    return file


def count_of(text: str, path: Path, what: str) -> int:
    """The whole number from 0 to 10^15 that ``text`` spells, else raise ``CloudFileError``."""
    digits = text.isascii() and text.isdigit() and len(text) <= 15
    require(digits, path, f"{what} as a whole number of at most 15 digits", excerpt(text))
    return int(text)


def _printable(text: str) -> str:
    """A message may quote the file: no control characters, and no more of it than a terminal shows well."""
    short = text if len(text) <= 300 else text[:297] + "..."
    return "".join(letter if letter.isprintable() else "?" for letter in short)


def excerpt(text: str | bytes) -> str:
    """The start of a piece of a file, safe to print."""
    return repr(text[:40]) + ("..." if len(text) > 40 else "")
