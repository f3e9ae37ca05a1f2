"""Panoramas on disk, each beside the description of its scan."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

import torch

from torchreg.batch.checked_file import read_checked, write_checked
from torchreg.site.panorama import Panorama

_FORMAT = 1


class KeptPanorama(NamedTuple):
    """What is kept of a scan: ``None`` where the place of its scanner is not known."""

    panorama: Panorama | None


def panorama_file(described: Path) -> Path:
    """Where the panorama of a scan is kept whose description is kept in a file."""
    return described.with_suffix(".panorama")


def write_panorama(path: Path, panorama: Panorama | None) -> None:
    """Write a panorama, or that there is none.

    Raises:
        OSError: it cannot be written.
    """
    buffer = io.BytesIO()
    torch.save((_FORMAT, None if panorama is None else tuple(panorama)), buffer)
    write_checked(path, buffer.getvalue())


def read_panorama(path: Path) -> KeptPanorama | None:
    """What was kept; ``None`` where the file is missing, damaged or of another format."""
    body = read_checked(path)
    if body is None:
        return None
    kept = torch.load(io.BytesIO(body), map_location="cpu", weights_only=True)
    if kept[0] != _FORMAT:
        return None
    return KeptPanorama(None if kept[1] is None else Panorama(*kept[1]))
