"""From a raw cloud to ``Clouds``: finite points, colors in [0, 1], unit normals, origin and viewpoint."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import expect
from torchreg.io.color_scale import ScaledColors, scale_colors
from torchreg.io.placement import choose_origin, place_scanner
from torchreg.io.raw_cloud import RawCloud
from torchreg.types import Clouds

FARTHEST_COORDINATE = 1e12  # meters; beyond it the bytes are no coordinates


class Assembled(NamedTuple):
    """A cloud and what was decided on the way; see ``CloudFile`` for the meaning of each."""

    cloud: Clouds
    dropped_non_finite: int
    color_depth: str | None
    viewpoint_source: str
    extent: tuple[float, float, float]
    notes: tuple[str, ...]


def assemble(raw: RawCloud, viewpoint: str | NDArray[Any] | None, dtype: torch.dtype) -> Assembled:
    """Make a batch of one cloud.

    Args:
        raw: what a reader found.
        viewpoint: a ``checked_viewpoint``.
        dtype: of points, colors, normals and viewpoint.

    Raises:
        ValueError: not one finite point, colors out of range, coordinates that no survey has.
    """
    finite = np.isfinite(raw.points).all(axis=1)  # (N,)
    expect(bool(finite.any()), raw.name, "at least one finite point", f"none among {len(finite)}")
    points = raw.points[finite]
    largest = float(np.abs(points).max())
    if largest > FARTHEST_COORDINATE:
        raise ValueError(f"{raw.name}: expected coordinates up to {FARTHEST_COORDINATE:g} m, got {largest:g}")
    shift = choose_origin(points)
    scanner = place_scanner(viewpoint, raw.viewpoint, points, raw.origin)
    scaled = ScaledColors(None, "", ())
    if raw.colors is not None:
        scaled = scale_colors(raw.colors[finite], raw.name)
    normals, normal_notes = _unit_normals(None if raw.normals is None else raw.normals[finite])
    position = None if scanner.position is None else (scanner.position - shift)[None]  # (1, 3)
    cloud = Clouds(
        points=torch.from_numpy(points - shift).to(dtype),
        colors=_tensor(scaled.values, dtype),
        normals=_tensor(normals, dtype),
        origin=torch.from_numpy(raw.origin + shift)[None],  # (1, 3)
        viewpoint=_tensor(position, dtype),
    )
    x, y, z = (points.max(axis=0) - points.min(axis=0)).tolist()
    return Assembled(
        cloud=cloud,
        dropped_non_finite=len(finite) - len(points),
        color_depth=None if scaled.values is None else scaled.depth,
        viewpoint_source=scanner.source,
        extent=(x, y, z),
        notes=(*raw.notes, *scaled.notes, *normal_notes),
    )


def checked_dtype(dtype: torch.dtype) -> torch.dtype:
    """Return ``dtype`` if it is float32 or float64, else raise ``ValueError``."""
    expect(dtype in (torch.float32, torch.float64), "dtype", "torch.float32 or torch.float64", dtype)
    return dtype


def _tensor(values: NDArray[Any] | None, dtype: torch.dtype) -> Tensor | None:
    return None if values is None else torch.from_numpy(np.ascontiguousarray(values)).to(dtype)


def _unit_normals(normals: NDArray[Any] | None) -> tuple[NDArray[Any] | None, tuple[str, ...]]:
    """Normals of length one, or none at all where some have no direction: ``Clouds`` has no half measures."""
    if normals is None:
        return None, ()
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(normals, axis=1, keepdims=True)  # (N, 1)
    bad = int((~(np.isfinite(length) & (length > 1e-12))).sum())
    if bad > 0:
        return None, (f"read without normals: {bad} of {len(normals)} have no direction",)
    return normals / length, ()
