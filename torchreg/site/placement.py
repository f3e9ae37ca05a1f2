"""Scans in one frame, from links between pairs of them: ``place``."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import at_least, expect_shape
from torchreg.geometry.se3 import apply_rotation, compose, inverse, rigid
from torchreg.native import torch_on_one_thread
from torchreg.site.choice import best_of_pairs, choose
from torchreg.site.graph import SiteGraph, residuals, site_graph
from torchreg.site.links import KnownPose, Link
from torchreg.site.loops import Triangles, agreeing_triangles
from torchreg.site.optimize import SettledPoses, settle_poses
from torchreg.site.reasons import reasons_of
from torchreg.site.site_sight import SiteSight
from torchreg.site.tolerance import Tolerance

_FAINT = -4.0  # log-odds: links below take no part before there are poses
_ROUNDS = 6
_DEFAULT = Tolerance()


@dataclass(frozen=True, eq=False)
class Placement:
    """The poses of ``N`` scans, and what became of ``L`` links.

    A group is what one frame holds. Scans that known poses tie to the world are one group, in the frame of the world;
    in every other group the scan of the lowest number has the identity.

    Attributes:
        T_world_scan: (N, 4, 4) float64, meters, from the frame of each scan's file to that of its group; NaN where not
            placed.
        group: (N,) int64, 0 for the group of most scans; -1 where not placed.
        in_world: (N,) bool, whether the group's frame is that of the known poses.
        covariance: (N, 6, 6) float64, of a small turn about ``center`` (radians) and a shift (meters) in the group's
            frame, relative to what holds it: the known poses or its first scan. NaN where not placed.
        center: (N, 3) float64, meters, in the group's frame: the middle of the overlaps of each scan.
        reason: why a scan is not placed, one per scan; empty where it is.
        used: (L,) bool, whether the link is held to be right: it agrees with the poses, best among those of its pair.
        weight: (L,) float64 in [0, 1], how much of it counted in the poses; 0 where not used.
        meters: (L,) float64, how far the poses put the link's center from where the link puts it; NaN for links
            between scans that are not of one group.
        degrees: (L,) float64, the angle between both, likewise.
        loops: (L,) int64, how many loops of three used links, this one among them, close.
        loop_meters: (L,) float64, by how much these loops miss closing, their median; NaN without loops.
        loop_degrees: (L,) float64, likewise.
        scale: the factor, 1 or more, by which the squared errors of links exceed what their covariances promise; the
            covariances of the poses hold it already.

    Example:
        >>> import torch
        >>> from torchreg.site import Link, loose_covariance, place
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> sure = {"log_odds": 4.0, "probability": 0.98, "covariance": loose_covariance(0.01, 10.0)}
        >>> place([Link(target=0, source=1, T_target_source=T, **sure)], 2).group
        tensor([0, 0])
    """

    T_world_scan: Tensor
    group: Tensor
    in_world: Tensor
    covariance: Tensor
    center: Tensor
    reason: tuple[str, ...]
    used: Tensor
    weight: Tensor
    meters: Tensor
    degrees: Tensor
    loops: Tensor
    loop_meters: Tensor
    loop_degrees: Tensor
    scale: float

    def __post_init__(self) -> None:
        expect_shape(self.T_world_scan, "T_world_scan", ("N", 4, 4), torch.float64)
        expect_shape(self.group, "group", (len(self.T_world_scan),), torch.int64)
        expect_shape(self.used, "used", ("L",), torch.bool)

    def __len__(self) -> int:
        """The number of scans, N."""
        return len(self.group)


@entry
def place(
    links: Sequence[Link],
    count: int,
    *,
    known: Iterable[KnownPose] = (),
    tolerance: Tolerance = _DEFAULT,
    sight: SiteSight | None = None,
    doubt: float = 0.0,
) -> Placement:
    """Put scans into one frame by the links that can be believed.

    Scans grow together from the surest links on (``choice``), the poses of all are settled by robust least squares
    (``optimize``), and then every candidate of every pair is held against them: those that agree are taken instead of
    others, doubted and refused ones too, until nothing changes.

    Args:
        links: candidates for pairs of scans, any number of each pair, in any order.
        count: scans, N; they are numbered from 0.
        known: poses that are known beforehand, each with its own covariance.
        tolerance: how far poses may be apart that are held to be one.
        sight: what the scanners saw, which speaks for or against joining groups.
        doubt: what was taken from the log-odds of all links, since they contradict each other.

    Returns:
        The poses, bit for bit the same for any order of the links and any number of threads.

    Raises:
        ValueError: a link or known pose of a scan that there is not.

    Example:
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> link = Link(target=0, source=1, T_target_source=T, log_odds=3.0, probability=0.9,
        ...             covariance=tr.site.loose_covariance(0.01, 5.0))
        >>> place([link], 3).group
        tensor([ 0,  0, -1])
    """
    at_least(count, "count", 0)
    with torch_on_one_thread():
        graph = site_graph(links, known, count)
        likely = (graph.evidence >= min(_FAINT, -doubt)).nonzero()[:, 0]
        some = graph.take(likely)
        start = choose(some, agreeing_triangles(some, tolerance), tolerance, sight, doubt)
        settled = _settled(graph, start.poses, likely[start.believed], tolerance)
        return _placement(graph, links, settled, tolerance)


class _Settled(NamedTuple):
    rows: Tensor  # (K,) links that are used
    group: Tensor  # (N + 1,) the lowest node of each node's group
    poses: SettledPoses


def _settled(graph: SiteGraph, poses: Tensor, rows: Tensor, tolerance: Tolerance) -> _Settled:
    """Settle the poses, and choose links by them, in turns until the choice stays."""
    seen: set[tuple[int, ...]] = set()
    for _ in range(_ROUNDS):
        group = _groups(graph, rows)
        # the world stays where it is; other groups stay where their first scan is
        fixed = group == torch.arange(len(group))
        held = _grounded(graph, poses, group)
        result = _Settled(rows, group, settle_poses(graph.take(rows), held, fixed))
        poses, scale = result.poses.poses, result.poses.scale
        seen.add(tuple(rows.tolist()))
        inside = (group[graph.first] == group[graph.second]).nonzero()[:, 0]
        chosen = best_of_pairs(graph, inside, _excess(graph.take(inside), poses, tolerance, scale))
        if tuple(chosen.tolist()) in seen:
            break
        rows = chosen
    return result


def _groups(graph: SiteGraph, rows: Tensor) -> Tensor:
    """The node that stands for each node's group (N + 1,): the world where it is one of them, else the lowest."""
    near: list[list[int]] = [[] for _ in range(graph.count + 1)]
    for a, b in zip(graph.first[rows].tolist(), graph.second[rows].tolist(), strict=True):
        near[a].append(b)
        near[b].append(a)
    name = [-1] * (graph.count + 1)
    for begin in [graph.count, *range(graph.count)]:
        waiting = deque([begin] if name[begin] < 0 else [])
        while waiting:
            node = waiting.popleft()
            if name[node] < 0:
                name[node] = begin
                waiting.extend(near[node])
    return torch.tensor(name)


def _grounded(graph: SiteGraph, poses: Tensor, group: Tensor) -> Tensor:
    """The poses with that node of every group at the identity that stands for it, in the frames of the files."""
    ground = rigid(torch.eye(3, dtype=torch.float64).expand(len(poses), 3, 3), graph.zero)
    ground[-1] = torch.eye(4, dtype=torch.float64)  # the world keeps its moved frame
    return compose(ground[group], compose(inverse(poses[group]), poses))


def _excess(graph: SiteGraph, poses: Tensor, tolerance: Tolerance, scale: float) -> Tensor:
    turn, shift = residuals(graph, poses).split(3, dim=1)
    lengths = torch.linalg.vector_norm(turn, dim=1), torch.linalg.vector_norm(shift, dim=1)
    return tolerance.excess(*lengths, *tolerance.variances(graph, scale))


def _placement(graph: SiteGraph, links: Sequence[Link], settled: _Settled, tolerance: Tolerance) -> Placement:
    count, group, rows = graph.count, settled.group, settled.rows
    sizes = torch.bincount(group[:count], minlength=count + 1)
    placed = (sizes[group[:count]] > 1) | (group[:count] == count)
    order = sorted(group[:count][placed].unique().tolist(), key=lambda node: (-int(sizes[node]), node))
    names = {node: place for place, node in enumerate(order)}
    number = torch.tensor([names.get(node, -1) for node in group[:count].tolist()], dtype=torch.int64)
    world = graph.zero[group[:count]].clone()
    world[group[:count] != count] = 0.0
    poses = settled.poses.poses[:count]
    R = poses[:, :3, :3]
    center = poses[:, :3, 3] + world
    T = rigid(R, center - apply_rotation(R, graph.zero[:count]))
    turned = torch.zeros(count, 6, 6, dtype=torch.float64)
    turned[:, :3, :3] = turned[:, 3:, 3:] = R
    covariance = turned @ settled.poses.covariance[:count] @ turned.transpose(1, 2)
    first = group[:count] == torch.arange(count)
    T[first & placed] = torch.eye(4, dtype=torch.float64)

    e = residuals(graph, settled.poses.poses)
    one = (group[graph.first] == group[graph.second]) & (sizes[group[graph.first]] > 0)
    meters = torch.where(one, torch.linalg.vector_norm(e[:, 3:], dim=1), torch.nan)
    degrees = torch.where(one, torch.rad2deg(torch.linalg.vector_norm(e[:, :3], dim=1)), torch.nan)
    used, weight = torch.zeros(len(graph), dtype=torch.bool), torch.zeros(len(graph), dtype=torch.float64)
    used[rows], weight[rows] = True, settled.poses.weight
    loops = _loops(agreeing_triangles(graph.take(rows), tolerance), len(rows))
    around = torch.full((3, len(graph)), torch.nan, dtype=torch.float64)
    around[:, rows] = loops
    back = graph.number.argsort()[: len(links)]  # from the order of the graph to that of the links
    nothing = torch.where(placed, 0.0, torch.nan)[:, None]
    return Placement(
        T_world_scan=T + nothing[:, None],
        group=number,
        in_world=(group[:count] == count) & placed,
        covariance=covariance + nothing[:, None],
        center=center + nothing,
        reason=reasons_of(graph, links, placed),
        used=used[back],
        weight=weight[back],
        meters=meters[back],
        degrees=degrees[back],
        loops=around[0].nan_to_num().long()[back],
        loop_meters=around[1][back],
        loop_degrees=around[2][back],
        scale=settled.poses.scale,
    )


def _loops(triangles: Triangles, count: int) -> Tensor:
    """Of each link (3, count): its loops, and the medians of their errors, meters and degrees; NaN without loops."""
    link = triangles.links.flatten()
    result = torch.full((3, count), torch.nan, dtype=torch.float64)
    shift, turn = (each[:, None].expand(-1, 3).flatten() for each in (triangles.shift, triangles.turn))
    order = link.argsort(stable=True)
    sizes = torch.bincount(link, minlength=count).tolist()
    pieces = zip(shift[order].split(sizes), turn[order].split(sizes), strict=True)
    for row, (shifts, turns) in enumerate(pieces):
        if len(shifts):
            result[:, row] = torch.stack(
                [shifts.new_tensor(len(shifts)), shifts.median(), torch.rad2deg(turns.median())]
            )
    return result
