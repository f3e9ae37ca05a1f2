"""Scans that are read by chunks: what a reader yields, and how the chunks become one cloud, thinned where asked for.

A chunk holds some of the rows of a scan. Rows without a finite position are dropped as they come, colors are scaled to
[0, 1] once the largest of them is known, and coordinates become meters before they are thinned.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.io.assemble import RawCloud, ScaledColors, plain_scale, scale_colors
from torchreg.io.thin import CloudRows, VoxelGrid

CHUNK_ROWS = 1 << 18
"""Rows of a chunk: about 20 MB in double precision with colors, normals and intensity."""

Progress = Callable[[int, "int | None"], None]
"""Is called with the rows read so far, and all rows of the scan where the file says how many."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ScanStream:
    """A scan before its points are read.

    Attributes:
        head: everything but the rows.
        rows: how many the file declares; ``None`` where it does not say.
        chunks: reads them; may be called once.
        white: what stands for full brightness in the colors, where the file says it.
        found: notes that only reading shows; complete once the chunks are read.
    """

    head: RawCloud
    rows: int | None
    chunks: Callable[[], Iterator[CloudRows]]
    white: float | None = None
    found: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Thinning:
    """How a scan becomes smaller while it is read; by default it does not.

    Attributes:
        voxel: meters, the edge of the cubes whose points are averaged; ``None`` takes no cubes, or where ``at_most``
            asks for them, such as leave that many.
        at_most: points that are kept as they are; only a larger scan is thinned, by cubes that double until so many
            are left.
    """

    voxel: float | None = None
    at_most: int | None = None

    @property
    def is_asked_for(self) -> bool:
        """Whether a scan may become smaller."""
        return self.voxel is not None or self.at_most is not None


def stream_of(raw: RawCloud) -> ScanStream:
    """A cloud that was read whole, as a stream of its rows; colors in [0, 1], or left out with a note."""
    colors, depth, notes = raw.colors, raw.color_depth, raw.notes
    if colors is not None and depth is None:
        finite = np.isfinite(raw.points).all(axis=1)  # (N,)
        scaled = scale_colors(colors[finite]) if finite.any() else ScaledColors(None, "", ())
        depth, notes = scaled.depth, (*notes, *scaled.notes)
        colors = None if scaled.values is None else np.zeros(raw.points.shape)
        if colors is not None:
            colors[finite] = scaled.values
    empty = np.empty((0, 3))
    head = replace(raw, points=empty, colors=None, normals=None, intensity=None, color_depth=depth, notes=notes)
    whole = CloudRows(raw.points, colors, raw.normals, raw.intensity)

    def chunks() -> Iterator[CloudRows]:
        for begin in range(0, len(raw.points), CHUNK_ROWS):
            yield whole.where(slice(begin, begin + CHUNK_ROWS))

    return ScanStream(head=head, rows=len(raw.points), chunks=chunks, white=1.0)


def collect(
    stream: ScanStream, *, thinning: Thinning, meters: float = 1.0, progress: Progress | None = None
) -> RawCloud:
    """Read all chunks of a scan.

    Args:
        stream: whose chunks were not read yet.
        thinning: what is kept.
        meters: length of the unit of the file.
        progress: is called after every chunk.

    Returns:
        The cloud in meters, its rows finite and its colors in [0, 1].

    Raises:
        CloudFileError: from the reader.
        ValueError: voxels too small to be numbered.
    """
    kept = VoxelGrid(thinning.voxel, thinning.at_most)
    colors = _ColorScale(stream.white)
    read = left_out = dropped = 0
    for rows in stream.chunks():
        finite = np.isfinite(rows.points).all(axis=1)  # (n,)
        read += len(finite) + rows.left_out  # rows.where leaves out the latter
        left_out += rows.left_out
        dropped += len(finite) - int(np.count_nonzero(finite))
        rows = rows if finite.all() else rows.where(finite)  # first: what is dropped does not scale the others
        kept.add(rows._replace(colors=colors.seen(rows.colors), points=rows.points * meters))
        if progress is not None:
            progress(read, stream.rows)
    rows = kept.take()
    scaled, depth, color_notes = colors.scaled(rows.colors, stream.head.color_depth)
    notes = [*stream.head.notes, *stream.found, *color_notes, *kept.notes()]
    if left_out:
        notes.append(f"{left_out:,} rows are no points (no return, or marked as invalid) and were left out")
    return replace(
        in_meters(stream.head, meters),
        points=rows.points,
        colors=scaled,
        normals=rows.normals,
        intensity=_useful(rows.intensity),
        color_depth=depth,
        rows_in_file=read,
        dropped=dropped,
        voxel=kept.edge,
        notes=tuple(notes),
    )


def in_meters(raw: RawCloud, meters: float) -> RawCloud:
    """The cloud with its lengths multiplied by the meters of their unit."""
    if meters == 1:
        return raw
    scanner, pose = raw.scanner, raw.pose
    if scanner is not None and scanner.position is not None:
        scanner = scanner._replace(position=scanner.position * meters)
    if pose is not None:
        pose = np.concatenate([pose[:, :3], pose[:, 3:] * [[meters], [meters], [meters], [1.0]]], axis=1)
    return replace(raw, points=raw.points * meters, origin=raw.origin * meters, scanner=scanner, pose=pose)


class _ColorScale:
    """The largest color so far, and what follows from it."""

    def __init__(self, white: float | None) -> None:
        self._white, self._low, self._high, self._whole = white, np.inf, -np.inf, True
        self._lost = self._known = 0  # colors that are no numbers, and that are

    def seen(self, colors: NDArray[Any] | None) -> NDArray[Any] | None:
        """The colors (n, 3), which are remembered; those that are no numbers become black."""
        if colors is None or len(colors) == 0:
            return colors
        if colors.dtype.kind == "f":
            finite = np.isfinite(colors).all(axis=1, keepdims=True)
            colors = np.where(finite, colors, 0)
            self._lost += len(finite) - int(np.count_nonzero(finite))
            self._whole &= bool((colors == np.floor(colors)).all())
        self._known += len(colors)
        self._low, self._high = min(self._low, float(colors.min())), max(self._high, float(colors.max()))
        return colors

    def scaled(
        self, colors: NDArray[Any] | None, depth: str | None
    ) -> tuple[NDArray[Any] | None, str | None, tuple[str, ...]]:
        """Colors (N, 3) in [0, 1], or ``None`` where they mean nothing, their depth, and notes."""
        if colors is None or not len(colors):
            return None, None, ()
        white, high, notes = self._white, self._high, []
        if self._lost == self._known:
            return None, None, ("read without colors: not one of them is a finite number",)
        if self._lost:
            notes.append(f"{self._lost} colors are not finite and were made black")
        usable = plain_scale(self._low, high, is_whole=self._whole)
        if usable is None:
            return None, None, (f"read without colors: they reach from {self._low:g} to {high:g}, not 0 to 1 or 255",)
        if high == 0 and depth is None:
            return None, None, ("read without colors: all are 0 0 0",)
        if white is not None and high > white * 1.001:
            notes.append(f"colors reach {high:g}, above the {white:g} that the file declares")
            white = None
        if white == 65535 and high <= 255:
            notes.append(f"16-bit colors reach only {high:g}: taken for 8-bit values")
            white = 255
        if white is None:
            white = float(usable)
        depth = depth or {1.0: "float", 255.0: "uint8", 65535.0: "uint16"}.get(white, f"0 to {white:g}")
        return np.clip(colors / white, 0, 1), depth, tuple(notes)


def _useful(intensity: NDArray[Any] | None) -> NDArray[Any] | None:
    """The intensity (N,), or ``None`` where it is the same everywhere: nothing was measured."""
    known = None if intensity is None else intensity[np.isfinite(intensity)]
    return intensity if known is not None and len(known) > 0 and np.ptp(known) > 0 else None
