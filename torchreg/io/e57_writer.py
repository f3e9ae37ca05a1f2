"""E57, by pye57 (libE57Format): one scan or many, coordinates in double precision.

A scan with a pose is written in its own frame. Of a single cloud whose scanner's position is known, the coordinates are
relative to it and a pose moves them to the frame of the file: programs that read the pose know where the scanner stood.
Otherwise it has no pose. An element of an extension, which other programs skip, says what a pose cannot: a position
that is assumed, that is the zero of the frame, or none.

``pye57.E57.write_scan_raw`` would write the global coordinates in single precision.
"""

from __future__ import annotations

import shutil
import tempfile
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import expect_in_words
from torchreg.geometry.se3 import quaternion_wxyz, rigid
from torchreg.io.fields import PointFields
from torchreg.io.foreign import package
from torchreg.io.posed import PosedScan
from torchreg.io.stream import CHUNK_ROWS
from torchreg.io.viewpoint_line import viewpoint_line
from torchreg.io.written import color_levels, normals_of
from torchreg.types import Clouds

NORMALS_PREFIX, NORMALS_URI = "nor", "http://www.libe57.org/E57_NOR_surface_normals.txt"
VIEWPOINT_PREFIX, VIEWPOINT_URI = "torchreg", "urn:torchreg:viewpoint"
VIEWPOINT_ELEMENT = f"{VIEWPOINT_PREFIX}:viewpoint"
_BRIGHTEST = 255


class _ScanNode(NamedTuple):
    name: str
    local: NDArray[Any]  # (N, 3) float64, in the scan's frame
    cloud: Clouds  # for its colors and normals
    viewpoint: str  # what VIEWPOINT_ELEMENT says
    pose: Tensor | None  # (4, 4) T_file_scan
    fields: PointFields


class _Field(NamedTuple):
    name: str
    values: NDArray[Any]  # (N,) float64
    node: Any  # of the prototype


def write_e57(file: BinaryIO, cloud: Clouds, dtype: torch.dtype, fields: PointFields | None = None) -> None:
    """Write one cloud as a file of one scan."""
    known = cloud.viewpoint is not None and bool(cloud.viewpoint_known[0])
    zero = cloud.viewpoint[0] if cloud.viewpoint is not None and known else -cloud.origin[0]  # (3,) of the coordinates
    scan = _ScanNode(
        name="scan",
        local=(cloud.points - zero).detach().numpy(),
        cloud=cloud,
        viewpoint=viewpoint_line(cloud),
        pose=rigid(torch.eye(3, dtype=torch.float64), zero + cloud.origin[0]) if known else None,
        fields=PointFields() if fields is None else fields,
    )
    _write(file, [scan])


def write_e57_scans(file: BinaryIO, scans: Iterable[PosedScan]) -> None:
    """Write scans, each in its own frame with its pose, to one file; ``ValueError`` where there is none."""
    _write(
        file,
        (
            _ScanNode(
                name=scan.name,
                local=scan.cloud.points.numpy(),
                cloud=scan.cloud,
                viewpoint=viewpoint_line(scan.in_file()),
                pose=scan.T_file_scan,
                fields=scan.fields,
            )
            for scan in scans
        ),
    )


def _write(file: BinaryIO, scans: Iterable[_ScanNode]) -> None:
    """Write a file of scans. libE57Format opens files by name: it is made beside the one given."""
    pye57 = package(Path(file.name), "pye57", "pye57")
    with tempfile.TemporaryDirectory(dir=Path(file.name).parent, prefix=".e57-") as folder:
        path, count = Path(folder) / "scan.e57", 0
        with pye57.E57(str(path), mode="w") as made:
            made.image_file.extensionsAdd(VIEWPOINT_PREFIX, VIEWPOINT_URI)
            made.image_file.extensionsAdd(NORMALS_PREFIX, NORMALS_URI)
            for scan in scans:
                _write_scan(pye57.libe57, made, scan)
                count += 1
        expect_in_words(count > 0, "scans", "at least one scan", "none")
        with path.open("rb") as content:
            shutil.copyfileobj(content, file, 1 << 20)


def _write_scan(libe57: Any, made: Any, scan: _ScanNode) -> None:  # noqa: ANN401
    image = made.image_file
    node = libe57.StructureNode(image)
    node.set("guid", libe57.StringNode(image, f"{{{uuid.uuid4()}}}"))
    node.set("name", libe57.StringNode(image, scan.name))
    node.set(VIEWPOINT_ELEMENT, libe57.StringNode(image, scan.viewpoint))
    if scan.pose is not None:
        node.set("pose", _pose(libe57, image, scan.pose))
    node.set("cartesianBounds", _bounds(libe57, image, scan.local))
    if scan.cloud.colors is not None:
        node.set("colorLimits", _color_limits(libe57, image))
    if scan.fields.intensity is not None and len(scan.local):
        node.set("intensityLimits", _intensity_limits(libe57, image, scan.fields.intensity))
    fields = _fields(libe57, image, scan)
    prototype = libe57.StructureNode(image)
    for one in fields:
        prototype.set(one.name, one.node)
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    node.set("points", points)
    made.data3d.append(node)
    _write_rows(libe57, image, points, fields)


def _fields(libe57: Any, image: Any, scan: _ScanNode) -> list[_Field]:  # noqa: ANN401
    local, intensity = scan.local, scan.fields.intensity_to(None)
    fields = [_Field(f"cartesian{axis}", local[:, i], libe57.FloatNode(image, 0.0)) for i, axis in enumerate("XYZ")]
    levels, normals = color_levels(scan.cloud, _BRIGHTEST), normals_of(scan.cloud)
    if intensity is not None:
        fields.append(_Field("intensity", intensity, libe57.FloatNode(image, 0.0)))
    if levels is not None:
        for i, name in enumerate(("Red", "Green", "Blue")):
            fields.append(_Field(f"color{name}", levels[:, i], libe57.IntegerNode(image, 0, 0, _BRIGHTEST)))
    if normals is not None:
        for i, axis in enumerate("XYZ"):
            node = libe57.FloatNode(image, 0.0, libe57.E57_SINGLE, -3.4e38, 3.4e38)
            fields.append(_Field(f"{NORMALS_PREFIX}:normal{axis}", normals[:, i], node))
    return fields


def _write_rows(libe57: Any, image: Any, points: Any, fields: list[_Field]) -> None:  # noqa: ANN401
    rows = len(fields[0].values)
    size = max(min(CHUNK_ROWS, rows), 1)
    arrays = [np.zeros(size) for _ in fields]
    buffers = libe57.VectorSourceDestBuffer()
    for one, array in zip(fields, arrays, strict=True):
        buffers.append(libe57.SourceDestBuffer(image, one.name, array, size, True, True))
    writer = points.writer(buffers)
    for begin in range(0, rows, size):
        count = min(size, rows - begin)
        for one, array in zip(fields, arrays, strict=True):
            array[:count] = one.values[begin : begin + count]
        writer.write(count)
    writer.close()


def _pose(libe57: Any, image: Any, T_file_scan: Tensor) -> Any:  # noqa: ANN401
    pose = libe57.StructureNode(image)
    quaternion, translation = quaternion_wxyz(T_file_scan[:3, :3]).tolist(), T_file_scan[:3, 3].tolist()
    pose.set("rotation", _numbers(libe57, image, dict(zip("wxyz", quaternion, strict=True))))
    pose.set("translation", _numbers(libe57, image, dict(zip("xyz", translation, strict=True))))
    return pose


def _bounds(libe57: Any, image: Any, local: NDArray[Any]) -> Any:  # noqa: ANN401
    finite = local[np.isfinite(local).all(axis=1)] if len(local) else local
    low, high = (finite.min(axis=0), finite.max(axis=0)) if len(finite) else (np.zeros(3), np.zeros(3))
    ends = {"Minimum": low, "Maximum": high}
    numbers = {f"{axis}{end}": float(value[i]) for i, axis in enumerate("xyz") for end, value in ends.items()}
    return _numbers(libe57, image, numbers)


def _color_limits(libe57: Any, image: Any) -> Any:  # noqa: ANN401
    limits = libe57.StructureNode(image)
    for name in ("Red", "Green", "Blue"):
        limits.set(f"color{name}Minimum", libe57.IntegerNode(image, 0))
        limits.set(f"color{name}Maximum", libe57.IntegerNode(image, _BRIGHTEST))
    return limits


def _intensity_limits(libe57: Any, image: Any, intensity: Tensor) -> Any:  # noqa: ANN401
    ends = {"intensityMinimum": float(intensity.min()), "intensityMaximum": float(intensity.max())}
    return _numbers(libe57, image, ends)


def _numbers(libe57: Any, image: Any, numbers: dict[str, float]) -> Any:  # noqa: ANN401
    node = libe57.StructureNode(image)
    for name, value in numbers.items():
        node.set(name, libe57.FloatNode(image, value))
    return node
