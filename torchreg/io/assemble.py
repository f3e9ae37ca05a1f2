"""From what a reader hands on to ``Clouds``: finite points, colors in [0, 1], unit normals, origin and viewpoint."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import expect, expect_in_words
from torchreg.io.placement import FARTHEST_COORDINATE, Scanner, choose_origin, place_scanner
from torchreg.types import Clouds

_ROUNDING = 1e-6  # of the largest: colors that differ less are the same
_SLACK = 1e-3  # a float color may exceed [0, 1] by this much and is cut off
_LEAST_BRIGHT = 16.0  # floats whose largest lies from here to 255 are 8-bit values


@dataclass(frozen=True, eq=False, kw_only=True)
class RawCloud:
    """A cloud as its file holds it, numbers untouched. All positions are relative to ``origin``, in meters.

    Attributes:
        name: how messages call it: the file's path, or an argument.
        format: such as "ply ascii".
        points: (N, 3) float64.
        colors: (N, 3) of any real dtype and range, or ``None``.
        normals: (N, 3) float64 of any length, or ``None``.
        origin: (3,) float64.
        scanner: what the file says of its position (``scanner_of_file``); ``None`` where it says nothing.
        notes: what a user should know.
        color_depth: of colors that are in [0, 1] already, what they were; ``None`` where they are as in the file.
        intensity: (N,) of the returns, as in the file, or ``None``.
        scan: name of the scan in its file, or ``None``.
        pose: (4, 4) ``T_file_scan``, already applied to the points, where the file has one.
        unit: of the coordinates, where the file says it: a key of ``units.METERS``.
        rows_in_file: where rows were dropped or averaged on the way; ``None`` where these are all.
        dropped: rows without a finite position among them.
        voxel: meters, edge of the cubes in which points were averaged, or ``None``.
    """

    name: str
    format: str
    points: NDArray[Any]
    colors: NDArray[Any] | None = None
    normals: NDArray[Any] | None = None
    origin: NDArray[Any] = field(default_factory=lambda: np.zeros(3))
    scanner: Scanner | None = None
    notes: tuple[str, ...] = ()
    color_depth: str | None = None
    intensity: NDArray[Any] | None = None
    scan: str | None = None
    pose: NDArray[Any] | None = None
    unit: str | None = None
    rows_in_file: int | None = None
    dropped: int = 0
    voxel: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudFile:
    """A cloud and what reading it showed.

    Attributes:
        cloud: a batch of one.
        path: the file.
        format: such as "ply binary_little_endian".
        points_in_file: before points were dropped.
        dropped_non_finite: points with NaN or infinity among their coordinates.
        color_depth: "uint8", "uint16" or "float" in the file; ``None`` without colors.
        viewpoint_source: where the scanner's position is known from, in words, or that it is assumed.
        extent: edges of the bounding box along x, y, z, in meters.
        notes: what a user should know, such as colors that had to be guessed at.
        intensity: (N,) of the returns, in the file's own scale and the dtype of the points, or ``None``.
        scan: name of the scan in its file, or ``None``.
        pose: (4, 4) float64 ``T_file_scan`` in meters, which the points already have applied, or ``None``: a
            scanner's own frame in the frame of the file.
        unit: of the coordinates, where the file says it, such as "m" or "us-ft".
        voxel: meters, edge of the cubes in which points were averaged while they were read, or ``None``.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.write_cloud("a.ply", tr.Clouds(torch.rand(10, 3)))
        >>> file = tr.io.read_cloud_report("a.ply")
        >>> file.format, file.points_in_file
        ('ply binary_little_endian', 10)
    """

    cloud: Clouds
    path: str
    format: str
    points_in_file: int
    dropped_non_finite: int
    color_depth: str | None
    viewpoint_source: str
    extent: tuple[float, float, float]
    notes: tuple[str, ...]
    intensity: Tensor | None = None
    scan: str | None = None
    pose: Tensor | None = None
    unit: str | None = None
    voxel: float | None = None

    @property
    def has_colors(self) -> bool:
        """Whether the cloud has colors."""
        return self.cloud.colors is not None

    @property
    def has_normals(self) -> bool:
        """Whether the cloud has normals."""
        return self.cloud.normals is not None


def assemble(raw: RawCloud, viewpoint: str | NDArray[Any] | None, dtype: torch.dtype) -> CloudFile:
    """Make a batch of one cloud.

    Args:
        raw: from a reader.
        viewpoint: a ``checked_viewpoint``.
        dtype: of points, colors, normals and viewpoint.

    Raises:
        ValueError: not one finite point, coordinates that no survey has.
    """
    finite = np.isfinite(raw.points).all(axis=1)  # (N,)
    expect_in_words(bool(finite.any()), raw.name, "at least one finite point", f"none among {len(finite):,}")
    points = raw.points[finite]
    largest = float(np.abs(points).max())
    if largest > FARTHEST_COORDINATE:
        raise ValueError(f"{raw.name}: expected coordinates up to {FARTHEST_COORDINATE:g} m, got {largest:g}")
    shift = choose_origin(points)
    scanner = place_scanner(viewpoint, raw.scanner, points, raw.origin)
    scaled = _unless_of_one_color(_scaled_colors(raw, finite))
    normals, normal_notes = _unit_normals(None if raw.normals is None else raw.normals[finite])
    position = None if scanner.position is None else (scanner.position - shift)[None]  # (1, 3)
    cloud = Clouds(
        points=torch.from_numpy(points - shift).to(dtype),
        colors=_tensor(scaled.values, dtype),
        normals=_tensor(normals, dtype),
        origin=torch.from_numpy(raw.origin + shift)[None],  # (1, 3)
        viewpoint=_tensor(position, dtype),
        viewpoint_assumed=torch.tensor([scanner.assumed]),
    )
    x, y, z = (points.max(axis=0) - points.min(axis=0)).tolist()
    return CloudFile(
        cloud=cloud,
        path=raw.name,
        format=raw.format,
        points_in_file=len(finite) if raw.rows_in_file is None else raw.rows_in_file,
        dropped_non_finite=len(finite) - len(points) + raw.dropped,
        color_depth=None if scaled.values is None else scaled.depth,
        viewpoint_source=scanner.source,
        extent=(x, y, z),
        notes=(*raw.notes, *scaled.notes, *normal_notes),
        intensity=_tensor(None if raw.intensity is None else raw.intensity[finite], dtype),
        scan=raw.scan,
        pose=_tensor(raw.pose, torch.float64),
        unit=raw.unit,
        voxel=raw.voxel,
    )


def checked_dtype(dtype: torch.dtype) -> torch.dtype:
    """Return ``dtype`` if it is float32 or float64, else raise ``ValueError``."""
    expect(dtype in (torch.float32, torch.float64), "dtype", "torch.float32 or torch.float64", dtype)
    return dtype


class ScaledColors(NamedTuple):
    """Colors in [0, 1] and what they were."""

    values: NDArray[Any] | None  # (N, 3) float64, or ``None`` where not one color is a number
    depth: str  # "uint8", "uint16" or "float"
    notes: tuple[str, ...]  # what a user should know


def _scaled_colors(raw: RawCloud, finite: NDArray[Any]) -> ScaledColors:
    if raw.colors is None:
        return ScaledColors(None, "", ())
    colors = raw.colors[finite]
    return ScaledColors(colors, raw.color_depth, ()) if raw.color_depth else scale_colors(colors)


def scale_colors(colors: NDArray[Any]) -> ScaledColors:
    """Scale colors to [0, 1] by their dtype; by their largest value where the dtype does not tell.

    ==============================  ========================================================
    uint8                           / 255
    uint16                          / 65535
    other integers                  / 255 up to 255, / 65535 up to 65535
    floats up to 1                  as they are
    floats from 16 to 255           / 255 (the largest counts: averages of 8-bit colors)
    whole floats from 256 to 65535  / 65535
    anything else                   no colors, and a note: negative values, other floats
    ==============================  ========================================================

    A color with NaN or infinity becomes black, which has no hue.

    Args:
        colors: (N, 3) integers or floats.
    """
    if colors.dtype.kind in "iu":
        return _scale_integers(colors)
    with np.errstate(over="ignore"):  # of long doubles
        colors = colors.astype(np.float64)
    finite = np.isfinite(colors).all(axis=1)  # (N,)
    if not finite.any():
        return ScaledColors(None, "float", ("read without colors: not one of them is a finite number",))
    values = np.where(finite[:, None], colors, 0)
    low, high = float(values.min()), float(values.max())
    whole = bool((values == np.floor(values)).all())
    scale = None if whole and 1 < high < _LEAST_BRIGHT else plain_scale(low, high, is_whole=whole)
    if scale is None:
        ranges = f"floats from 0 to 1, or to 255 with a maximum of at least {_LEAST_BRIGHT:g}"
        return ScaledColors(None, "float", (f"read without colors: expected {ranges}, got {low:g} to {high:g}",))
    lost = len(finite) - int(finite.sum())
    notes = [f"{lost} colors are not finite and were made black"] * (lost > 0)
    if scale > 1:
        bits = 8 if scale == 255 else 16
        notes.append(f"float colors up to {high:g} were taken for {bits}-bit values and divided by {scale}")
    return ScaledColors(np.clip(values / scale, 0, 1), "float", tuple(notes))


def plain_scale(low: float, high: float, *, is_whole: bool) -> int | None:
    """What colors from ``low`` to ``high`` are divided by where no type tells; ``None`` where that is not plain."""
    if low < -_SLACK:
        return None
    if high <= 1 + _SLACK:
        return 1
    if (is_whole or high >= _LEAST_BRIGHT) and high <= 255:
        return 255
    return 65535 if is_whole and high <= 65535 else None


def _scale_integers(colors: NDArray[Any]) -> ScaledColors:
    low, high = int(colors.min()), int(colors.max())
    if low < 0 or high > 65535:
        note = f"read without colors: expected integers from 0 to 255 or 65535, got {low} to {high}"
        return ScaledColors(None, "", (note,))
    is_wide = colors.dtype == np.uint16 or high > 255
    notes: tuple[str, ...] = ()
    if is_wide and high <= 255:
        notes = (f"16-bit colors reach only {high} of 65535: very dark, unless they are 8-bit values",)
    return ScaledColors(colors / (65535.0 if is_wide else 255.0), "uint16" if is_wide else "uint8", notes)


def of_one_color(colors: NDArray[Any]) -> bool:
    """Whether several colors (N, 3) are the same, up to the rounding of means."""
    largest = float(np.abs(colors).max(initial=0))
    return len(colors) > 1 and float(np.ptp(colors, axis=0).max()) <= _ROUNDING * largest


def _unless_of_one_color(scaled: ScaledColors) -> ScaledColors:
    """No colors where several points have the same: they say nothing that the points do not."""
    values = scaled.values
    if values is None or not of_one_color(values):
        return scaled
    red, green, blue = np.round(values[0] * 255).astype(int).tolist()
    note = f"read without colors: every point has the same, {red} {green} {blue} of 255"
    return ScaledColors(None, scaled.depth, (*scaled.notes, note))


def _unit_normals(normals: NDArray[Any] | None) -> tuple[NDArray[Any] | None, tuple[str, ...]]:
    """Normals of length one, or none at all where some have no direction: ``Clouds`` has all of them or none."""
    if normals is None:
        return None, ()
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(normals, axis=1, keepdims=True)  # (N, 1)
    bad = int((~(np.isfinite(length) & (length > 1e-12))).sum())
    if bad > 0:
        return None, (f"read without normals: {bad} of {len(normals)} have no direction",)
    return normals / length, ()


def _tensor(values: NDArray[Any] | None, dtype: torch.dtype) -> Tensor | None:
    return None if values is None else torch.from_numpy(np.ascontiguousarray(values)).to(dtype)
