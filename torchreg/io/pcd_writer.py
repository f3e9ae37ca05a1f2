"""PCD 0.7, packed records, as PCL and Open3D read them: colors as one float of 0x00RRGGBB.

Coordinates are floats of four bytes within 1 km of zero, where they hold 0.03 mm, and doubles beyond it or where there
is an origin: PCL's points and Open3D's older reader do not take doubles, so they are written only where needed. Normals
have the type of the coordinates: Open3D's tensor reader takes them for it.

VIEWPOINT holds a position that is known. A comment says what it cannot: a position that is assumed, or none.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.io.viewpoint_line import viewpoint_line
from torchreg.io.written import color_levels, global_points, is_far, normals_of
from torchreg.types import Clouds


def write_pcd(file: BinaryIO, cloud: Clouds, dtype: torch.dtype) -> None:
    """Write one cloud as ``write_cloud`` describes it."""
    points, normals, levels = global_points(cloud), normals_of(cloud), color_levels(cloud, 255)
    number = "<f8" if is_far(cloud, points) else "<f4"
    columns = {name: (number, points[:, i]) for i, name in enumerate("xyz")}
    if normals is not None:
        columns |= {f"normal_{name}": (number, normals[:, i]) for i, name in enumerate("xyz")}
    if levels is not None:
        packed = levels.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], dtype=np.uint32)  # (N,)
        columns["rgb"] = ("<f4", packed.astype("<u4").view("<f4"))
    table = np.empty(len(points), dtype=[(name, kind) for name, (kind, _) in columns.items()])
    for name, (_, values) in columns.items():
        table[name] = values
    file.write(_header(cloud, table).encode("ascii"))
    file.write(table.tobytes())


def pcd_step(cloud: Clouds) -> float | None:
    """The largest step in meters between the coordinates of a file of this cloud, ``None`` where nothing is rounded."""
    points = global_points(cloud.to(device="cpu", dtype=torch.float64))
    if not len(points) or is_far(cloud, points) or np.array_equal(points, points.astype(np.float32), equal_nan=True):
        return None
    return float(np.spacing(np.nanmax(np.abs(points)).astype(np.float32)))


def _header(cloud: Clouds, table: NDArray[Any]) -> str:
    names = table.dtype.names or ()
    position = np.zeros(3)
    if cloud.viewpoint is not None and bool(cloud.viewpoint_known[0]):
        position = (cloud.viewpoint + cloud.origin)[0].detach().numpy()
    x, y, z = position.tolist()
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# {viewpoint_line(cloud)}",
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(str(table.dtype[name].itemsize) for name in names)}",
        f"TYPE {' '.join('F' for _ in names)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {len(table)}",
        "HEIGHT 1",
        f"VIEWPOINT {x:.17g} {y:.17g} {z:.17g} 1 0 0 0",
        f"POINTS {len(table)}",
        "DATA binary",
    ]
    return "\n".join(lines) + "\n"
