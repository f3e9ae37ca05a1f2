"""The scans of one side, source or target, of a group of pairs, prepared for poses to be weighed on them.

Of every scan there is an even sample of its points, a search tree over all of them, and where the position of its
scanner is known, an image of the ranges that it measured. A position that is only assumed is no evidence: neither free
space nor the signs of normals follow from it. Coordinates stand apart, (3, G, L), and the samples are filled up with
zeros to one length L, so that one operation serves the poses of all pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.native import call, native
from torchreg.types import Clouds
from torchreg.types.packing import offsets_of
from torchreg.verification.free_space import RangeImages, range_image, side_by_side
from torchreg.verification.partners import Occupancy, PartnerSearch, occupancy

STRIDE = 3  # of the points that strength and features are compared on
_GRAZING = 0.15  # sine of the angle between ray and surface below which the side of the surface is not sure
_AROUND = 3.0  # thresholds within which a point stands near the other scan


class Scans(NamedTuple):
    """One side of G pairs."""

    points: Tensor  # (3, G, L) float32, meters, the sample of every scan
    normals: Tensor | None  # (3, G, L) float32, or ``None``
    colors: Tensor | None  # (3, G, L) float64, or ``None``
    valid: Tensor  # (G, L) bool, false where a sample is filled up
    counts: Tensor  # (G,) float64, points of every sample
    all_points: Tensor  # (3, P) float32, all points of all scans
    all_normals: Tensor | None  # (3, P) float32, or ``None``
    all_colors: Tensor | None  # (3, P) float64, or ``None``
    sizes: Sequence[int]  # of every scan, how many points it has
    origin: Tensor  # (G, 3) float64, meters, where the points' zero lies in the frame of the file
    faced: Tensor  # (G, L) bool, of the samples, where the side of a surface is known (``_faced``)
    all_faced: Tensor  # (P,) bool, likewise of all points
    search: PartnerSearch  # for the nearest of all points
    around: Occupancy  # cells around all points, several thresholds wide
    # of geometry and of color: (G, L', D) of every third point of the samples, and (P, D); ``None`` without
    features: tuple[Tensor | None, ...]
    all_features: tuple[Tensor | None, ...]
    images: RangeImages | None  # of the scanners whose position is known, ``None`` where no position is
    image: Tensor  # (G,) int64, which of the images is the scan's; -1 where it has none


def prepared_scans(
    clouds: Sequence[Clouds],
    spacings: Sequence[float],
    threshold: Tensor,
    sample: int,
    features: Sequence[tuple[Tensor | None, Tensor | None]],
) -> Scans:
    """Prepare one side of G pairs, with ``sample`` points of each scan to weigh poses on.

    The clouds all have normals (colors), or none has; ``spacings``, of their points, and ``threshold`` (G,) are in
    meters; ``features`` are as in ``OverlapFeatures``.
    """
    device = clouds[0].device
    sizes = [len(cloud.points) for cloud in clouds]
    chosen = even_rows(sizes, sample, device)
    counts = torch.tensor([len(rows) for rows in chosen], device=device)
    valid = torch.arange(max(map(len, chosen)), device=device) < counts[:, None]  # (G, L)
    rows = torch.zeros(valid.shape, dtype=torch.int64, device=device)
    rows[valid] = torch.cat(chosen)

    def planes(parts: Sequence[Tensor | None]) -> Tensor | None:
        present = [part for part in parts if part is not None]
        return torch.cat(present).t().contiguous() if present else None

    def sampled(values: Tensor | None) -> Tensor | None:
        return None if values is None else values[:, rows].masked_fill_(~valid, 0.0)

    points = torch.cat([cloud.points for cloud in clouds]).t().contiguous()
    normals, colors = planes([cloud.normals for cloud in clouds]), planes([cloud.colors for cloud in clouds])
    colors = None if colors is None else colors.double()
    images = [
        range_image(cloud.points, cloud.viewpoint[0], spacing)
        if cloud.viewpoint is not None and bool(cloud.viewpoint_known[0])
        else None
        for cloud, spacing in zip(clouds, spacings, strict=True)
    ]
    faced = torch.cat([_faced(cloud) for cloud in clouds])
    known = [image for image in images if image is not None]
    rows_of_features = [[part for part in parts if part is not None] for parts in zip(*features, strict=True)]
    all_features = tuple(torch.cat(parts).float().contiguous() if parts else None for parts in rows_of_features)
    thin = thinned(rows)
    seen = torch.tensor([image is not None for image in images])
    return Scans(
        points=points[:, rows].masked_fill_(~valid, 0.0),
        normals=sampled(normals),
        colors=sampled(colors),
        valid=valid,
        counts=counts.double(),
        all_points=points,
        all_normals=normals,
        all_colors=colors,
        sizes=sizes,
        origin=torch.cat([cloud.origin for cloud in clouds]),
        faced=faced[rows] & valid,
        all_faced=faced,
        search=PartnerSearch(points, sizes, threshold),
        around=occupancy(points, sizes, _AROUND * threshold),
        features=tuple(None if part is None else part[thin] for part in all_features),
        all_features=all_features,
        images=side_by_side(known) if known else None,
        image=torch.where(seen, seen.cumsum(0) - 1, -1).to(device),
    )


def _faced(cloud: Clouds) -> Tensor:
    """(P,) bool: points of one cloud whose normal surely points to the scanner.

    The scanner is known, and its ray does not graze the surface: there a small error of the normal changes its side.
    """
    if cloud.normals is None or cloud.viewpoint is None or not bool(cloud.viewpoint_known[0]):
        return torch.zeros(len(cloud.points), dtype=torch.bool, device=cloud.device)
    ray = (cloud.viewpoint - cloud.points).t()
    x, y, z = (ray * cloud.normals.t()).unbind(0)
    along, (dx, dy, dz) = x + y + z, (ray * ray).unbind(0)
    return along * along > _GRAZING * _GRAZING * (dx + dy + dz)


def thinned(values: Tensor) -> Tensor:
    """Every third of (..., L), in memory of their own."""
    return values[..., ::STRIDE].contiguous()


def even_rows(sizes: Sequence[int], most: int, device: torch.device) -> list[Tensor]:
    """At most so many rows of every scan, evenly along the order of its points, among the points of all."""
    return [
        torch.arange(min(most, size), device=device) * size // max(1, min(most, size)) + first
        for size, first in zip(sizes, offsets_of(sizes)[:-1].tolist(), strict=True)
    ]


def rotated(rotation: Tensor, planes: Tensor) -> Tensor:
    """R (R, 3, 3) times vectors (3, R, L), with the operations of ``apply_rotation``."""
    x, y, z = planes.unbind(0)
    out = torch.empty(3, *torch.broadcast_shapes(x.shape, (len(rotation), 1)), dtype=planes.dtype, device=x.device)
    for i in range(3):
        torch.mul(rotation[:, i, 0, None], x, out=out[i])
        out[i].add_(rotation[:, i, 1, None] * y).add_(rotation[:, i, 2, None] * z)
    return out


def moved_points(scans: Scans, pair: Tensor, rotation: Tensor, translation: Tensor) -> Tensor:
    """The samples of pairs (R,) under poses (R, 3, 3), (R, 3) float32: (3, R, L)."""
    if native(scans.points, rotation, translation):
        return _moved_compiled(scans, pair, rotation, translation)
    return rotated(rotation, scans.points[:, pair]).add_(translation.t()[..., None])


def _moved_compiled(scans: Scans, pair: Tensor, rotation: Tensor, translation: Tensor) -> Tensor:
    """As ``moved_points``."""
    moved = scans.points.new_empty(3, len(pair), scans.points.shape[2])
    call("moved_points", scans.points, pair, rotation, translation, moved, *scans.points.shape[1:2], *moved.shape[1:])
    return moved
