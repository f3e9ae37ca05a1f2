"""What a scanner saw all around as an image of ranges, in which thousands of points are looked up in a moment.

Poses that follow from a chain of links are known to some centimeters. A point is held against the nearest and the
farthest range of the rays around its own then, so that edges of furniture tell nothing, and its color against the mean
of the cell. Colors are compared twice, as they are and as shares of red, green and blue, which light and exposure
hardly change.

The cells are those of an equal-area grid of rows of one latitude, as wide as two rays of the scanner are apart. Sums
are those of whole numbers, minima and maxima do not depend on order: the same bits for any number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply, inverse
from torchreg.neighborhoods.point_index import several_nearest
from torchreg.site.sight import clamped
from torchreg.types import Clouds

_RAYS, _FEWEST = 100_000, 2_000  # of a scan, at most and at least
_FINEST = math.radians(1.0)  # cells
_NEAREST = 4  # rays, this one among them, that say how far apart rays are
_ASKED = 6_000  # points of a scan that others are asked about

_SLACK, _SLOPE = 1.0, 0.01  # spacings, and of the range, by which a range may be off
_LEAST, _BESIDES = 200, 100  # points that tell something, at least; added to them when a share is taken
_LEAST_COLORED = 100  # points seen whose colors are known
_STEPS = 255  # of a color
_DARK = 0.05  # added to the sum of the channels that tints are shares of

_THROUGH, _COLOR, _TINT = 1.0, 0.3, 0.7  # weights
_GRAIN = 1.0  # times the difference between neighboring rays: less does not speak against a pose
_BELIEVED = 3  # links that neutral points are learned from, at least
_USUAL = 0.9  # of them that are usual
_NEUTRAL_MOST = (0.04, 0.15, 0.05)  # neutral points at most
_FOR, _AGAINST = 1.5, 4.0  # log-odds at most that ranges or colors speak for a pose, or against it


class Panorama(NamedTuple):
    """What the scanner of a scan saw, by direction.

    Attributes:
        scanner: (3,) float64, meters, in the frame of the scan's file.
        reach: meters, the median range.
        spacing: meters between neighboring cells there.
        row: (H + 1,) int64, the first cell of every row, from zenith to nadir.
        nearest: (C,) float32, meters: the least range of the rays around each cell; infinite where there is none.
        farthest: (C,) float32, likewise the largest; minus infinity where there is none.
        colors: (C, 3) uint8, the mean of the rays in the cell, 0 where there is none; or ``None``.
        seen: (C,) bool, whether there is one.
        points: (P, 3) float32, meters from the scanner, of points that other scanners are asked about.
        point_colors: (P, 3) uint8, or ``None``.
        color_grain: mean difference of the channels of neighboring rays: what noise and texture make of one surface.
        tint_grain: likewise of their shares of the sum.
    """

    scanner: Tensor
    reach: float
    spacing: float
    row: Tensor
    nearest: Tensor
    farthest: Tensor
    colors: Tensor | None
    seen: Tensor
    points: Tensor
    point_colors: Tensor | None
    color_grain: float
    tint_grain: float

    @property
    def is_around(self) -> bool:
        """Whether it shows most of the sphere, as scanners on tripods do: cameras and spinning lidars do not."""
        return 2 * int(self.nearest.isfinite().sum()) > len(self.nearest)


class Looked(NamedTuple):
    """Of points of one scan that the scanner of another could have seen.

    Attributes:
        through: how many it looked through.
        there: how many it saw.
        color: mean difference of the channels of those seen, besides the median of each; NaN where it is not known.
        tint: likewise of their shares of the sum.
    """

    through: int
    there: int
    color: float
    tint: float

    @property
    def tells(self) -> bool:
        """Whether these are enough."""
        return self.through + self.there >= _LEAST

    @property
    def share(self) -> float:
        """The share that it looked through, as if one of a hundred more had been."""
        return (self.through + 1.0) / (self.through + self.there + _BESIDES)


class Compared(NamedTuple):
    """What two scanners saw of each other's surfaces under a pose; NaN what nothing is known of.

    Attributes:
        through: the greater share of points that one of them looked through.
        color: mean difference of the channels of those that were seen.
        tint: likewise of their shares of the sum.
        color_grain: differences of colors up to this are those of neighboring rays of one scan.
        tint_grain: likewise of tints.
    """

    through: float
    color: float
    tint: float
    color_grain: float
    tint_grain: float


class Neutral(NamedTuple):
    """What speaks neither for a pose nor against it; more speaks against it.

    Attributes:
        through: share of points looked through.
        color: mean difference of channels.
        tint: mean difference of their shares of the sum.
    """

    through: float = 0.009
    color: float = 0.045
    tint: float = 0.0125

    def odds(self, seen: Compared) -> float:
        """Log-odds for a pose, or against it; 0 where nothing is known."""
        odds = 0.0
        if not math.isnan(seen.through):
            odds += clamped(_THROUGH * math.log(self.through / seen.through), most=_FOR, least=-_AGAINST)
        if not math.isnan(seen.color):
            color = math.log(max(self.color, seen.color_grain) / max(seen.color, 1e-6))
            tint = math.log(max(self.tint, seen.tint_grain) / max(seen.tint, 1e-6))
            odds += clamped(_COLOR * color + _TINT * tint, most=_FOR, least=-_AGAINST)
        return odds


def learned_neutral(seen: Sequence[Compared]) -> Neutral | None:
    """What speaks neither way on a site, from links that can be believed; ``None`` where they are few.

    Nine in ten of these links are to speak for themselves.
    """
    if len(seen) < _BELIEVED:
        return None
    learned = []
    for values, least, most in zip(zip(*(one[:3] for one in seen), strict=True), Neutral(), _NEUTRAL_MOST, strict=True):
        known = sorted(value for value in values if not math.isnan(value))
        usual = known[math.ceil(_USUAL * len(known)) - 1] if len(known) >= _BELIEVED else 0.0
        learned.append(min(max(usual, least), most))
    return Neutral(*learned)


def panorama_of(cloud: Clouds) -> Panorama | None:
    """The panorama of a batch of one.

    ``None`` where the place of its scanner is not known, or it has less than 2,000 points.
    """
    count = len(cloud.points)
    if cloud.viewpoint is None or not bool(cloud.viewpoint_known.all()) or count < _FEWEST:
        return None
    rows = _some(count, _RAYS)
    away = (cloud.points[rows.to(cloud.points.device)] - cloud.viewpoint[0]).double().cpu()
    ranges = torch.linalg.vector_norm(away, dim=1).clamp(min=1e-9)
    rays = away / ranges[:, None]
    near = several_nearest(rays, rays, _NEAREST)
    apart = float(torch.linalg.vector_norm(rays[near[:, -1]] - rays, dim=1).median())
    angle = max(_FINEST, apart)
    row = _rows(angle)
    size = int(row[-1])
    nearest = torch.full((size,), math.inf, dtype=torch.float64)
    farthest = torch.full((size,), -math.inf, dtype=torch.float64)
    across, along = _beside(rays)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            cell = _cells(row, rays + angle * (i * across + j * along))
            nearest.scatter_reduce_(0, cell, ranges, "amin")
            farthest.scatter_reduce_(0, cell, ranges, "amax")
    own = _cells(row, rays)
    hits = torch.bincount(own, minlength=size)
    asked = _some(len(rows), _ASKED)
    colors = given = None
    grain = (0.0, 0.0)
    if cloud.colors is not None:
        given = (cloud.colors[rows.to(cloud.colors.device)].cpu().clamp(0, 1) * _STEPS).round().long()
        sums = torch.zeros(size, 3, dtype=torch.int64).index_add_(0, own, given)
        colors = (sums / hits.clamp(min=1)[:, None]).round().to(torch.uint8)
        pair = given[asked].double() / _STEPS, given[near[asked, 1]].double() / _STEPS
        grain = _difference(*pair), _difference(*map(_tints, pair))
        given = given[asked].to(torch.uint8)
    return Panorama(
        scanner=(cloud.viewpoint[0].double() + cloud.origin[0]).cpu(),
        reach=float(ranges.median()),
        spacing=angle * float(ranges.median()),
        row=row,
        nearest=nearest.float(),
        farthest=farthest.float(),
        colors=colors,
        seen=hits > 0,
        points=away[asked].float(),
        point_colors=given,
        color_grain=grain[0],
        tint_grain=grain[1],
    )


def looked(viewer: Panorama, other: Panorama, T_viewer_other: Tensor) -> Looked:
    """What the scanner of ``viewer`` saw of the points of ``other`` under a pose (4, 4) float64."""
    away = apply(T_viewer_other, other.points.double() + other.scanner) - viewer.scanner
    ranges = torch.linalg.vector_norm(away, dim=1)
    cell = _cells(viewer.row, away)
    nearest, farthest = viewer.nearest[cell], viewer.farthest[cell]
    slack = _SLACK * max(viewer.spacing, other.spacing) + _SLOPE * ranges
    known = nearest.isfinite()
    through = known & (nearest - ranges > slack)
    there = known & (ranges - farthest <= slack) & ~through
    color = tint = math.nan
    if viewer.colors is not None and other.point_colors is not None:
        same = (there & viewer.seen[cell] & (farthest - nearest < 2 * slack)).nonzero()[:, 0]
        if len(same) > _LEAST_COLORED:
            one, two = viewer.colors[cell[same]].double() / _STEPS, other.point_colors[same].double() / _STEPS
            color, tint = _difference(one, two), _difference(_tints(one), _tints(two))
    return Looked(int(through.sum()), int(there.sum()), color, tint)


def compared(source: Panorama, target: Panorama, T_target_source: Tensor) -> Compared:
    """What both scanners saw of each other's surfaces under a pose (4, 4) float64."""
    views = looked(target, source, T_target_source), looked(source, target, inverse(T_target_source))
    telling = [view for view in views if view.tells]
    colored = [view for view in telling if not math.isnan(view.color)]
    color = tint = math.nan
    if colored:
        color = sum(view.color for view in colored) / len(colored)
        tint = sum(view.tint for view in colored) / len(colored)
    return Compared(
        through=max((view.share for view in telling), default=math.nan),
        color=color,
        tint=tint,
        color_grain=_GRAIN * max(source.color_grain, target.color_grain),
        tint_grain=_GRAIN * max(source.tint_grain, target.tint_grain),
    )


def _some(count: int, most: int) -> Tensor:
    """Rows of points, in order, so many at most, chosen by chance from a seed of their own."""
    if count <= most:
        return torch.arange(count)
    chance = torch.Generator().manual_seed(count)
    return torch.randperm(count, generator=chance)[:most].sort().values


def _rows(angle: float) -> Tensor:
    """The first cell of each row (H + 1,) of an equal-area grid of the sphere, and the number of all."""
    height = max(1, round(math.pi / angle))
    latitude = (torch.arange(height, dtype=torch.float64) + 0.5) / height * math.pi
    width = (2 * height * latitude.sin()).round().clamp(min=3).long()
    return torch.cat([width.new_zeros(1), width.cumsum(0)])


def _cells(row: Tensor, away: Tensor) -> Tensor:
    """The cells (P,) of directions (P, 3) of any length."""
    height, width = len(row) - 1, row.diff()
    length = torch.linalg.vector_norm(away, dim=1).clamp(min=1e-9)
    latitude = torch.acos((away[:, 2] / length).clamp(-1.0, 1.0))
    at = (latitude * (height / math.pi)).long().clamp(max=height - 1)
    turn = torch.atan2(away[:, 1], away[:, 0]) / (2 * math.pi) + 0.5
    return row[at] + torch.minimum((turn * width[at]).long(), width[at] - 1)


def _beside(rays: Tensor) -> tuple[Tensor, Tensor]:
    """Two directions (P, 3) of unit length across each ray and each other."""
    steep = rays[:, 2:].abs() < 0.9
    axis = torch.where(steep, rays.new_tensor([0.0, 0.0, 1.0]), rays.new_tensor([1.0, 0.0, 0.0]))
    across = torch.nn.functional.normalize(torch.linalg.cross(rays, axis), dim=1)
    return across, torch.linalg.cross(rays, across)


def _tints(colors: Tensor) -> Tensor:
    return colors / (colors.sum(dim=1, keepdim=True) + _DARK)


def _difference(one: Tensor, two: Tensor) -> float:
    """The mean difference of colors (P, 3), besides the median of each channel."""
    apart = one - two
    return float((apart - apart.median(dim=0).values).abs().mean())
