"""Files that are written in full or not at all."""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from torchreg.errors import expect


@contextmanager
def atomic_write(path: str | os.PathLike[str], *, durable: bool = True) -> Iterator[BinaryIO]:
    """Open a temporary file beside ``path`` and put it in its place once all is written.

    A reader of ``path`` sees the old content or the new, never a part. An error inside the block
    removes the temporary file; a process that is killed leaves it behind as ``.NAME.XXXXXXXX.tmp``.

    Args:
        path: the file.
        durable: whether the content is on the disk when this ends, so that not even a power cut can empty the file.

    Raises:
        ValueError: the folder does not exist, or ``path`` is one.
    """
    target = Path(os.path.realpath(path))
    expect(target.parent.is_dir(), "path", "a file in a folder that exists", os.fspath(path))
    expect(not target.is_dir(), "path", "a file", f"the folder {os.fspath(path)}")
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        with part.open("xb") as file:
            yield file
            file.flush()
            if durable:
                os.fsync(file.fileno())
        os.replace(part, target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text in UTF-8, in full or not at all, as ``atomic_write`` does."""
    with atomic_write(path) as file:
        file.write(text.encode())


def remove_remains(folder: Path, older_than: float = 0.0) -> None:
    """Remove the temporary files that killed processes left in a folder, unless changed in the last seconds."""
    for part in folder.glob(".*.tmp"):
        try:
            if time.time() - part.stat().st_mtime >= older_than:
                part.unlink()
        except FileNotFoundError:  # another process was faster
            continue
