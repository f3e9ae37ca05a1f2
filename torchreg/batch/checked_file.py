"""Files whose content is checked when they are read: a byte that changed on the disk would change results untold."""

from __future__ import annotations

import hashlib
from pathlib import Path

from torchreg.io.atomic import atomic_write

_CHECKSUM_BYTES = 16  # before the content


def write_checked(path: Path, content: bytes) -> None:
    """Write a file in full or not at all; a checksum shows what a power cut damaged.

    Raises:
        OSError: it cannot be written.
    """
    with atomic_write(path, durable=False, through_link=False) as file:
        file.write(_checksum(path.name, content))
        file.write(content)


def read_checked(path: Path) -> bytes | None:
    """What was written to a file; ``None`` where it is missing, damaged or was written under another name."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    checksum, body = content[:_CHECKSUM_BYTES], content[_CHECKSUM_BYTES:]
    return body if _checksum(path.name, body) == checksum else None


def _checksum(name: str, content: bytes) -> bytes:
    """Of a file's name with its content: the name alone says which cloud it is and how it was described."""
    digest = hashlib.blake2b(f"{name}\0".encode(), digest_size=_CHECKSUM_BYTES)
    digest.update(content)
    return digest.digest()
