"""E57, by pye57 (libE57Format): one scan, its coordinates in double precision.

Where the scanner's position is known, the coordinates are relative to it and a pose moves them to the frame of the
file: programs that read the pose know where the scanner stood. Otherwise there is no pose. An element of an extension,
which other programs skip, says what a pose cannot: a position that is assumed, that is the zero of the frame, or none.

``pye57.E57.write_scan_raw`` would write the global coordinates in single precision.
"""

from __future__ import annotations

import shutil
import tempfile
import uuid
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.io.foreign import package
from torchreg.io.stream import CHUNK_ROWS
from torchreg.io.viewpoint_line import viewpoint_line
from torchreg.io.written import color_levels, normals_of
from torchreg.types import Clouds

NORMALS_PREFIX, NORMALS_URI = "nor", "http://www.libe57.org/E57_NOR_surface_normals.txt"
VIEWPOINT_PREFIX, VIEWPOINT_URI = "torchreg", "urn:torchreg:viewpoint"
VIEWPOINT_ELEMENT = f"{VIEWPOINT_PREFIX}:viewpoint"
_BRIGHTEST = 255


class _Field(NamedTuple):
    name: str
    values: NDArray[Any]  # (N,) float64
    node: Any  # of the prototype


def write_e57(file: BinaryIO, cloud: Clouds, dtype: torch.dtype) -> None:
    """Write one cloud as a file of one scan. libE57Format opens files by name: it is made beside the one given."""
    pye57 = package(Path(file.name), "pye57", "pye57")
    with tempfile.TemporaryDirectory(dir=Path(file.name).parent, prefix=".e57-") as folder:
        path = Path(folder) / "scan.e57"
        with pye57.E57(str(path), mode="w") as made:
            _write_scan(pye57.libe57, made, cloud)
        with path.open("rb") as content:
            shutil.copyfileobj(content, file, 1 << 20)


def _write_scan(libe57: Any, made: Any, cloud: Clouds) -> None:  # noqa: ANN401
    image = made.image_file
    image.extensionsAdd(VIEWPOINT_PREFIX, VIEWPOINT_URI)
    image.extensionsAdd(NORMALS_PREFIX, NORMALS_URI)
    known = cloud.viewpoint is not None and bool(cloud.viewpoint_known[0])
    zero = cloud.viewpoint[0] if cloud.viewpoint is not None and known else -cloud.origin[0]  # (3,) of the coordinates
    local = (cloud.points - zero).detach().numpy()  # (N, 3) float64
    scan = libe57.StructureNode(image)
    scan.set("guid", libe57.StringNode(image, f"{{{uuid.uuid4()}}}"))
    scan.set("name", libe57.StringNode(image, "scan"))
    scan.set(VIEWPOINT_ELEMENT, libe57.StringNode(image, viewpoint_line(cloud)))
    if known:
        scan.set("pose", _pose(libe57, image, (zero + cloud.origin[0]).tolist()))
    scan.set("cartesianBounds", _bounds(libe57, image, local))
    if cloud.colors is not None:
        scan.set("colorLimits", _color_limits(libe57, image))
    fields = _fields(libe57, image, cloud, local)
    prototype = libe57.StructureNode(image)
    for one in fields:
        prototype.set(one.name, one.node)
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    scan.set("points", points)
    made.data3d.append(scan)
    _write_rows(libe57, image, points, fields)


def _fields(libe57: Any, image: Any, cloud: Clouds, local: NDArray[Any]) -> list[_Field]:  # noqa: ANN401
    fields = [_Field(f"cartesian{axis}", local[:, i], libe57.FloatNode(image, 0.0)) for i, axis in enumerate("XYZ")]
    levels, normals = color_levels(cloud, _BRIGHTEST), normals_of(cloud)
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


def _pose(libe57: Any, image: Any, translation: list[float]) -> Any:  # noqa: ANN401
    pose = libe57.StructureNode(image)
    pose.set("rotation", _numbers(libe57, image, dict(zip("wxyz", (1.0, 0.0, 0.0, 0.0), strict=True))))
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


def _numbers(libe57: Any, image: Any, numbers: dict[str, float]) -> Any:  # noqa: ANN401
    node = libe57.StructureNode(image)
    for name, value in numbers.items():
        node.set(name, libe57.FloatNode(image, value))
    return node
