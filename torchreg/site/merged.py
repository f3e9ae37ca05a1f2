"""The scans of a site as one cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchreg.errors import at_least, expect, positive
from torchreg.geometry.se3 import transform
from torchreg.preprocess.downsample import voxel_downsample
from torchreg.site.result import SiteResult
from torchreg.types import Clouds

_GRAY = 0.5
"""Of points without a color beside some with one."""


def merged_cloud(scans: Sequence[Clouds], site: SiteResult, *, spacing: float, group: int = 0) -> Clouds:
    """Put the scans of one group into one cloud, thinned.

    Points are averaged in cubes of half the edge scan by scan, and then all together, so that memory is for what is
    kept. Scans without colors are gray beside colored ones.

    Args:
        scans: the N scans that were placed, each a batch of one.
        site: where they are.
        spacing: meters, the edge of the cubes.
        group: which group.

    Returns:
        A batch of one, in the frame of the group, without a scanner or normals.

    Raises:
        ValueError: another number of scans, a group without scans, or a spacing that is not above 0.
    """
    positive(spacing, "spacing")
    at_least(group, "group", 0)
    expect(len(scans) == len(site), "scans", f"the {len(site)} scans of the site", len(scans))
    members = (site.group == group).nonzero()[:, 0].tolist()
    expect(len(members) > 0, "group", f"one of {int(site.group.max()) + 1} groups", group)
    colored = any(scans[scan].colors is not None for scan in members)
    parts: list[Clouds] = []
    for scan in members:
        bare = replace(scans[scan].to(device="cpu"), normals=None, viewpoint=None)
        if colored and bare.colors is None:
            bare = replace(bare, colors=torch.full_like(bare.points, _GRAY))
        parts.append(voxel_downsample(_with_origin(transform(bare, site.T_world_scan[scan]), parts), spacing / 2))
    return voxel_downsample(_joined(parts), spacing)


def _with_origin(cloud: Clouds, parts: Sequence[Clouds]) -> Clouds:
    """The cloud with the origin of the first part, if there is one."""
    if not parts:
        return cloud
    origin = parts[0].origin
    moved: Tensor = cloud.points.double() + (cloud.origin - origin)
    return replace(cloud, points=moved.to(cloud.points.dtype), origin=origin)


def _joined(parts: Sequence[Clouds]) -> Clouds:
    """Clouds of one origin as one."""
    whole = Clouds.pack(parts)
    return Clouds(points=whole.points, colors=whole.colors, origin=parts[0].origin)
