"""What a scanner saw speaks against a pose: surfaces of the other scan that it looked through.

Rooms of one kind, floors of one plan and panels of a row fit onto each other almost as well as one place onto itself,
and far better than two rooms do that share a door. What tells them apart is the little that is not alike: where a
cupboard of the one scan stands, the scanner of the other saw the wall behind it. A surface that is hidden says nothing,
one that is seen where it should be speaks for the pose, and one that the scanner looked through speaks against it, if
the pose is known more exactly than it is seen through: so this is asked of refined poses.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply, inverse
from torchreg.neighborhoods.point_index import several_nearest
from torchreg.refinement.surfels import Surfels

_NEAREST = 4  # rays of the scanner around a surfel
_WIDER = 1.5  # of the angle between its rays: no ray is farther from a surfel that it tells something of
_SLACK, _SLOPE = 0.5, 0.01  # spacings, and of the range, by which a range may be off
_GRAZING = 0.3  # cosine between ray and normal: planes seen flatter are not drawn out


class Sight(NamedTuple):
    """The surfels of a scan as its scanner saw them.

    Attributes:
        points: (P, 3) float64, meters, in the frame of the scan's file.
        scanner: (3,) float64, likewise.
        rays: (P, 3) float64, of unit length, from the scanner.
        normals: (P, 3) float64, of unit length.
        ranges: (P,) float64, meters.
        angle: radians between neighboring rays, the median.
        spacing: meters between neighboring surfels.
    """

    points: Tensor
    scanner: Tensor
    rays: Tensor
    normals: Tensor
    ranges: Tensor
    angle: float
    spacing: float


class Seen(NamedTuple):
    """Of surfels of one scan that the scanner of another could have seen: how many it looked through, and saw."""

    through: int
    there: int

    @property
    def share(self) -> float:
        """The share that it looked through, as if one of twenty more had been."""
        return (self.through + 1.0) / (self.through + self.there + 20.0)


def sight_of(surfels: Surfels) -> Sight | None:
    """The sight of a batch of one; ``None`` where the place of its scanner is not known, or it has few surfels."""
    cloud = surfels.cloud
    if cloud.viewpoint is None or not bool(cloud.viewpoint_known.all()) or len(cloud.points) <= _NEAREST:
        return None
    origin = cloud.origin[0].cpu()
    away = (cloud.points - cloud.viewpoint[0]).double().cpu()
    ranges = torch.linalg.vector_norm(away, dim=1).clamp(min=1e-9)
    rays = away / ranges[:, None]
    near = several_nearest(rays, rays, _NEAREST)
    angle = float(torch.linalg.vector_norm(rays[near[:, -1]] - rays, dim=1).median())
    scanner = cloud.viewpoint[0].double().cpu() + origin
    normals: Tensor = cloud.normals  # type: ignore[assignment]  # surfels have them
    return Sight(away + scanner, scanner, rays, normals.double().cpu(), ranges, angle, surfels.spacing[0])


def seen_by(viewer: Sight, other: Sight, T_viewer_other: Tensor) -> Seen:
    """What the scanner of ``viewer`` saw of the surfels of ``other`` under a pose (4, 4) float64."""
    away = apply(T_viewer_other, other.points) - viewer.scanner
    ranges = torch.linalg.vector_norm(away, dim=1).clamp(min=1e-9)
    rays = away / ranges[:, None]
    near = several_nearest(rays, viewer.rays, _NEAREST)  # (P, K)
    apart = torch.linalg.vector_norm(viewer.rays[near] - rays[:, None], dim=2)
    looked = apart.amax(dim=1) <= _WIDER * viewer.angle
    # where the rays meet the planes of the viewer's surfels, besides where these are
    across = (viewer.normals[near] * rays[:, None]).sum(dim=2)
    level = (viewer.normals[near] * viewer.rays[near]).sum(dim=2) * viewer.ranges[near]
    drawn = torch.where(across.abs() > _GRAZING, level / across, viewer.ranges[near])
    least = torch.minimum(drawn, viewer.ranges[near]).amin(dim=1)
    most = torch.maximum(drawn, viewer.ranges[near]).amax(dim=1)
    slack = _SLACK * max(viewer.spacing, other.spacing) + _SLOPE * ranges
    through = looked & (least - ranges > slack)
    there = looked & (least - ranges <= slack) & (ranges - most <= slack)
    return Seen(int(through.sum()), int(there.sum()))


def seen_through(source: Sight, target: Sight, T_target_source: Tensor) -> float:
    """The share of the surfaces of either scan that the scanner of the other looked through, the larger of both."""
    forth, back = seen_by(target, source, T_target_source), seen_by(source, target, inverse(T_target_source))
    return max(forth.share, back.share)
