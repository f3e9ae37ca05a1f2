"""The frame of a site: of known poses, of control points, or level.

``known_poses`` come before scans are placed, since they tie scans to the world as links do; ``frame_of`` comes behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_in_words, positive
from torchreg.geometry.kabsch import kabsch
from torchreg.geometry.se3 import apply, apply_rotation, compose, inverse
from torchreg.site.control import (
    ControlPoint,
    JudgedPoint,
    control_frame,
    deviations_allowed,
    expect_scans,
    misses,
    poses_of_points,
)
from torchreg.site.level import level
from torchreg.site.links import KnownPose
from torchreg.site.placement import Placement
from torchreg.site.ups import plumb, up_of_scans
from torchreg.types import Clouds

_FAR = 4.0  # deviations, beyond which a known pose is wrong
_FIXED_METERS, _FIXED_RADIANS = 1e-5, 1e-6  # deviations of a scan that is fixed


@dataclass(frozen=True, eq=False, kw_only=True)
class SiteFrame:
    """What is known of the frame of a site.

    Attributes:
        fix: the number of a scan that stays where it is: its known pose, and without one the identity, so that the
            frame of the world is that of its file.
        poses: numbers of scans and their poses (4, 4) float64, T_world_scan, as far as they are known. A file's pose
            that was applied when it was read is the identity.
        pose_meters: the deviation of these poses, of each coordinate of the scan's middle.
        pose_degrees: likewise, of turns about each axis.
        control: points that are known in the world; beside ``fix`` or ``poses`` there must be none.
        level: whether frames that nothing else fixes are turned so that z is up.

    Raises:
        ValueError: control points beside known poses, or a deviation that is not above 0.

    Example:
        >>> SiteFrame(fix=0, level=True).level
        True
    """

    fix: int | None = None
    poses: tuple[tuple[int, Tensor], ...] = ()
    pose_meters: float = 0.05
    pose_degrees: float = 0.5
    control: tuple[ControlPoint, ...] = ()
    level: bool = False

    def __post_init__(self) -> None:
        positive(self.pose_meters, "pose_meters")
        positive(self.pose_degrees, "pose_degrees")
        one = not self.control or (self.fix is None and not self.poses)
        expect_in_words(
            one, "control", "no control points beside fixed scans or known poses", f"{len(self.control)} points"
        )


class Framed(NamedTuple):
    """Scans in the frame that is wanted.

    Attributes:
        placement: the poses.
        known: what ties scans to the world, for ``refine_together``.
        points: the control points, in order, beside where the poses put them.
        remarks: on groups that have no frame of the world although one was wanted, in words.
    """

    placement: Placement
    known: tuple[KnownPose, ...]
    points: tuple[JudgedPoint, ...]
    remarks: tuple[str, ...]


def known_poses(frame: SiteFrame, scans: Sequence[Clouds]) -> list[KnownPose]:
    """The known poses of a frame, for ``place``.

    Raises:
        ValueError: a scan that there is not, or two poses of one.
    """
    poses: dict[int, Tensor] = {}
    for scan, T in frame.poses:
        expect(0 <= scan < len(scans), "poses", f"scans from 0 to {len(scans) - 1}", scan)
        expect_in_words(scan not in poses, "poses", "one pose of a scan", f"two of scan {scan}")
        poses[scan] = T
    sigmas = dict.fromkeys(poses, (frame.pose_meters, torch.pi / 180 * frame.pose_degrees))
    if frame.fix is not None:
        expect(0 <= frame.fix < len(scans), "fix", f"a scan from 0 to {len(scans) - 1}", frame.fix)
        poses.setdefault(frame.fix, torch.eye(4, dtype=torch.float64))
        sigmas[frame.fix] = _FIXED_METERS, _FIXED_RADIANS
    known = []
    for scan, T in sorted(poses.items()):
        meters, radians = sigmas[scan]
        covariance = torch.tensor([radians**2] * 3 + [meters**2] * 3, dtype=torch.float64).diag()
        known.append(KnownPose(scan=scan, T_world_scan=T, covariance=covariance, center=_middle(scans[scan], T)))
    return known


def frame_of(placement: Placement, frame: SiteFrame, scans: Sequence[Clouds]) -> Framed:
    """Give the groups of a placement the frame that is wanted, as far as it can be had.

    Known poses move groups that were placed without them; control points move every group that has three of them not
    on a line; all these are one group then, in the world. Other groups are leveled where that is wanted. Groups move
    as a whole: ``refine_together``, given ``known``, bends them to what is known, and says how well poses are known
    in the world.

    Args:
        placement: N scans, placed by ``place`` with or without ``known_poses``.
        frame: what is known.
        scans: the N clouds, each a batch of one.

    Raises:
        ValueError: another number of scans, or points or poses of scans that there are not.
    """
    expect(len(scans) == len(placement), "scans", f"the {len(placement)} scans that are placed", len(scans))
    expect_scans(frame.control, len(scans))
    known = known_poses(frame, scans)
    motions, wrong = _by_poses(placement, known, frame.fix)
    placement, agreeing = _moved(placement, motions), set[int]()
    remarks = [
        f"the known pose of scan {scan} is {meters:.3g} m off where the others put it: it was left out"
        for scan, meters in wrong.items()
    ]
    if frame.control:
        motions, agreeing, remarks = _by_points(placement, frame.control)
        placement = _moved(placement, motions)
        known = poses_of_points([frame.control[place] for place in sorted(agreeing)], placement.T_world_scan)
    known = [pose for pose in known if bool(placement.in_world[pose.scan]) and pose.scan not in wrong]
    if frame.level:
        placement = level(placement, plumb(up_of_scans(scans), placement.T_world_scan, placement.group))
    return Framed(placement, tuple(known), judged(frame.control, placement, agreeing), tuple(remarks))


def judged(control: Sequence[ControlPoint], placement: Placement, agreeing: set[int]) -> tuple[JudgedPoint, ...]:
    """Control points beside where a placement puts them; those not ``agreeing``, by place, are suspicious."""
    world = placement.in_world.tolist()
    apart = misses(control, placement.T_world_scan)
    return tuple(
        JudgedPoint(point, meters if world[point.scan] else torch.nan, world[point.scan] and place not in agreeing)
        for place, (point, meters) in enumerate(zip(control, apart, strict=True))
    )


def _by_poses(
    placement: Placement, known: Sequence[KnownPose], fix: int | None
) -> tuple[dict[int, Tensor], dict[int, float]]:
    """T_world_group (4, 4) of groups that are not in the world and have known poses; scans of wrong ones, meters off.

    In the group of a scan that is fixed, that one decides.
    """
    motions, wrong = dict[int, Tensor](), dict[int, float]()
    for group in range(int(placement.group.max()) + 1 if len(placement) else 0):
        members = (placement.group == group) & ~placement.in_world
        own = [pose for pose in known if bool(members[pose.scan])]
        own = [pose for pose in own if pose.scan == fix] or own
        if own:
            motions[group], others = _agreed(placement, own)
            wrong.update(others)
    return motions, wrong


def _agreed(placement: Placement, known: Sequence[KnownPose]) -> tuple[Tensor, dict[int, float]]:
    """The motion (4, 4) that most known poses of a group agree on; the scans of the others and how far off they are."""
    here, world, weight, allowed = [], [], [], []
    for pose in known:
        variance = pose.covariance.diagonal()
        turn, shift = float(variance[:3].mean()), float(variance[3:].mean())
        center = pose.T_world_scan[:3, 3] if pose.center is None else pose.center
        ends = (shift / turn) ** 0.5 * torch.cat([torch.eye(3), -torch.eye(3)]).double()
        there = center + ends  # six places that are known as well as the pose is
        back = compose(placement.T_world_scan[pose.scan], inverse(pose.T_world_scan))
        here.append(apply(back, there))
        world.append(there)
        weight.append(torch.full((6,), 1 / shift, dtype=torch.float64))
        own = float(placement.covariance[pose.scan].diagonal()[3:].mean())
        allowed.append(_FAR * (2 * shift + own) ** 0.5)
    middle = torch.cat(world).median(dim=0).values
    sides = torch.stack(here), torch.stack(world) - middle  # (K, 6, 3)
    limit, weights = torch.tensor(allowed, dtype=torch.float64), torch.stack(weight)

    def off(T: Tensor) -> Tensor:
        return torch.stack([(apply(T, one) - other).mean(dim=0).norm() for one, other in zip(*sides, strict=True)])

    every = [off(kabsch(one, other)) <= limit for one, other in zip(*sides, strict=True)]
    best = max(every, key=lambda near: int(near.sum()))
    T = kabsch(sides[0][best].reshape(-1, 3), sides[1][best].reshape(-1, 3), weights[best].reshape(-1))
    wrong = {known[k].scan: meters for k, meters in enumerate(off(T).tolist()) if not bool(best[k])}
    T[:3, 3] += middle
    return T, wrong


def _by_points(placement: Placement, control: Sequence[ControlPoint]) -> tuple[dict[int, Tensor], set[int], list[str]]:
    """T_world_group of groups by their control points, the points that these stand on, and remarks on the others."""
    motions, agreeing, remarks = dict[int, Tensor](), set[int](), list[str]()
    for group in range(int(placement.group.max()) + 1 if len(placement) else 0):
        rows = [row for row, point in enumerate(control) if int(placement.group[point.scan]) == group]
        points = [control[row] for row in rows]
        if not points:
            continue
        places = torch.stack(
            [apply(placement.T_world_scan[p.scan], torch.tensor([p.place], dtype=torch.float64))[0] for p in points]
        )
        arm = torch.linalg.vector_norm(places - placement.center[[point.scan for point in points]], dim=1)
        allowed = deviations_allowed(points, placement.covariance, arm)
        result = control_frame(points, placement.T_world_scan, allowed)
        if result.T_world_group is None:
            remarks.append(f"group {group} has a frame of its own: {result.reason}")
            continue
        motions[group] = result.T_world_group
        agreeing |= {rows[place] for place in result.agreeing}
    lost = sorted({point.scan for point in control if int(placement.group[point.scan]) < 0})
    remarks += [f"control points in scan {scan} say nothing: it is not placed" for scan in lost]
    return motions, agreeing, remarks


def _moved(placement: Placement, motions: dict[int, Tensor]) -> Placement:
    """The placement with groups moved into the world, where they are one group."""
    if not motions:
        return placement
    motion = torch.eye(4, dtype=torch.float64).repeat(len(placement), 1, 1)
    in_world = placement.in_world.clone()
    for group, T in motions.items():
        motion[placement.group == group], in_world[placement.group == group] = T, True
    R = motion[:, :3, :3]
    both = torch.zeros(len(placement), 6, 6, dtype=torch.float64)
    both[:, :3, :3] = both[:, 3:, 3:] = R
    T = compose(motion, placement.T_world_scan)
    T[:, 3] = placement.T_world_scan[:, 3]  # not a number where not placed
    return replace(
        placement,
        T_world_scan=torch.where((placement.group >= 0)[:, None, None], T, torch.nan),
        center=apply_rotation(R, placement.center) + motion[:, :3, 3],
        covariance=both @ placement.covariance @ both.transpose(1, 2),
        in_world=in_world,
        group=_renumbered(placement.group, in_world),
    )


def _renumbered(group: Tensor, in_world: Tensor) -> Tensor:
    """Groups by their sizes, those in the world as one."""
    names = torch.where(in_world, -2, group).tolist()
    members: dict[int, list[int]] = {}
    for scan, name in enumerate(names):
        if name != -1:
            members.setdefault(name, []).append(scan)
    result = torch.full_like(group, -1)
    for number, scans in enumerate(sorted(members.values(), key=lambda scans: (-len(scans), scans[0]))):
        result[scans] = number
    return result


def _middle(cloud: Clouds, T: Tensor) -> Tensor:
    """The mean (3,) of the points of one cloud under a pose (4, 4)."""
    if len(cloud.points) == 0:
        return T[:3, 3]
    mean = cloud.points.double().mean(dim=0).cpu() + cloud.origin[0].cpu()
    return apply_rotation(T[:3, :3], mean) + T[:3, 3]
