"""The result of placing the scans of a site."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.site.control import JudgedPoint
from torchreg.site.links import Link
from torchreg.types.held import PerItem, held
from torchreg.types.loading import loadable
from torchreg.types.record import Record
from torchreg.types.shown import several


@loadable
class SiteLink(NamedTuple):
    """A candidate for the pose of a pair of scans, and the verdict on it. A figure that it has not is NaN.

    Attributes:
        link: the candidate.
        used: whether it is held to be right: it agrees with the poses, best among those of its pair.
        weight: in [0, 1], how much of it counted in the poses; 0 where not used.
        meters: how far the poses put the link's center from where the link puts it.
        degrees: the angle between both.
        loops: how many loops of three used links, this one among them, close.
        loop_meters: by how much these loops miss closing, their median.
        loop_degrees: likewise.

    Example:
        >>> import torch
        >>> from torchreg.site import Link, SiteLink, loose_covariance
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> sure = {"log_odds": 4.0, "probability": 0.98, "covariance": loose_covariance(0.01, 10.0)}
        >>> link = Link(target=0, source=1, T_target_source=T, **sure)
        >>> SiteLink(link, True, 1.0, 0.002, 0.01, loops=3, loop_meters=0.004, loop_degrees=0.02).link.source
        1
    """

    link: Link
    used: bool
    weight: float
    meters: float
    degrees: float
    loops: int
    loop_meters: float
    loop_degrees: float


@loadable
class TriedPair(NamedTuple):
    """Two scans that were registered with each other.

    Attributes:
        source: the number of the scan that was moved.
        target: the number of the other.
        success: whether the pair alone is held to be registered.
        reason: why not; empty where it is.
        candidates: poses that were weighed for it.

    Example:
        >>> from torchreg.site import TriedPair
        >>> TriedPair(source=1, target=0, success=False, reason="too few matches", candidates=2).reason
        'too few matches'
    """

    source: int
    target: int
    success: bool
    reason: str
    candidates: int


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SiteResult(Record):
    """The poses of ``N`` scans, and what they stand on. A scan that is not placed is data: its reason.

    A group is what one frame holds; groups have nothing to do with each other. In every group the scan of the lowest
    number has the identity, unless the frame was chosen otherwise (``torchreg.site.frame``).

    Attributes:
        T_world_scan: (N, 4, 4) float64, rigid: x_world = R x_scan + t in meters, from the frame of each scan's file
            (origin included) to that of its group; NaN where not placed.
        group: (N,) int64, 0 for the group of most scans; -1 where not placed.
        covariance: (N, 6, 6) float64, of a small turn about ``center`` (radians) and a shift (meters) in the group's
            frame, relative to its first scan; NaN where not placed.
        center: (N, 3) float64, meters, in the group's frame: the middle of the overlaps of each scan.
        reason: why a scan is not placed, one per scan; empty where it is.
        notes: remarks on every scan, such as that it has no colors.
        links: the candidates of all pairs that were tried, each with its verdict.
        pairs: all pairs that were tried.
        scale: the factor, 1 or more, by which the squared errors of links exceed what their covariances promise; the
            covariances of the poses hold it already.
        doubt: what was taken from the log-odds of all links, since sure ones contradict each other; 0 as a rule. Where
            it is more, places of the site look alike, and only what loops confirm can be placed.
        control: the control points, in the order in which they were given, beside where the poses put them.
        remarks: on groups that have no frame of the world although one was wanted, in words.
        seconds: time of every stage, by name, in order.

    Example:
        >>> import torchreg as tr
        >>> scans = tr.datasets.building(seed=1, scans=5, angular_step=3.0).scans
        >>> site = tr.register_site(list(scans[:2]))
        >>> site.T_world_scan.shape, len(site.pairs)
        (torch.Size([2, 4, 4]), 1)
    """

    T_world_scan: Tensor = held(PerItem())
    group: Tensor = held(PerItem())
    covariance: Tensor = held(PerItem())
    center: Tensor = held(PerItem())
    reason: tuple[str, ...]
    notes: tuple[tuple[str, ...], ...]
    links: tuple[SiteLink, ...]
    pairs: tuple[TriedPair, ...]
    scale: float
    doubt: float
    control: tuple[JudgedPoint, ...]
    remarks: tuple[str, ...]
    seconds: tuple[tuple[str, float], ...]

    summarizer: ClassVar[Callable[[SiteResult], str]]
    """Writes the text of ``summary``; set by ``torchreg``, since its report stands above the sites."""

    def __post_init__(self) -> None:
        expect_shape(self.T_world_scan, "T_world_scan", ("N", 4, 4), torch.float64)
        count = len(self.T_world_scan)
        expect_shape(self.group, "group", (count,), torch.int64)
        expect_shape(self.covariance, "covariance", (count, 6, 6), torch.float64)
        expect_shape(self.center, "center", (count, 3), torch.float64)
        for name in ("reason", "notes"):
            expect(len(getattr(self, name)) == count, name, f"one per scan ({count})", len(getattr(self, name)))

    def __len__(self) -> int:
        """The number of scans, N."""
        return len(self.group)

    @property
    def placed(self) -> Tensor:
        """(N,) bool, which scans have a pose."""
        return self.group >= 0

    def summary(self) -> str:
        """Say in words which scans are placed, which are not and why, and what to look at first."""
        return type(self).summarizer(self)

    def _facts(self) -> Sequence[str]:
        groups = torch.bincount(self.group[self.placed]).tolist()
        used = sum(link.used for link in self.links)
        return (
            f"{several(len(self), 'scans')}, {int(self.placed.sum())} placed in groups of {groups}",
            f"{len(self.pairs)} pairs tried, {len(self.links)} candidates, {used} used",
        )
