"""Let poses that are about right settle to the millimeter: surfels of both clouds, laid onto each other's planes.

Point-to-plane ICP (Chen and Medioni, 1992) whose correspondences grow nearer and whose residuals weigh by their noise:
every residual is divided by the standard deviation of its two surfels, and Tukey's loss cuts it off at a few times the
spread that the residuals of the pair have at that moment. So what moved between the scans, and what one of them alone
saw, ends up without weight, while few pairs have to be told how noisy they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.native import call, native
from torchreg.refinement.blocks import Blocks, turned
from torchreg.refinement.colored import color_gradient, intensity_of
from torchreg.refinement.correspond import Correspondence, Target, few_nearest
from torchreg.refinement.gauss_newton import solve
from torchreg.refinement.pairing import Frames, Pairing, centered_frames
from torchreg.refinement.spread import (
    Residuals,
    ResidualSpread,
    deviations,
    medians,
    normal_equations,
    residual_spread,
    shades_of,
)
from torchreg.refinement.surfels import Surfels
from torchreg.refinement.tree_correspond import correspondences
from torchreg.types import Clouds
from torchreg.types.packing import spans

_FACING = 0.7  # cosine between the normals of partners at least; of either sign where a scanner's place is not known
_NARROWER = 0.5  # of the reach, from one update to the next
_NEAREST = 2.0  # spacings, where the reach ends
_MOST_UPDATES = 30
_SHADE_RADIUS = 3.0  # spacings, from which the gradient of intensity is taken
_STILL = 2e-3  # of the residuals' deviation: smaller updates end the refinement


class Settling(NamedTuple):
    """The state of B pairs when they have settled."""

    matches: Correspondence  # of the pairs, in their order
    residuals: Residuals  # of all blocks
    spread: ResidualSpread  # of the B pairs
    rotation: Tensor  # (B, 3, 3) float64, between the centered frames
    translation: Tensor  # (B, 3) float64
    solvable: list[bool]  # whether the surfels determine the motion
    updates: list[int]


class SurfelPairs:
    """B pairs of surfel clouds, none of which is empty, ready to be laid onto each other under any poses.

    With ``colored``, which all clouds need colors for, their intensities take part.
    """

    def __init__(self, source: Surfels, target: Surfels, pairing: Pairing, *, colored: bool = False) -> None:
        self._colored = colored
        self.pairing = pairing
        known = (source.cloud.viewpoint_known, target.cloud.viewpoint_known)
        # (B,) whether partners must face the same side: else both faces of a wall would be taken for one
        self._faced = known[0][pairing.source] & known[1][pairing.target]
        self.frames: Frames = centered_frames(source.cloud, target.cloud, pairing)
        sources = [spans(source.cloud.offsets)[number] for number in pairing.source]
        self.lengths = [end - begin for begin, end in sources]
        device = source.cloud.device
        self.blocks = Blocks.of(self.lengths, device)
        rows = torch.cat([torch.arange(begin, end) for begin, end in sources]).to(device)
        center = self.frames.source_center.repeat_interleave(torch.tensor(self.lengths, device=device), dim=0)
        self._points = self.blocks.fill(source.cloud.points[rows].double() - center)  # (3, n, 256)
        columns = _plane_columns(source) if not colored else torch.cat([_plane_columns(source), _shade(source)], dim=1)
        self._extra = self.blocks.fill(columns[rows])  # (4 or 5, n, 256): normal, variance, intensity
        self._searched = self._target_of(target)
        spacings = [max(source.spacing[one], target.spacing[other]) for one, other in zip(*pairing, strict=True)]
        self.spacing = torch.tensor(spacings, dtype=torch.float64, device=device)
        self.nearest = _NEAREST * self.spacing
        x, y, z = self._points.unbind(0)
        squares = self.blocks.sums(lambda chunk: (x[chunk] ** 2 + y[chunk] ** 2 + z[chunk] ** 2)[None], 1)[:, 0]
        # (B,) root mean square distances of the sources' surfels from their centers
        self.sizes = (squares / torch.tensor(self.lengths, device=device)).sqrt()

    def matched(self, rotation: Tensor, translation: Tensor, reach: Tensor) -> Correspondence:
        """The correspondences under poses of all pairs, within ``reach`` (B,) meters."""
        matches = correspondences(self.blocks, self._points, self._searched, reach)
        matches.move(rotation, translation)
        return matches

    def residuals(self, matches: Correspondence, rotation: Tensor, extra: Tensor | None = None) -> Residuals:
        """The residuals of the active pairs of ``matches``, whose sources are turned by ``rotation`` (B, 3, 3)."""
        extra = self._extra if extra is None else extra
        normal = matches.partner[3:6]
        if native(extra, matches.moved) and not self._colored:
            return _residuals_compiled(matches, rotation, extra, self._faced[matches.pairs])
        x, y, z = (matches.moved - matches.partner[:3]).mul_(normal).unbind(0)
        own = turned(rotation[matches.blocks.pair], extra[:3])
        a, b, c = (own * normal).unbind(0)
        cosine = a.add_(b).add_(c)
        faced = self._faced[matches.pairs][matches.blocks.pair, None]
        alike = matches.inside & (torch.where(faced, cosine, cosine.abs()) > _FACING)
        return Residuals(
            distance=x.add_(y).add_(z),
            variance=(extra[3] + matches.partner[6]).clamp_(min=1e-24),
            normal=normal,
            turned=own,
            alike=alike,
            shades=shades_of(extra[4], matches, matches.partner[7:], alike, normal) if self._colored else None,
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
            spread = residual_spread(shown, matches.blocks)
            update = solve(normal_equations(shown, matches, spread), self.frames.target_center[pairs])
            usable = update.usable.tolist()
            onwards = apply_rotation(update.rotation[:, None], R[pairs].transpose(1, 2)).transpose(1, 2)
            moved = apply_rotation(update.rotation, t[pairs]) + update.translation
            step = self.displacement(pairs, onwards, moved, R[pairs], t[pairs])
            at_end = (reach[pairs] <= self.nearest[pairs]).tolist()
            typical = medians(deviations(shown, spread, matches.blocks), shown.alike, matches.blocks)
            small = (step < _STILL * spread.scale * typical).tolist()
            stays = []
            for place, b in enumerate(pairs):
                solvable[b] = solvable[b] and usable[place]
                if usable[place]:
                    R[b], t[b] = onwards[place], moved[place]
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

    def seen(self, rotation: Tensor, translation: Tensor, spread: ResidualSpread | None = None) -> Settling:
        """Poses (B, 3, 3), (B, 3) as they are; ``spread`` where the residuals' own is not wanted."""
        matches = self.matched(rotation, translation, self.nearest)
        shown = self.residuals(matches, rotation)
        spread = residual_spread(shown, self.blocks) if spread is None else spread
        count = len(rotation)
        return Settling(matches, shown, spread, rotation, translation, [True] * count, [0] * count)

    def displacement(self, pairs: Sequence[int], R: Tensor, t: Tensor, R0: Tensor, t0: Tensor) -> Tensor:
        """Meters (B,) by which sources move from one pose to another, about their root mean square."""
        sizes = self.sizes[list(pairs)]
        turn = (R - R0).square().sum(dim=(1, 2)).div(2).sqrt()  # radians, where they are few
        moved: Tensor = (t - t0).norm(dim=1) + turn * sizes
        return moved

    def _target_of(self, target: Surfels) -> Target:
        cloud, columns = target.cloud, _plane_columns(target)
        center = torch.zeros(len(target), 3, dtype=torch.float64, device=cloud.device)
        center[list(self.pairing.target)] = self.frames.target_center
        each = torch.tensor(cloud.lengths, device=cloud.device)
        points = cloud.points.double() - center.repeat_interleave(each, dim=0)
        search = {n: few_nearest(points[i:j]) for n, (i, j) in enumerate(spans(cloud.offsets)) if j > i}
        first = cloud.offsets.tolist()
        if self._colored:
            columns = torch.cat([columns, _gradient(target, points), _shade(target)], dim=1)
        return Target(
            torch.cat([points, columns], dim=1).t().contiguous(),
            tuple(first[number] for number in self.pairing.target),
            tuple(search[number] for number in self.pairing.target),
        )


def _residuals_compiled(matches: Correspondence, rotation: Tensor, extra: Tensor, faced: Tensor) -> Residuals:
    """As ``SurfelPairs.residuals``, without shades."""
    distance, variance, alike = (torch.empty_like(each) for each in (matches.square, matches.square, matches.inside))
    turned_normals = torch.empty_like(matches.moved)
    call(
        "surfel_residuals",
        matches.moved,
        matches.partner,
        extra.contiguous(),
        rotation.contiguous(),
        matches.blocks.pair,
        matches.inside,
        faced.contiguous(),
        len(matches.square),
        _FACING,
        distance,
        variance,
        turned_normals,
        alike,
    )
    return Residuals(distance, variance, matches.partner[3:6], turned_normals, alike)


def _plane_columns(surfels: Surfels) -> Tensor:
    """(P, 4) float64: normal and variance."""
    cloud: Clouds = surfels.cloud
    if cloud.normals is None:
        raise ValueError("surfels: expected normals, got none")
    return torch.cat([cloud.normals, surfels.variance[:, None]], dim=1).double()


def _shade(surfels: Surfels) -> Tensor:
    """(P, 1) float64: intensity."""
    return intensity_of(surfels.cloud)[:, None]


def _gradient(surfels: Surfels, points: Tensor) -> Tensor:
    """(P, 3) float64: the gradient of intensity along every surfel, per meter; its points are about their centers."""
    radius = torch.tensor([max(_SHADE_RADIUS * spacing, 1e-9) for spacing in surfels.spacing], dtype=torch.float64)
    about = replace(surfels.cloud.to(dtype=torch.float64), points=points)
    normals = _plane_columns(surfels)[:, :3]
    return color_gradient(about, normals, _shade(surfels)[:, 0], radius)
