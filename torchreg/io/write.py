"""Write a cloud to a file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.se3 import transform
from torchreg.io.atomic import atomic_write
from torchreg.io.placement import FAR_COORDINATE
from torchreg.io.ply import VIEWPOINT_COMMENT
from torchreg.io.transform_text import checked_rigid
from torchreg.types import Clouds


def write_cloud(path: str | os.PathLike[str], cloud: Clouds, *, T: Tensor | None = None) -> None:
    """Write one cloud as binary PLY or as npz, in full or not at all.

    PLY holds the coordinates with the origin added, in double precision where the cloud has an origin other
    than zero, coordinates beyond 1 km, or float64 points; colors in 8 bits; the viewpoint in a comment that
    ``read_cloud`` understands. npz holds the arrays as they are, the origin apart: nothing is rounded.

    Args:
        path: a name that ends in ``.ply`` or ``.npz``.
        cloud: a batch of one.
        T: (4, 4) rigid, ``T_to_from``, origins included; applied in float64 to points, normals and viewpoint
            first. With a result's ``T_target_source[0]`` this writes the source aligned to the target.

    Raises:
        ValueError: another suffix, a batch of several clouds, a matrix that is not rigid, no such folder.
    """
    suffix = Path(path).suffix.lower()
    expect(suffix in (".ply", ".npz"), "path", "a name that ends in .ply or .npz", os.fspath(path))
    expect(len(cloud) == 1, "cloud", "a batch of one (cloud.select(b) picks one)", f"{len(cloud)} clouds")
    wide = cloud.to(device="cpu", dtype=torch.float64)
    if T is not None:
        wide = transform(wide, torch.from_numpy(checked_rigid(T, "T")))
    with atomic_write(path) as file:
        if suffix == ".ply":
            _write_ply(file, wide, is_wide=cloud.points.dtype == torch.float64)
        else:
            _write_npz(file, wide.to(dtype=cloud.points.dtype))


def _write_npz(file: BinaryIO, cloud: Clouds) -> None:
    arrays = {"points": cloud.points, "origin": cloud.origin[0], "viewpoint": _viewpoint(cloud)}
    optional = {"colors": cloud.colors, "normals": cloud.normals}
    arrays.update({key: value for key, value in optional.items() if value is not None})
    np.savez(file, **{key: value.detach().numpy() for key, value in arrays.items()})  # type: ignore[arg-type]


def _write_ply(file: BinaryIO, cloud: Clouds, is_wide: bool) -> None:
    points = (cloud.points + cloud.origin).detach().numpy()  # (N, 3) float64
    far = bool(cloud.origin.any()) or (len(points) > 0 and float(np.abs(points).max()) > FAR_COORDINATE)
    precise = is_wide or far
    groups: list[tuple[tuple[str, ...], str, NDArray[Any]]] = [
        (("x", "y", "z"), "<f8" if precise else "<f4", points),
    ]
    if cloud.normals is not None:
        groups.append((("nx", "ny", "nz"), "<f4", cloud.normals.detach().numpy()))
    if cloud.colors is not None:
        levels = np.round(np.clip(cloud.colors.detach().numpy(), 0, 1) * 255)
        groups.append((("red", "green", "blue"), "<u1", levels))
    table = np.empty(len(points), dtype=[(name, kind) for names, kind, _ in groups for name in names])
    for names, _, values in groups:
        for i, name in enumerate(names):
            table[name] = values[:, i]
    words = {"<f8": "double", "<f4": "float", "<u1": "uchar"}
    x, y, z = (_viewpoint(cloud) + cloud.origin[0]).tolist()
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {VIEWPOINT_COMMENT} {x:.17g} {y:.17g} {z:.17g}",
        f"element vertex {len(points)}",
        *(f"property {words[kind]} {name}" for names, kind, _ in groups for name in names),
        "end_header",
    ]
    file.write(("\n".join(header) + "\n").encode("ascii"))
    file.write(table.tobytes())


def _viewpoint(cloud: Clouds) -> Tensor:
    """(3,) relative to the origin; NaN where it is not known."""
    return cloud.points.new_full((3,), float("nan")) if cloud.viewpoint is None else cloud.viewpoint[0]
