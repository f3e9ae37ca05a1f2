"""The placed scans of a site in 3D, a view for each of its groups."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.geometry.up import up_of, upright_frame
from torchreg.report.page.markup import paragraph
from torchreg.report.page.viewer import ViewedCloud, viewer_html
from torchreg.report.scene import thin
from torchreg.site.result import SiteResult
from torchreg.types import Clouds

_VIEWS = 4  # groups that are shown, the largest first
_GOLDEN = 0.618034  # of the circle of hues between neighbors, so that no two are close


def site_space(site: SiteResult, scans: Sequence[Clouds], names: Sequence[str], max_points: int) -> str:
    """A view of every group as markup; nothing where no scan is placed."""
    groups = int(site.group.max()) + 1
    parts = []
    for group in range(min(groups, _VIEWS)):
        members = (site.group == group).nonzero()[:, 0].tolist()
        share = max(1, max_points // max(1, int(site.placed.sum())))
        title = f"Group {group}: {len(members)} scans" if groups > 1 else f"{len(members)} scans"
        parts.append(paragraph(f"{title}, at most {share:,} points of each.") if groups > 1 or members else "")
        parts.append(_view(site, scans, names, members, share, title))
    if groups > _VIEWS:
        parts.append(paragraph(f"{groups - _VIEWS} smaller groups are not shown."))
    return "\n".join(parts)


def _view(
    site: SiteResult, scans: Sequence[Clouds], names: Sequence[str], members: Sequence[int], count: int, title: str
) -> str:
    points, poses, colors = [], [], []
    middle: NDArray[Any] | None = None
    for scan in members:
        cloud = scans[scan]
        every = cloud.points.detach().cpu().double().numpy()
        rows = thin(every, count)
        points.append(every[rows])
        pose = site.T_world_scan[scan].numpy().copy()
        pose[:3, 3] += pose[:3, :3] @ cloud.origin[0].cpu().numpy()
        middle = pose[:3, 3].copy() if middle is None else middle
        pose[:3, 3] -= middle
        poses.append(pose)
        colors.append(
            None if cloud.colors is None else np.clip(cloud.colors.detach().cpu().double().numpy()[rows], 0, 1)
        )
    turn = np.eye(4)
    turn[:3, :3] = _upright(scans[members[0]], points[0], poses[0])
    clouds = [
        ViewedCloud(
            name=f"{scan}: {names[scan]}", points=own, poses=[turn @ pose], color=_color(place), colors=own_colors
        )
        for place, (scan, own, pose, own_colors) in enumerate(zip(members, points, poses, colors, strict=True))
    ]
    return viewer_html(clouds, label=f"3D view of {title}")


def _upright(cloud: Clouds, points: NDArray[Any], pose: NDArray[Any]) -> NDArray[Any]:
    """The rotation (3, 3) of the view that brings up of the first scan to z, as far as it is known."""
    place = None if cloud.viewpoint is None else cloud.viewpoint[0].detach().cpu().double().numpy()
    place = None if place is None or not np.isfinite(place).all() else place
    up = up_of(points, place, cloud.origin[0].cpu().numpy(), known=bool(cloud.viewpoint_known[0]))
    frame: NDArray[Any] = upright_frame(up, points, place) @ pose[:3, :3].T
    return frame


def _color(place: int) -> str:
    """A color such as ``#d55e00`` that differs from those of the places around."""
    shade = colorsys.hsv_to_rgb((0.07 + _GOLDEN * place) % 1.0, (0.9, 0.6)[place % 2], (0.75, 0.9, 0.6)[place % 3])
    return "#" + "".join(f"{round(255 * value):02x}" for value in shade)
