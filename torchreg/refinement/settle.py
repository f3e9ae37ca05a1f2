"""Let poses that are about right settle to the millimeter: surfels of both clouds, laid onto each other's planes.

Point-to-plane ICP (Chen and Medioni, 1992) whose correspondences grow nearer and whose residuals weigh by their noise:
every residual is divided by the standard deviation of its two surfels, and Tukey's loss cuts it off at a few times the
spread that the residuals of the pair have at that moment. So what moved between the scans, and what one of them alone
saw, ends up without weight, while few pairs have to be told how noisy they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.refinement.blocks import Blocks
from torchreg.refinement.correspond import Correspondence, Target, few_nearest
from torchreg.refinement.gauss_newton import CHANNELS, products, solve
from torchreg.refinement.kernels import tukey
from torchreg.refinement.pairing import Frames, Pairing, centered_frames
from torchreg.refinement.point_to_plane import jacobian
from torchreg.refinement.surfels import Surfels
from torchreg.types import Clouds
from torchreg.types.packing import spans

CUT = 3.0  # standard deviations of the residuals, beyond which they have no weight
_DEVIATION = 1.4826  # standard deviation of normal numbers to their median absolute value
_FACING = 0.7  # cosine between the normals of partners at least
_NARROWER = 0.5  # of the reach, from one update to the next
_NEAREST = 2.0  # spacings, where the reach ends
_MOST_UPDATES = 30
_STILL = 2e-3  # of the residuals' deviation: smaller updates end the refinement


class Residuals(NamedTuple):
    """Surfels of the sources and the planes of their partners, k blocks of 256 rows; float64."""

    distance: Tensor  # (k, 256) meters, of the means to the partners' planes
    variance: Tensor  # (k, 256) squared meters, that the noise of both surfels gives it
    normal: Tensor  # (3, k, 256) of the partners
    turned: Tensor  # (3, k, 256) of the sources' surfels, turned into the target's frame, of either sign
    alike: Tensor  # (k, 256) bool, whether the two are within reach and face alike


class Scatter(NamedTuple):
    """How far the surfels of B pairs lie from the planes of their partners, but for those that have none."""

    scale: Tensor  # (B,) float64, standard deviation of the residuals in units of their ``deviations``
    excess: Tensor  # (B,) squared meters, the variance that noise alone does not explain: scans are bent, things moved


class Settling(NamedTuple):
    """The state of B pairs when they have settled."""

    matches: Correspondence  # of the pairs, in their order
    residuals: Residuals  # of all blocks
    spread: Scatter  # of the B pairs
    rotation: Tensor  # (B, 3, 3) float64, between the centered frames
    translation: Tensor  # (B, 3) float64
    solvable: list[bool]  # whether the surfels determine the motion
    updates: list[int]


class SurfelPairs:
    """B pairs of surfel clouds, none of which is empty, ready to be laid onto each other under any poses."""

    def __init__(self, source: Surfels, target: Surfels, pairing: Pairing) -> None:
        self.pairing = pairing
        self.frames: Frames = centered_frames(source.cloud, target.cloud, pairing)
        self._source, self._target = source, target
        sources = [spans(source.cloud.offsets)[number] for number in pairing.source]
        self.lengths = [end - begin for begin, end in sources]
        device = source.cloud.device
        self.blocks = Blocks.of(self.lengths, device)
        rows = torch.cat([torch.arange(begin, end) for begin, end in sources]).to(device)
        center = self.frames.source_center.repeat_interleave(torch.tensor(self.lengths, device=device), dim=0)
        self._points = self.blocks.fill(source.cloud.points[rows].double() - center)  # (3, n, 256)
        self._extra = self.blocks.fill(_plane_columns(source)[rows])  # (4, n, 256): normal, variance
        self._searched = self._target_of(target)
        spacings = [max(source.spacing[one], target.spacing[other]) for one, other in zip(*pairing, strict=True)]
        self.spacing = torch.tensor(spacings, dtype=torch.float64, device=device)
        self.nearest = _NEAREST * self.spacing

    def matched(self, rotation: Tensor, translation: Tensor, reach: Tensor) -> Correspondence:
        """The correspondences under poses of all pairs, within ``reach`` (B,) meters."""
        matches = Correspondence(self.blocks, self._points, self._searched, reach)
        matches.move(rotation, translation)
        return matches

    def residuals(self, matches: Correspondence, rotation: Tensor, extra: Tensor | None = None) -> Residuals:
        """The residuals of the active pairs of ``matches``, whose sources are turned by ``rotation`` (B, 3, 3)."""
        extra = self._extra if extra is None else extra
        normal = matches.partner[3:6]
        x, y, z = (matches.moved - matches.partner[:3]).mul_(normal).unbind(0)
        R = rotation[matches.blocks.pair]  # (n, 3, 3)
        own = [
            R[:, i, 0, None] * extra[0] + R[:, i, 1, None] * extra[1] + R[:, i, 2, None] * extra[2] for i in range(3)
        ]
        facing = own[0] * normal[0] + own[1] * normal[1] + own[2] * normal[2]
        return Residuals(
            distance=x.add_(y).add_(z),
            variance=(extra[3] + matches.partner[6]).clamp_(min=1e-24),
            normal=normal,
            turned=torch.stack(own),
            alike=matches.inside & (facing.abs_() > _FACING),
        )

    def settle(self, rotation: Tensor, translation: Tensor, reach: Tensor) -> Settling:
        """Refine poses (B, 3, 3), (B, 3) between the centered frames that are off by ``reach`` (B,) meters at most."""
        R, t = rotation.clone(), translation.clone()
        reach = torch.maximum(reach, self.nearest)
        matches = self.matched(R, t, reach)
        extra = self._extra
        solvable, updates = [True] * len(reach), [0] * len(reach)
        for _ in range(_MOST_UPDATES):
            pairs = matches.pairs
            shown = self.residuals(matches, R[pairs], extra)
            spread = _spread(shown, matches.blocks)
            update = solve(_sums(shown, matches, spread), self.frames.target_center[pairs])
            usable = update.usable.tolist()
            turned = apply_rotation(update.rotation[:, None], R[pairs].transpose(1, 2)).transpose(1, 2)
            moved = apply_rotation(update.rotation, t[pairs]) + update.translation
            step = self.displacement(pairs, turned, moved, R[pairs], t[pairs])
            at_end = (reach[pairs] <= self.nearest[pairs]).tolist()
            typical = _medians(deviations(shown, spread, matches.blocks), shown.alike, matches.blocks)
            small = (step < _STILL * spread.scale * typical).tolist()
            stays = []
            for place, b in enumerate(pairs):
                solvable[b] = solvable[b] and usable[place]
                if usable[place]:
                    R[b], t[b] = turned[place], moved[place]
                    updates[b] += 1
                stays.append(usable[place] and not (small[place] and at_end[place]))
            reach[pairs] = torch.maximum(_NARROWER * reach[pairs], self.nearest[pairs])
            if not any(stays):
                break
            if not all(stays):
                chosen = matches.keep([place for place, stay in enumerate(stays) if stay])
                extra = extra[:, chosen]
            matches.narrow(reach[matches.pairs])
            matches.move(R[matches.pairs], t[matches.pairs])
        return self.seen(R, t)._replace(solvable=solvable, updates=updates)

    def seen(self, rotation: Tensor, translation: Tensor, spread: Scatter | None = None) -> Settling:
        """Poses (B, 3, 3), (B, 3) as they are; ``spread`` where the residuals' own is not wanted."""
        matches = self.matched(rotation, translation, self.nearest)
        shown = self.residuals(matches, rotation)
        spread = _spread(shown, self.blocks) if spread is None else spread
        count = len(rotation)
        return Settling(matches, shown, spread, rotation, translation, [True] * count, [0] * count)

    def displacement(self, pairs: Sequence[int], R: Tensor, t: Tensor, R0: Tensor, t0: Tensor) -> Tensor:
        """Meters (B,) by which sources move from one pose to another, about their root mean square."""
        sizes = self._sizes[list(pairs)]
        turn = (R - R0).square().sum(dim=(1, 2)).div(2).sqrt()  # radians, where they are few
        moved: Tensor = (t - t0).norm(dim=1) + turn * sizes
        return moved

    @property
    def _sizes(self) -> Tensor:
        """Root mean square distances (B,) of the sources' surfels from their centers."""
        x, y, z = self._points.unbind(0)
        total = self.blocks.sums(lambda chunk: (x[chunk] ** 2 + y[chunk] ** 2 + z[chunk] ** 2)[None], 1)[:, 0]
        return (total / torch.tensor(self.lengths, device=total.device)).sqrt()

    def _target_of(self, target: Surfels) -> Target:
        cloud, columns = target.cloud, _plane_columns(target)
        center = torch.zeros(len(target), 3, dtype=torch.float64, device=cloud.device)
        center[list(self.pairing.target)] = self.frames.target_center
        each = torch.tensor(cloud.lengths, device=cloud.device)
        points = cloud.points.double() - center.repeat_interleave(each, dim=0)
        search = {n: few_nearest(points[i:j]) for n, (i, j) in enumerate(spans(cloud.offsets)) if j > i}
        first = cloud.offsets.tolist()
        return Target(
            torch.cat([points, columns], dim=1).t().contiguous(),
            tuple(first[number] for number in self.pairing.target),
            tuple(search[number] for number in self.pairing.target),
        )


def _plane_columns(surfels: Surfels) -> Tensor:
    """(P, 4) float64: normal and variance."""
    cloud: Clouds = surfels.cloud
    if cloud.normals is None:
        raise ValueError("surfels: expected normals, got none")
    return torch.cat([cloud.normals, surfels.variance[:, None]], dim=1).double()


def deviations(shown: Residuals, spread: Scatter, blocks: Blocks) -> Tensor:
    """The standard deviations (n, 256) of the residuals by noise and excess, meters."""
    return (shown.variance + spread.excess[blocks.pair][:, None]).sqrt_()


def _spread(shown: Residuals, blocks: Blocks) -> Scatter:
    """The spread of every pair, from medians, which what moved does not reach."""
    distance = shown.distance.abs()
    whole = (_DEVIATION * _medians(distance, shown.alike, blocks)).square()
    excess = (whole - _medians(shown.variance, shown.alike, blocks)).clamp(min=0)
    relative = distance / deviations(shown, Scatter(excess, excess), blocks)
    return Scatter((_DEVIATION * _medians(relative, shown.alike, blocks)).clamp(min=1e-12), excess)


def _medians(values: Tensor, kept: Tensor, blocks: Blocks) -> Tensor:
    """Medians (B,) of values (n, 256) where ``kept``; 0 where a pair has none."""
    ends = torch.tensor(blocks.counts).cumsum(0).tolist()
    medians = []
    for end, count in zip(ends, blocks.counts, strict=True):
        rows = slice(end - count, end)
        own = values[rows][kept[rows]]
        medians.append(own.median() if len(own) > 0 else values.new_zeros(()))
    return torch.stack(medians)


def _sums(shown: Residuals, matches: Correspondence, spread: Scatter) -> Tensor:
    """The sums (B, 28) of the normal equations."""
    blocks = matches.blocks
    cut = CUT * spread.scale[blocks.pair][:, None]
    deviation = deviations(shown, spread, blocks)

    def terms(chunk: slice) -> Tensor:
        distance, unit = shown.distance[chunk], deviation[chunk]
        weight = tukey(distance / unit, cut[chunk]) * shown.alike[chunk] / (unit * unit)
        return products(jacobian(matches.moved[:, chunk], shown.normal[:, chunk], distance), weight)

    return blocks.sums(terms, CHANNELS)
