"""Control points: places that a scan shows and whose coordinates in the world are known from a survey.

Three of them that are not on a line give the frame of a group. One that is wrong must not spoil it: of all frames that
three points give, that one is taken with which the most agree (Fischler and Bolles, RANSAC, CACM 1981,
doi:10.1145/358669.358692), and then the frame that fits these best.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import combinations, islice
from math import comb
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import at_least, expect
from torchreg.geometry.kabsch import kabsch
from torchreg.geometry.se3 import apply, apply_rotation, compose, rigid
from torchreg.geometry.small_motions import cross_matrix, rotation_of
from torchreg.io.scan_table import ScanRow, read_scan_table, scan_number
from torchreg.site.links import KnownPose
from torchreg.types.loading import loadable

SIGMA = 0.01
"""Meters: the deviation of a control point, as far as it can be seen in a scan."""

_Place = tuple[float, float, float]

_FAR = 4.0  # deviations beyond which a point is suspicious
_LEAST = 3
_TRIPLES = 2000  # that are tried
_STRAIGHT = 0.02  # of the length of points: nearer to a line, they do not say how they turn about it
_REFITS = 10
_FREE_TURN, _FREE_SHIFT = 0.3, 10.0  # radians and meters: deviations of motions that points leave open


@loadable
class ControlPoint(NamedTuple):
    """One place in a scan and in the world.

    Attributes:
        name: such as a target is called by the surveyor.
        scan: the number of the scan.
        place: x, y, z in meters, in the frame of the scan's file.
        world: X, Y, Z in meters, in the frame of the world.

    Example:
        >>> ControlPoint("T1", 0, (1.0, 2.0, 0.5), (431001.0, 5310002.0, 512.5)).scan
        0
    """

    name: str
    scan: int
    place: tuple[float, float, float]
    world: tuple[float, float, float]


@loadable
class JudgedPoint(NamedTuple):
    """A control point beside where the poses put it.

    Attributes:
        point: as it was given.
        meters: between both; NaN where its scan is not in the frame of the world.
        suspicious: whether it is so far off that it was left out.
    """

    point: ControlPoint
    meters: float
    suspicious: bool


class ControlFrame(NamedTuple):
    """The frame that control points give a group of scans, or why they give none."""

    T_world_group: Tensor | None  # (4, 4) float64
    agreeing: tuple[int, ...]  # places of the points it stands on, among those given
    reason: str  # why there is none; empty where there is one


def read_control_points(path: str | os.PathLike[str], names: Sequence[str]) -> list[ControlPoint]:
    """Read control points from a table with the header ``name, scan, x, y, z, X, Y, Z``.

    Args:
        path: CSV; lower-case coordinates are those in the frame of the scan's file, upper-case those in the world.
        names: of the scans. A row means one of them by its name, that of its file or its number, from 0.

    Raises:
        CloudFileError: a table that cannot be read, a cell that is no number or a scan that is not among these; the
            message names file and line.
    """
    return [
        ControlPoint(row.cells["name"], scan_number(row.cells["scan"], names, row.where), place, world)
        for row, place, world in _control_rows(path)
    ]


def check_control_points(path: str | os.PathLike[str]) -> None:
    """Check a table of control points as far as that is possible before the scans are known.

    Raises:
        CloudFileError: as for ``read_control_points``, but for the names of scans.
    """
    _control_rows(path)


def expect_scans(points: Sequence[ControlPoint], count: int) -> None:
    """Check that all points lie in scans of ``count``.

    Raises:
        ValueError: one does not.
    """
    for place, point in enumerate(points):
        at_least(point.scan, f"control[{place}].scan", 0)
        expect(point.scan < count, f"control[{place}].scan", f"a scan below {count}", point.scan)


def control_frame(points: Sequence[ControlPoint], T_group_scan: Tensor, allowed: Sequence[float]) -> ControlFrame:
    """The frame of the world by control points of one group.

    Args:
        points: K points, all in scans of the group.
        T_group_scan: (N, 4, 4) float64, the poses of all scans.
        allowed: K numbers, meters: how far off a point may be that is right.
    """
    if len(points) < _LEAST:
        return ControlFrame(None, (), f"{len(points)} control points, of {_LEAST} that a frame needs")
    there, world = _places(points, T_group_scan)
    limit = torch.tensor(allowed, dtype=torch.float64)
    middle = world.median(dim=0).values  # coordinates of a map would cost digits
    triples = [rows for rows in _triples(len(there)) if _wide(there[rows]) and _wide(world[rows] - middle)]
    if not triples:
        return ControlFrame(None, (), "its control points lie on a line")
    chosen = _consensus(there, world - middle, limit, triples)
    if chosen is None:
        return ControlFrame(None, (), "its control points contradict each other")
    T = kabsch(there[chosen], world[chosen] - middle)
    T[:3, 3] += middle
    return ControlFrame(T, tuple(chosen.nonzero()[:, 0].tolist()), "")


def deviations_allowed(points: Sequence[ControlPoint], covariance: Tensor, arm: Tensor) -> list[float]:
    """How far off each point may be, meters: by its own deviation and by that of its scan's pose.

    Args:
        points: K points.
        covariance: (N, 6, 6) of the poses of all scans, as in ``Placement``.
        arm: (K,) meters between each point and the center of its scan's covariance.
    """
    allowed = []
    for point, far in zip(points, arm.tolist(), strict=True):
        variances = covariance[point.scan].diagonal()
        pose = float(variances[3:].mean()) + far**2 * float(variances[:3].mean())
        allowed.append(_FAR * (SIGMA**2 + pose) ** 0.5)
    return allowed


def misses(points: Sequence[ControlPoint], T_world_scan: Tensor) -> list[float]:
    """Meters between the places of points under poses (N, 4, 4) and those in the world."""
    if not points:
        return []
    there, world = _places(points, T_world_scan)
    return [float(apart) for apart in torch.linalg.vector_norm(there - world, dim=1)]


def poses_of_points(points: Sequence[ControlPoint], T_world_scan: Tensor) -> list[KnownPose]:
    """What control points say of the pose of each scan that has some, near poses (N, 4, 4) in the world.

    A scan of fewer than three points is known in some motions alone: the covariance is wide in the others. Given to
    ``refine_together``, they bend the frame of the scans to the points.
    """
    known = []
    for scan in sorted({point.scan for point in points}):
        some = [point for point in points if point.scan == scan]
        there, world = _places(some, T_world_scan)
        center = there.mean(dim=0)
        J = torch.cat(
            [-cross_matrix(there - center), torch.eye(3).double().expand(len(some), 3, 3)], dim=2
        )  # (K, 3, 6)
        free = torch.tensor([_FREE_TURN**-2] * 3 + [_FREE_SHIFT**-2] * 3, dtype=torch.float64)
        information = (J.transpose(1, 2) @ J).sum(dim=0) / SIGMA**2 + free.diag()
        pull = (J.transpose(1, 2) @ (world - there)[:, :, None]).sum(dim=0)[:, 0] / SIGMA**2
        covariance = torch.cholesky_inverse(torch.linalg.cholesky(information))
        turn, shift = (covariance @ pull).split(3)
        R = rotation_of(turn)
        T = compose(rigid(R, center + shift - apply_rotation(R, center)), T_world_scan[scan])
        even = (covariance + covariance.t()) / 2
        known.append(KnownPose(scan=scan, T_world_scan=T, covariance=even, center=center + shift))
    return known


def _control_rows(path: str | os.PathLike[str]) -> list[tuple[ScanRow, _Place, _Place]]:
    """The rows of a table of control points, and their places in the scan and in the world."""
    rows = []
    for row in read_scan_table(path, ("name", "scan", "x", "y", "z", "X", "Y", "Z")):
        x, y, z, X, Y, Z = row.numbers(("x", "y", "z", "X", "Y", "Z"))
        rows.append((row, (x, y, z), (X, Y, Z)))
    return rows


def _places(points: Sequence[ControlPoint], T: Tensor) -> tuple[Tensor, Tensor]:
    """Places (K, 3) of points under poses (N, 4, 4), and in the world."""
    here = torch.tensor([point.place for point in points], dtype=torch.float64)
    there = torch.stack([apply(T[point.scan], place[None])[0] for point, place in zip(points, here, strict=True)])
    return there, torch.tensor([point.world for point in points], dtype=torch.float64)


def _wide(places: Tensor) -> bool:
    """Whether places (K, 3) are not on a line."""
    lengths = torch.linalg.svdvals(places - places.mean(dim=0))
    return bool(lengths[1] > _STRAIGHT * lengths[0])


def _consensus(there: Tensor, world: Tensor, limit: Tensor, triples: Sequence[list[int]]) -> Tensor | None:
    """The most points (K,) bool that one frame brings within their limits; ``None`` where half of them do not agree."""
    best, least = None, (0, 0.0)
    for rows in triples:
        chosen = torch.zeros(len(there), dtype=torch.bool)
        chosen[rows] = True
        for _ in range(_REFITS):
            off = torch.linalg.vector_norm(apply(kabsch(there[chosen], world[chosen]), there) - world, dim=1)
            near = off <= limit
            if torch.equal(near, chosen) or int(near.sum()) < _LEAST or not _wide(there[near]):
                break
            chosen = near
        score = (int(near.sum()), -float((off[near] / limit[near]).square().sum()))
        if score > least and score[0] >= _LEAST and _wide(there[near]):
            best, least = near, score
    return best if best is not None and 2 * least[0] > len(there) else None


def _triples(count: int) -> list[list[int]]:
    """Triples of points: all of them, or about as many as are tried, spread over all."""
    step = max(1, comb(count, 3) // _TRIPLES)
    return [list(rows) for rows in islice(combinations(range(count), 3), 0, None, step)]
