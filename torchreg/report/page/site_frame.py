"""The frame in which a page shows a group of scans: small numbers, and its third axis up as far as that is known."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.geometry.up import up_of, upright_frame
from torchreg.report.scene import thin
from torchreg.site.result import SiteResult
from torchreg.types import Clouds

_POINTS = 4000  # of the first scan, from which up is found
_FOOTPRINT = 1000  # points of each scan, from which the directions of walls are found
_SPAN = (0.03, 0.97)  # of the points: some lie far outside
_HELPS = 0.8  # of the area that the plan fills, below which it is turned
_MAP = 1e4  # meters from zero from which coordinates are those of a map, whose north stays up
_GOLDEN = 0.618034  # of the circle of hues between neighbors, so that no two are close


class GroupFrame(NamedTuple):
    """Where the page has the scans of one group."""

    members: tuple[int, ...]
    """The numbers of its scans."""

    axes: NDArray[Any]
    """(3, 3), a rotation: the rows are the axes of the page in the group's frame."""

    poses: NDArray[Any]
    """(M, 4, 4) from the points of each scan, its origin left out, to the page's frame, meters."""

    scanners: NDArray[Any]
    """(M, 3) where the scanners stood in the page's frame; the middle of the points where that is not known."""

    upright: bool
    """Whether the third axis is up."""


def group_frame(site: SiteResult, scans: Sequence[Clouds], group: int) -> GroupFrame:
    """The frame of one group, its zero at the zero of the first scan's points."""
    members = (site.group == group).nonzero()[:, 0].tolist()
    poses = np.stack([site.T_world_scan[scan].numpy() for scan in members])
    origins = np.stack([scans[scan].origin[0].cpu().numpy() for scan in members])
    poses[:, :3, 3] += np.einsum("mij,mj->mi", poses[:, :3, :3], origins)
    poses[:, :3, 3] -= poses[0, :3, 3].copy()
    axes, upright = _axes(scans[members[0]], poses[0])
    turn = np.eye(4)
    turn[:3, :3] = axes
    poses = turn @ poses
    places = np.stack([_scanner(scans[scan]) for scan in members])
    if upright and np.abs(origins[0, :2]).max() < _MAP:
        level = _along_walls(np.concatenate([_some(scans[k], T) for k, T in zip(members, poses, strict=True)]))
        axes, turn[:3, :3] = level @ axes, level
        poses = turn @ poses
    scanners = np.einsum("mij,mj->mi", poses[:, :3, :3], places) + poses[:, :3, 3]
    return GroupFrame(tuple(members), axes, poses, scanners, upright)


def scan_color(place: int) -> str:
    """A color such as ``#d55e00`` that differs from those of the places around."""
    shade = colorsys.hsv_to_rgb((0.07 + _GOLDEN * place) % 1.0, (0.9, 0.6)[place % 2], (0.75, 0.9, 0.6)[place % 3])
    return "#" + "".join(f"{round(255 * value):02x}" for value in shade)


def _axes(cloud: Clouds, pose: NDArray[Any]) -> tuple[NDArray[Any], bool]:
    every = cloud.points.detach().cpu().double().numpy()
    points = every[thin(every, _POINTS)]
    place = _viewpoint(cloud)
    up = up_of(points, place, cloud.origin[0].cpu().numpy(), known=bool(cloud.viewpoint_known[0]))
    frame: NDArray[Any] = upright_frame(up, points, place) @ pose[:3, :3].T
    return frame, up.direction is not None


def _some(cloud: Clouds, pose: NDArray[Any]) -> NDArray[Any]:
    """Some points (N, 3) of a scan under its pose."""
    every = cloud.points.detach().cpu().double()[:: max(1, len(cloud.points) // _FOOTPRINT)].numpy()
    moved: NDArray[Any] = every[np.isfinite(every).all(axis=1)] @ pose[:3, :3].T + pose[:3, 3]
    return moved


def _along_walls(points: NDArray[Any]) -> NDArray[Any]:
    """The turn (3, 3) about the third axis after which the plan of points (N, 3) fills its rectangle best, wide first.

    The identity where no turn helps much.
    """
    angles = np.radians(np.arange(0, 90, 1.5))
    areas = []
    for angle in angles:
        across = points[:, :2] @ _turn(angle)[:2, :2].T
        areas.append(np.quantile(across, _SPAN[1], axis=0) - np.quantile(across, _SPAN[0], axis=0))
    extents = np.array(areas)  # (A, 2)
    area = extents.prod(axis=1)
    best = int(np.argmin(area))
    if area[best] > _HELPS * area[0]:
        return np.eye(3)
    return _turn(angles[best] - (np.pi / 2 if extents[best, 1] > extents[best, 0] else 0.0))


def _turn(angle: float) -> NDArray[Any]:
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turn


def _viewpoint(cloud: Clouds) -> NDArray[Any] | None:
    place = None if cloud.viewpoint is None else cloud.viewpoint[0].detach().cpu().double().numpy()
    return None if place is None or not np.isfinite(place).all() else place


def _scanner(cloud: Clouds) -> NDArray[Any]:
    place = _viewpoint(cloud)
    if place is not None:
        return place
    middle: NDArray[Any] = cloud.points.detach().cpu().double().mean(dim=0).numpy()
    return middle if len(cloud.points) else np.zeros(3)
