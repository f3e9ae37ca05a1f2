"""The placed scans of a site in 3D, a view for each of its groups."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.report.page.markup import paragraph
from torchreg.report.page.site_frame import GroupFrame, scan_color
from torchreg.report.page.viewer import ViewedCloud, viewer_html
from torchreg.report.scene import thin
from torchreg.site.result import SiteResult
from torchreg.types import Clouds


def site_space(
    site: SiteResult, frames: Sequence[GroupFrame], scans: Sequence[Clouds], names: Sequence[str], max_points: int
) -> str:
    """A view of every group that has a frame as markup; nothing where no scan is placed."""
    groups = int(site.group.max()) + 1
    share = max(1, max_points // max(1, int(site.placed.sum())))
    parts = []
    for group, frame in enumerate(frames):
        title = f"Group {group}: {len(frame.members)} scans" if groups > 1 else f"{len(frame.members)} scans"
        parts.append(paragraph(f"{title}, at most {share:,} points of each."))
        parts.append(_view(frame, scans, names, share, title))
    if groups > len(frames):
        parts.append(paragraph(f"{groups - len(frames)} smaller groups are not shown."))
    return "\n".join(parts)


def _view(frame: GroupFrame, scans: Sequence[Clouds], names: Sequence[str], count: int, title: str) -> str:
    clouds = [
        _viewed(scans[scan], pose, f"{scan}: {names[scan]}", scan_color(scan), count)
        for scan, pose in zip(frame.members, frame.poses, strict=True)
    ]
    return viewer_html(clouds, label=f"3D view of {title}", noun="scan")


def _viewed(cloud: Clouds, pose: NDArray[Any], name: str, color: str, count: int) -> ViewedCloud:
    every = cloud.points.detach().cpu().double().numpy()
    rows = thin(every, count)
    colors = None if cloud.colors is None else np.clip(cloud.colors.detach().cpu().double().numpy()[rows], 0, 1)
    return ViewedCloud(name=name, points=every[rows], poses=[pose], color=color, colors=colors)
