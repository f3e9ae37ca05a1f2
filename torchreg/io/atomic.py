"""Files that are written in full or not at all."""

from __future__ import annotations

import os
import re
import secrets
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from torchreg.errors import expect, expect_in_words

_DIGITS = 8  # of the random number in the name of a temporary file
_REMAINS = re.compile(rf"\..+\.[0-9a-f]{{{_DIGITS}}}\.tmp", re.DOTALL)


@contextmanager
def atomic_write(
    path: str | os.PathLike[str], *, durable: bool = True, through_link: bool = True
) -> Iterator[BinaryIO]:
    """Open a temporary file beside ``path`` and put it in its place once all is written.

    A reader of ``path`` sees the old content or the new, never a part. An error inside the block
    removes the temporary file; a process that is killed leaves it behind as ``.NAME.XXXXXXXX.tmp``.

    Args:
        path: the file.
        durable: whether the content is on the disk when this ends, so that not even a power cut can empty the file.
        through_link: whether a symbolic link of that name stays and the file it names is written, as is right for a
            file that a user names; else the link itself is replaced and what it names is left alone, as is right for
            the files of a folder, whose names anybody may guess.

    Raises:
        ValueError: the folder does not exist, or ``path`` is one.
    """
    target = Path(os.path.realpath(path)) if through_link else Path(path).absolute()
    expect(target.parent.is_dir(), "path", "a file in a folder that exists", os.fspath(path))
    replaced = target.is_symlink() and not through_link  # a link to a folder is no folder
    expect_in_words(replaced or not target.is_dir(), "path", "a file", f"the folder {os.fspath(path)}")
    part = target.with_name(f".{target.name}.{secrets.token_hex(_DIGITS // 2)}.tmp")
    opened = part.open("xb")  # which follows no link, and takes no file that is there
    try:
        with opened as file:
            yield file
            file.flush()
            if durable:
                os.fsync(file.fileno())
        os.replace(part, target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: str | os.PathLike[str], text: str, *, through_link: bool = True) -> None:
    """Write a text in UTF-8, in full or not at all, as ``atomic_write`` does."""
    with atomic_write(path, through_link=through_link) as file:
        file.write(text.encode())


def remove_remains(folder: Path, older_than: float = 0.0) -> None:
    """Remove the temporary files that killed processes left in a folder, unless changed in the last seconds.

    Only files that are named as ``atomic_write`` names them; others of a folder that is shared are not ours.
    """
    for part in folder.glob(".*.tmp"):
        try:
            status = part.lstat()
            ours = _REMAINS.fullmatch(part.name) and stat.S_ISREG(status.st_mode)
            if ours and time.time() - status.st_mtime >= older_than:
                part.unlink()
        except FileNotFoundError:  # another process was faster
            continue
