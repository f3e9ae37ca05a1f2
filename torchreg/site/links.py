"""One pose that the clouds of a pair of scans suggest, as the graph of a site takes it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import at_least, expect, expect_shape, fraction, positive
from torchreg.geometry.rigid_check import expect_rigid
from torchreg.types.record import Record


@entry
def loose_covariance(shift: float, reach: float) -> Tensor:
    """The covariance (6, 6) of a pose that is known to a shift of ``shift`` meters at a distance of ``reach`` meters.

    For poses whose own was not measured, such as those of candidates that were not refined: turns about each axis have
    the deviation ``shift / reach`` radians, shifts along each have ``shift`` meters.

    Example:
        >>> from torchreg.site import loose_covariance
        >>> loose_covariance(shift=0.1, reach=10.0).shape
        torch.Size([6, 6])
    """
    turn = positive(shift, "shift") / positive(reach, "reach")
    return torch.tensor([turn**2] * 3 + [shift**2] * 3, dtype=torch.float64).diag()


@checked_record
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Link(Record):
    """A candidate for the pose of one scan in the frame of another.

    A pair of scans has any number of them, of which at most one is right. Turns, shifts and frames are those of
    ``RegistrationResult``.

    Attributes:
        target: the number of the scan whose frame the transform leads to, from 0.
        source: the number of the other scan.
        T_target_source: (4, 4) float64, rigid: x_target = R x_source + t in meters, between the frames of the files.
        log_odds: of being right against no candidate of the pair being right (natural logarithm).
        probability: in [0, 1], of being right among all candidates of the pair.
        covariance: (6, 6) float64, of a small turn about ``center`` (radians) and a shift (meters) in the target's
            frame: x_true = x + turn x (x - center) + shift. Positive definite; ``loose_covariance`` makes one.
        center: (3,) float64, meters, in the target's frame: the middle of the overlap.
        overlap: share of points with a partner; NaN where it is not known.
        residual: meters, between the surfaces of the overlap; NaN likewise.
        sight: log-odds from what the scanners saw under this pose (``sight``), which are part of ``log_odds``; NaN
            where a scanner's place is not known.
        apart: how far apart the scanners would stand under this pose, as a multiple of their ranges; NaN likewise.
        rank: the place among the candidates of its pair, 0 for the best.
        reason: why the pair was refused when it was registered; empty where it was not.

    Raises:
        ValueError: a scan linked to itself, a transform that is not rigid, or a covariance that is none.

    Example:
        >>> import torch
        >>> from torchreg.site import Link, loose_covariance
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> sure = {"log_odds": 4.0, "probability": 0.98, "covariance": loose_covariance(0.01, 10.0)}
        >>> link = Link(target=0, source=1, T_target_source=T, **sure)
        >>> link.source, link.target
        (1, 0)
    """

    target: int
    source: int
    T_target_source: Tensor
    log_odds: float
    probability: float
    covariance: Tensor
    center: Tensor = field(default_factory=lambda: torch.zeros(3, dtype=torch.float64))
    overlap: float = math.nan
    residual: float = math.nan
    sight: float = math.nan
    apart: float = math.nan
    rank: int = 0
    reason: str = ""

    def __post_init__(self) -> None:
        at_least(self.target, "target", 0)
        at_least(self.source, "source", 0)
        expect(self.target != self.source, "source", "another scan than the target", self.source)
        expect_shape(self.T_target_source, "T_target_source", (4, 4), torch.float64)
        expect_rigid(self.T_target_source, "T_target_source")
        expect(not math.isnan(self.log_odds), "log_odds", "a number", self.log_odds)
        fraction(self.probability, "probability", zero=True)
        expect_covariance(self.covariance, "covariance")
        expect_shape(self.center, "center", (3,), torch.float64)
        expect(bool(self.center.isfinite().all()), "center", "finite numbers", self.center.tolist())
        at_least(self.rank, "rank", 0)

    def weighed(self, log_odds: float, probability: float) -> Link:
        """The same pose with other log-odds and another probability; what stays the same is not checked again."""
        expect(not math.isnan(log_odds), "log_odds", "a number", log_odds)
        made = object.__new__(Link)
        made.__dict__.update(self.__dict__)
        made.__dict__.update(log_odds=log_odds, probability=fraction(probability, "probability", zero=True))
        return made

    def _facts(self) -> Sequence[str]:
        place = ", ".join(f"{number:.3f}" for number in self.T_target_source[:3, 3].tolist())
        return (
            f"scan {self.source} in the frame of scan {self.target}, at {place} m",
            f"candidate {self.rank + 1}, log-odds {self.log_odds:.2f}, probability {self.probability:.3f}",
            f"refused: {self.reason}" if self.reason else "not refused",
        )


@checked_record
@dataclass(frozen=True, eq=False, kw_only=True)
class KnownPose:
    """What is known of the pose of one scan beforehand, such as from a survey: a link to the world.

    Attributes:
        scan: the number of the scan.
        T_world_scan: (4, 4) float64, rigid: x_world = R x_scan + t in meters.
        covariance: (6, 6) float64, as that of a ``Link``, in the frame of the world.
        center: (3,) float64, meters, in the frame of the world, about which the turn is meant: the place of the scan
            by default.

    Raises:
        ValueError: as ``Link``.

    Example:
        >>> import torch, torchreg as tr
        >>> from torchreg.site import KnownPose, loose_covariance
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> KnownPose(scan=0, T_world_scan=T, covariance=loose_covariance(0.01, 10.0)).scan
        0
    """

    scan: int
    T_world_scan: Tensor
    covariance: Tensor
    center: Tensor | None = None

    def __post_init__(self) -> None:
        at_least(self.scan, "scan", 0)
        expect_shape(self.T_world_scan, "T_world_scan", (4, 4), torch.float64)
        expect_rigid(self.T_world_scan, "T_world_scan")
        expect_covariance(self.covariance, "covariance")
        if self.center is not None:
            expect_shape(self.center, "center", (3,), torch.float64)


def expect_covariance(value: Tensor, name: str) -> None:
    """Check that a matrix (6, 6) float64 is symmetric and positive definite."""
    expect_shape(value, name, (6, 6), torch.float64)
    scale = torch.diagonal(value).clamp(min=0).sqrt()
    even = value / scale[:, None].clamp(min=1e-300) / scale.clamp(min=1e-300)
    legal = bool(even.isfinite().all()) and bool((even - even.t()).abs().max() < 1e-6)
    legal = legal and int(torch.linalg.cholesky_ex(even)[1]) == 0
    expect(legal, name, "a symmetric, positive definite matrix", value.tolist())
