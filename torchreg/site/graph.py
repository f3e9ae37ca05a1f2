"""The links of a site as tensors, in an order of their own and in frames where numbers are small.

Scans are nodes 0 to N - 1, and the world is node N: a known pose is a link from its scan to the world. Every scan's
frame is moved to the middle of its overlaps, that of the world to the middle of the known poses: so coordinates of a
map lose no digits, and turns and shifts do not depend on each other more than they must.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.se3 import apply_rotation, compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_vector
from torchreg.site.links import KnownPose, Link

SURE = 40.0
"""Log-odds of what is known; those of links are bounded by it."""


@dataclass(frozen=True, eq=False)
class SiteGraph:
    """``L`` links between nodes, sorted by nodes and rank, ``first`` < ``second``.

    Attributes:
        count: scans, N; node N is the world.
        number: (L,) int64, the place of each link among those given, known poses behind links.
        first: (L,) int64, node whose frame the transform leads to.
        second: (L,) int64, the other node.
        T: (L, 4, 4) float64, T_first_second between the moved frames.
        covariance: (L, 6, 6), of a small turn about ``center`` and a shift, in the moved frame of ``first``.
        center: (L, 3), there.
        evidence: (L,) log-odds of being right among all candidates of the pair.
        zero: (N + 1, 3), the zero of each node's moved frame in the frame of its file.
    """

    count: int
    number: Tensor
    first: Tensor
    second: Tensor
    T: Tensor
    covariance: Tensor
    center: Tensor
    evidence: Tensor
    zero: Tensor

    def __len__(self) -> int:
        """The number of links."""
        return len(self.number)

    def take(self, rows: Tensor) -> SiteGraph:
        """The links ``rows`` (K,) alone, in that order; int64 or a mask."""
        parts = ("number", "first", "second", "T", "covariance", "center", "evidence")
        return replace(self, **{name: getattr(self, name)[rows] for name in parts})

    @property
    def known(self) -> Tensor:
        """(L,) bool, which are known poses."""
        return self.second == self.count


class _Row(NamedTuple):
    """A link or a known pose as it was given."""

    number: int
    target: int
    source: int
    T: Tensor  # (4, 4) T_target_source
    covariance: Tensor  # (6, 6)
    center: Tensor  # (3,)
    evidence: float
    rank: int


def site_graph(links: Sequence[Link], known: Iterable[KnownPose], count: int) -> SiteGraph:
    """The graph of ``count`` scans.

    Raises:
        ValueError: a link or a known pose of a scan that there is not.
    """
    rows: list[_Row] = []
    for place, link in enumerate(links):
        for name, scan in (("target", link.target), ("source", link.source)):
            expect(scan < count, f"links[{place}].{name}", f"a scan below {count}", scan)
        T, covariance, center = (each.cpu() for each in (link.T_target_source, link.covariance, link.center))
        rows.append(_Row(place, link.target, link.source, T, covariance, center, _evidence(link), link.rank))
    for place, pose in enumerate(known):
        expect(pose.scan < count, f"known[{place}].scan", f"a scan below {count}", pose.scan)
        T, covariance = pose.T_world_scan.cpu(), pose.covariance.cpu()
        center = T[:3, 3] if pose.center is None else pose.center.cpu()
        rows.append(_Row(len(links) + place, count, pose.scan, T, covariance, center, SURE, 0))
    if not rows:
        none = torch.zeros(0, dtype=torch.int64)
        wide = torch.zeros(0, dtype=torch.float64)
        parts = (wide.view(0, 4, 4), wide.view(0, 6, 6), wide.view(0, 3), wide)
        return SiteGraph(count, none, none, none, *parts, torch.zeros(count + 1, 3, dtype=torch.float64))
    number = torch.tensor([row.number for row in rows])
    target, source = torch.tensor([row.target for row in rows]), torch.tensor([row.source for row in rows])
    T, covariance = torch.stack([row.T for row in rows]), torch.stack([row.covariance for row in rows])
    center = torch.stack([row.center for row in rows])
    evidence, rank = torch.tensor([row.evidence for row in rows], dtype=torch.float64), [row.rank for row in rows]
    forward = target < source
    back = inverse(T)
    R = back[:, :3, :3]
    other = apply_rotation(R, center) + back[:, :3, 3]  # the center in the frame of the source
    turned = _both(R) @ covariance @ _both(R).transpose(1, 2)
    first, second = torch.minimum(target, source), torch.maximum(target, source)
    T = torch.where(forward[:, None, None], T, back)
    covariance = torch.where(forward[:, None, None], covariance, turned)
    here, there = torch.where(forward[:, None], center, other), torch.where(forward[:, None], other, center)
    keys = zip(
        first.tolist(), second.tolist(), rank, (-evidence).tolist(), T.flatten(1).tolist(), number.tolist(), strict=True
    )
    order = torch.tensor([place for place, _ in sorted(enumerate(keys), key=lambda item: item[1])])
    number, first, second, T, covariance, here, there, evidence = (
        part[order] for part in (number, first, second, T, covariance, here, there, evidence)
    )
    zero = _middles(torch.cat([first, second]), torch.cat([here, there]), count + 1)
    shift = zero[second]
    moved = apply_rotation(T[:, :3, :3], shift) + T[:, :3, 3] - zero[first]
    T = rigid(T[:, :3, :3], moved)
    return SiteGraph(count, number, first, second, T, covariance, here - zero[first], evidence, zero)


def residuals(graph: SiteGraph, poses: Tensor) -> Tensor:
    """How far poses (N + 1, 4, 4) are from each link (L, 6): a turn (radians) and the shift at ``center`` (meters).

    Of the motion in the frame of ``first`` that takes what the link says to what the poses say.
    """
    D = compose(compose(inverse(poses[graph.first]), poses[graph.second]), inverse(graph.T))
    shift = apply_rotation(D[:, :3, :3], graph.center) + D[:, :3, 3] - graph.center
    return torch.cat([rotation_vector(D[:, :3, :3]), shift], dim=1)


def _evidence(link: Link) -> float:
    """The log-odds among all candidates: no more than those against none alone, which keep digits near certainty."""
    p = torch.tensor(link.probability, dtype=torch.float64)
    among = float(torch.logit(p.clamp(1e-15, 1 - 1e-15)))
    return max(-SURE, min(SURE, link.log_odds, among if link.probability < 1 - 1e-12 else SURE))


def _both(R: Tensor) -> Tensor:
    """Matrices (L, 6, 6) that rotate turns and shifts by R (L, 3, 3)."""
    whole = R.new_zeros(len(R), 6, 6)
    whole[:, :3, :3] = whole[:, 3:, 3:] = R
    return whole


def _middles(node: Tensor, places: Tensor, count: int) -> Tensor:
    """The medians (count, 3) of the places (K, 3) of each node, per axis; zero for nodes without any."""
    result = places.new_zeros(count, 3)
    order = node.argsort(stable=True)
    sizes = torch.bincount(node, minlength=count).tolist()
    for number, part in enumerate(places[order].split(sizes)):
        if len(part):
            result[number] = part.median(dim=0).values
    return result
