"""A cloud as its file holds it: names found, numbers untouched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.io.checks import refuse, require
from torchreg.io.table import Columns

COORDINATES = ("x", "y", "z")
NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
PACKED_COLORS = ("rgb", "rgba")  # one word 0x_RRGGBB, of PCD; often said to be a float


@dataclass(frozen=True, eq=False)
class RawCloud:
    """What a reader hands on. All positions are relative to ``origin``, in meters.

    Attributes:
        name: how messages call it: the file's path, or an argument.
        format: such as "ply ascii".
        points: (N, 3) float64.
        colors: (N, 3) of any real dtype and range, or ``None``.
        normals: (N, 3) float64 of any length, or ``None``.
        origin: (3,) float64.
        viewpoint: (3,) float64; NaN where the file says that it is not known; ``None`` where it says nothing.
        notes: what a user should know.
    """

    name: str
    format: str
    points: NDArray[Any]
    colors: NDArray[Any] | None
    normals: NDArray[Any] | None
    origin: NDArray[Any]
    viewpoint: NDArray[Any] | None
    notes: tuple[str, ...] = ()


def raw_from_columns(
    name: str,
    kind: str,
    columns: Columns,
    viewpoint: NDArray[Any] | None = None,
    notes: tuple[str, ...] = (),
) -> RawCloud:
    """Pick coordinates, colors and normals by the names that files use.

    Raises:
        CloudFileError: one of x, y, z is missing, or the colors are not of one type.
    """
    points = _three(columns, COORDINATES)
    if points is None:
        refuse(name, "the properties x, y, z", ", ".join(columns) or "none")
    normals = next((found for names in NORMALS if (found := _three(columns, names)) is not None), None)
    return RawCloud(
        name=name,
        format=kind,
        points=points.astype(np.float64),
        colors=_colors(name, columns),
        normals=None if normals is None else normals.astype(np.float64),
        origin=np.zeros(3),
        viewpoint=viewpoint,
        notes=notes,
    )


def _three(columns: Columns, names: tuple[str, ...]) -> NDArray[Any] | None:
    if not all(name in columns for name in names):
        return None
    return np.stack([columns[name] for name in names], axis=1)  # (N, 3)


def _colors(name: str, columns: Columns) -> NDArray[Any] | None:
    for names in COLORS:
        found = _three(columns, names)
        if found is not None:
            kinds = [columns[word].dtype.name for word in names]
            require(len(set(kinds)) == 1, name, f"{', '.join(names)} of one type", ", ".join(kinds))
            return found
    packed = next((columns[word] for word in PACKED_COLORS if word in columns), None)
    if packed is None:
        return None
    require(packed.dtype.itemsize == 4, name, "packed colors of 4 bytes", str(packed.dtype))
    bits = packed.view(np.uint32)
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=1).astype(np.uint8)  # (N, 3)
