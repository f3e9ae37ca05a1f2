"""A rigid transform x_to = R x_from + t as text, in the conventions of other programs; one row each in the table.

Quaternions and Euler angles have no reader that all agree on: a comment after ``#`` names their order; the others are
what their program reads and nothing else. Translations are in meters. Numbers have 17 digits, which float64 survives;
those for CloudCompare 12 decimals, as it writes them itself.

CloudCompare applies a matrix to the coordinates that it shows. Where it shifted them while it loaded a file, a matrix
of the coordinates in the file is another one: load without a shift, or let ``register --aligned`` write the cloud.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.geometry.se3 import quaternion_wxyz


def matrix_text(T: NDArray[Any]) -> str:
    """Four lines of four numbers, rows of the matrix (4, 4), as numpy reads them."""
    return _lines(T)


def cloudcompare_text(T: NDArray[Any]) -> str:
    """Four lines of four numbers, as CloudCompare writes and takes them in Edit > Apply transformation."""
    return "".join(" ".join(f"{value:.12f}" for value in row) + "\n" for row in T)


def quaternion_wxyz_text(T: NDArray[Any]) -> str:
    """A unit quaternion with its real part first and not negative (Eigen's constructor, E57, COLMAP), then t."""
    return "# quaternion w x y z, then translation x y z in meters\n" + _lines([_quaternion(T), T[:3, 3]])


def quaternion_xyzw_text(T: NDArray[Any]) -> str:
    """A unit quaternion with its real part last and not negative (ROS, SciPy, Eigen's coefficients), then t."""
    quaternion = np.roll(_quaternion(T), -1)
    return "# quaternion x y z w, then translation x y z in meters\n" + _lines([quaternion, T[:3, 3]])


def euler_text(T: NDArray[Any]) -> str:
    """Yaw, pitch, roll in degrees, R = Rz(yaw) Ry(pitch) Rx(roll): intrinsic Z, Y', X''; extrinsic x, y, z. Then t."""
    R = T[:3, :3]
    yaw = np.arctan2(R[1, 0], R[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = np.arctan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])  # of what yaw leaves: exact at 90 degrees
    comment = "# Euler angles yaw pitch roll in degrees, R = Rz(yaw) Ry(pitch) Rx(roll), that is intrinsic ZYX;\n"
    return f"{comment}# then translation x y z in meters\n" + _lines([np.degrees([yaw, pitch, roll]), T[:3, 3]])


def e57_text(T: NDArray[Any]) -> str:
    """The element ``pose`` of a scan in the XML part of E57 (ASTM E2807): a unit quaternion and a translation."""
    rotation = dict(zip("wxyz", _quaternion(T), strict=True))
    translation = dict(zip("xyz", T[:3, 3], strict=True))
    lines = ['<pose type="Structure">']
    for name, numbers in (("rotation", rotation), ("translation", translation)):
        lines.append(f'  <{name} type="Structure">')
        lines += [f'    <{key} type="Float">{value:.17g}</{key}>' for key, value in numbers.items()]
        lines.append(f"  </{name}>")
    return "\n".join([*lines, "</pose>"]) + "\n"


def ptx_text(T: NDArray[Any]) -> str:
    """The lines of a PTX header after both counts: scanner, its three axes, and the matrix (4, 4) transposed."""
    return _lines([T[:3, 3], *T[:3, :3].T, *T.T])


def pdal_text(T: NDArray[Any]) -> str:
    """A pipeline of PDAL with its filter ``filters.transformation``: the matrix (4, 4) row by row."""
    matrix = " ".join(f"{value:.17g}" for value in T.reshape(-1))
    return json.dumps([{"type": "filters.transformation", "matrix": matrix}], indent=2) + "\n"


TRANSFORM_FORMATS: dict[str, Callable[[NDArray[Any]], str]] = {
    "matrix": matrix_text,
    "cloudcompare": cloudcompare_text,
    "quaternion-wxyz": quaternion_wxyz_text,
    "quaternion-xyzw": quaternion_xyzw_text,
    "euler-zyx": euler_text,
    "e57": e57_text,
    "ptx": ptx_text,
    "pdal": pdal_text,
}
"""Functions from a rigid transform (4, 4) float64 to text, by the name of the convention."""


def _quaternion(T: NDArray[Any]) -> NDArray[Any]:
    quaternion: NDArray[Any] = quaternion_wxyz(torch.from_numpy(np.ascontiguousarray(T[:3, :3]))).numpy()
    return quaternion


def _lines(rows: Iterable[Iterable[float]]) -> str:
    return "".join(" ".join(f"{value:.17g}" for value in row) + "\n" for row in rows)
