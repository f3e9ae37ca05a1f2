"""LAS 1.2 and LAZ, by laspy and lazrs: whole numbers of a step, from an offset in the middle of the cloud.

The step is a tenth of a millimeter, or finer for a small cloud: a millionth of its extent, as a power of ten. Clouds
of more than 400 km need a coarser one. Colors and intensities have 16 bits; the number of a scan is the ID of the
source of a point; there is no place for normals and the scanner.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.io.fields import PointFields
from torchreg.io.foreign import package
from torchreg.io.written import color_levels, expect_finite, global_points
from torchreg.types import Clouds

BRIGHTEST = 65535
TOP = 65535.0
"""The largest intensity."""

_COARSEST, _STEPS = 1e-4, 1e6  # meters; steps along the longest edge of a small cloud
_LARGEST = 2**31 - 2  # steps from the offset
_PLAIN, _COLORED = 0, 2  # point formats


def write_las(file: BinaryIO, cloud: Clouds, dtype: torch.dtype, fields: PointFields | None = None) -> None:
    """Write one cloud as LAS; ``ValueError`` for points that are not finite."""
    _write(file, cloud, fields, compressed=False)


def write_laz(file: BinaryIO, cloud: Clouds, dtype: torch.dtype, fields: PointFields | None = None) -> None:
    """Write one cloud as LAZ; ``ValueError`` for points that are not finite."""
    _write(file, cloud, fields, compressed=True)


def las_step(cloud: Clouds) -> float:
    """The step of coordinates in meters that a LAS file of this cloud has."""
    points = cloud.points.detach().cpu().double().numpy()
    return _step(float(np.ptp(points, axis=0).max()) if len(points) else 0.0)


def _step(extent: float) -> float:
    finest = float(f"1e{math.floor(math.log10(extent / _STEPS))}") if extent > 0 else _COARSEST
    coarsest = (extent / 2 + 1) / _LARGEST
    needed = float(f"1e{math.ceil(math.log10(coarsest))}")
    return max(min(finest, _COARSEST), needed)


def _write(file: BinaryIO, cloud: Clouds, fields: PointFields | None, *, compressed: bool) -> None:
    laspy = package(Path(file.name), "laspy", "'laspy[lazrs]'")
    points, levels = global_points(cloud), color_levels(cloud, BRIGHTEST)
    expect_finite(points, "LAS")
    header = laspy.LasHeader(version="1.2", point_format=_PLAIN if levels is None else _COLORED)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.zeros(3))
    header.offsets = np.round((low + high) / 2)
    header.scales = np.full(3, _step(float((high - low).max())))
    header.generating_software = "torchreg"
    record = _record(laspy, header, points, levels)
    if fields is not None and fields.intensity is not None:
        record.intensity[:] = fields.intensity_to(TOP)
    if fields is not None and fields.scan is not None:
        record.point_source_id[:] = fields.scan.numpy()
    with laspy.open(file, mode="w", header=header, do_compress=compressed, closefd=False) as writer:
        writer.write_points(record)


def _record(laspy: Any, header: Any, points: NDArray[Any], levels: NDArray[Any] | None) -> Any:  # noqa: ANN401
    record = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
    record.x, record.y, record.z = points.T
    record.return_number[:], record.number_of_returns[:] = 1, 1
    if levels is not None:
        record.red, record.green, record.blue = levels.astype(np.uint16).T
    return record
