"""PTX, scan after scan: a header with the pose, and one column of points; ``ptx`` says what the lines mean.

Coordinates have steps of 0.1 micrometers, colors 8 bits, and intensities go from 0 to 1; there is no place for normals
and names. Where the scanner stands is the translation of the pose.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from torchreg.errors import expect_in_words
from torchreg.io.posed import PosedScan
from torchreg.io.written import color_levels, expect_finite

_UNKNOWN = 0.5  # the intensity of points that have none, as other programs write it
_DECIMALS = 7  # of coordinates in meters


def write_ptx_scans(file: BinaryIO, scans: Iterable[PosedScan]) -> None:
    """Write scans to one file; ``ValueError`` for points that are not finite, or no scan."""
    count = 0
    for scan in scans:
        _write_scan(file, scan)
        count += 1
    expect_in_words(count > 0, "scans", "at least one scan", "none")


def _write_scan(file: BinaryIO, scan: PosedScan) -> None:
    import pyarrow
    import pyarrow.csv

    expect_finite(scan.cloud.points.numpy(), "PTX")
    points = np.round(scan.cloud.points.numpy(), _DECIMALS)  # (N, 3)
    points[~points.any(axis=1), 2] = 10.0**-_DECIMALS  # "0 0 0" would be a beam without a return
    intensity, levels = scan.fields.intensity_to(1.0), color_levels(scan.cloud, 255)
    columns = [*points.T, np.full(len(points), _UNKNOWN) if intensity is None else intensity]
    columns += [] if levels is None else list(levels.astype(np.uint8).T)
    file.write(_header(len(points), scan.T_file_scan.numpy()).encode("ascii"))
    table = pyarrow.table({str(place): np.ascontiguousarray(column) for place, column in enumerate(columns)})
    options = pyarrow.csv.WriteOptions(include_header=False, delimiter=" ", quoting_style="none")
    pyarrow.csv.write_csv(table, file, options)


def _header(rows: int, T: NDArray[Any]) -> str:
    axes = [T[:3, 3], *T[:3, :3].T]  # the scanner's place, and its axes in the frame of the file
    lines = [f"{rows}", "1", *map(_numbers, axes), *map(_numbers, T.T)]
    return "\n".join(lines) + "\n"


def _numbers(values: NDArray[Any]) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
