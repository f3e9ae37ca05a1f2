"""What a file says of each of its scans before all of their points are read."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.io.assemble import RawCloud
from torchreg.io.formats import Scan


class ScanHead(NamedTuple):
    """One scan of a file."""

    number: int
    name: str | None
    points: int | None  # as the file declares them; ``None`` where it does not say
    has_colors: bool
    pose: NDArray[Any] | None  # (4, 4) ``T_file_scan``, applied when the file is read
    scanner: NDArray[Any] | None  # (3,) where it stood, in the frame and unit of the file


def scan_heads(scans: Sequence[Scan]) -> list[ScanHead]:
    """The heads of the scans of a file. Of each that is read by chunks the first one is read, which uses it up.

    Raises:
        CloudFileError: a first chunk that cannot be read.
    """
    heads = []
    points: int | None
    for number, scan in enumerate(scans):
        if isinstance(scan, RawCloud):
            head, points, colored = scan, len(scan.points), scan.colors is not None
        else:
            with np.errstate(invalid="ignore", over="ignore"):  # as in ``scans_of``
                first = next(scan.chunks(), None) if scan.rows != 0 else None
            head, points, colored = scan.head, scan.rows, first is not None and first.colors is not None
        scanner = None if head.scanner is None else head.scanner.position
        heads.append(ScanHead(number, head.scan, points, colored, head.pose, scanner))
    return heads


def plain_heads(path: str | os.PathLike[str], heads: Sequence[ScanHead]) -> dict[str, object]:
    """The heads of the scans of a file as plain values."""
    return {
        "file": os.fspath(path),
        "scans": [
            {
                "number": head.number,
                "scan": head.name,
                "points_in_file": head.points,
                "has_colors": head.has_colors,
                "pose": None if head.pose is None else head.pose.tolist(),
                "scanner": None if head.scanner is None else head.scanner.tolist(),
            }
            for head in heads
        ],
    }
