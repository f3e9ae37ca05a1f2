"""Coarse to fine: the same loop on clouds of smaller and smaller voxels, with nearer and nearer correspondences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.morton import morton_order
from torchreg.preprocess import voxel_downsample
from torchreg.refinement.blocks import Blocks
from torchreg.refinement.color_gradient import color_gradient
from torchreg.refinement.colored import colored, intensity_of
from torchreg.refinement.correspond import Correspondence, Target
from torchreg.refinement.estimator import Estimator
from torchreg.refinement.frames import Frames
from torchreg.refinement.kernels import BY_NAME
from torchreg.refinement.loop import Criteria, State, Work, iterate
from torchreg.refinement.nearest_few import Search, few_nearest
from torchreg.refinement.options import IcpLevel, IcpOptions
from torchreg.refinement.point_to_plane import point_to_plane
from torchreg.refinement.point_to_point import point_to_point
from torchreg.types import Clouds
from torchreg.types.packing import spans


class Prepared(NamedTuple):
    """Clouds made ready: centered, float64, in Z order, and the searches in the points of every target."""

    source: Clouds
    target: Clouds
    search: tuple[Search, ...]


def refine_levels(source: Clouds, target: Clouds, frames: Frames, options: Sequence[IcpOptions], state: State) -> None:
    """Take all pairs of ``state`` through the levels of their options.

    Args:
        source: B clouds, finite and not empty.
        target: B clouds likewise, with the normals and colors that the kind needs.
        frames: of the B pairs.
        options: B of them, alike in kind, kernel and number of levels.
        state: where the pairs start from; in the end, where they stand.
    """
    pairs = list(range(len(options)))
    ready: tuple[object, Prepared] | None = None
    for steps in zip(*(option.steps for option in options), strict=True):
        pairs = [b for b in pairs if not state.failed[b]]
        voxels = {b: steps[b].voxel_size for b in pairs}
        if ready is None or ready[0] != voxels:
            thin = _thinned(source, target, voxels, state)
            pairs = [b for b in pairs if not state.failed[b]]
            if not pairs:
                return
            ready = (voxels if len(pairs) == len(voxels) else None, prepare(*thin, _of(frames, pairs)))
        elif not pairs:
            return
        part = _part(state, pairs)
        _run(ready[1], _of(frames, pairs), [options[b] for b in pairs], [steps[b] for b in pairs], part)
        write(state, pairs, part)


def prepare(source: Clouds, target: Clouds, frames: Frames) -> Prepared:
    """Bring B pairs into their centered frames and in Z order, and build the targets' trees."""
    source, target = _centered(source, frames.source_center), _centered(target, frames.target_center)
    return Prepared(source, target, tuple(few_nearest(target.points[i:j]) for i, j in spans(target.offsets)))


def _run(
    ready: Prepared, frames: Frames, options: Sequence[IcpOptions], steps: Sequence[IcpLevel], state: State
) -> None:
    """One level of all pairs."""
    source, device = ready.source, ready.source.device
    state.converged[:] = [False] * len(options)

    def numbers(values: Sequence[float]) -> Tensor:
        return torch.tensor(values, dtype=torch.float64, device=device)

    criteria = Criteria(
        max_distance=numbers([step.max_distance for step in steps]),
        kernel_scale=numbers([option.kernel_scale for option in options]),
        color_weight=numbers([option.color_weight for option in options]),
        iterations=[step.iterations for step in steps],
        relative_fitness=[option.relative_fitness for option in options],
        relative_rmse=[option.relative_rmse for option in options],
    )
    blocks = Blocks.of(source.lengths, device)
    estimator, values, extra = _estimator(ready, options[0], criteria.max_distance)
    searched = Target(values.t().contiguous(), tuple(i for i, _ in spans(ready.target.offsets)), ready.search)
    matches = Correspondence(blocks, blocks.fill(source.points), searched, criteria.max_distance)
    work = Work(matches, blocks.fill(extra), numbers(source.lengths))
    iterate(work, frames.target_center, estimator, criteria, state)


def _estimator(ready: Prepared, options: IcpOptions, max_distance: Tensor) -> tuple[Estimator, Tensor, Tensor]:
    """The kind of ICP, and what it needs to know of target points (N, A) and of source points (P, E)."""
    source, target, kernel = ready.source, ready.target, BY_NAME[options.kernel]
    nothing = source.points[:, :0]
    if target.normals is None or options.kind == "point_to_point":
        return point_to_point(kernel), target.points, nothing
    planes = torch.cat([target.points, target.normals], dim=1)  # (N, 6)
    if target.colors is None or source.colors is None or options.kind == "point_to_plane":
        return point_to_plane(kernel), planes, nothing
    intensity = intensity_of(target.colors)
    gradient = color_gradient(target, target.normals, intensity, 2 * max_distance.cpu())
    values = torch.cat([planes, gradient, intensity[:, None]], dim=1)  # (N, 10)
    return colored(kernel), values, intensity_of(source.colors)[:, None]


def _thinned(source: Clouds, target: Clouds, voxels: dict[int, float | None], state: State) -> tuple[Clouds, Clouds]:
    """The clouds of the pairs named, averaged over their voxels; a pair whose voxels cannot be numbered fails."""
    sources, targets = source.unpack(), target.unpack()
    found = []
    for b, size in voxels.items():
        if size is None:
            found.append((sources[b], targets[b]))
            continue
        try:
            found.append((voxel_downsample(sources[b], size), voxel_downsample(targets[b], size)))
        except ValueError as error:
            state.failed[b] = str(error)
    if not found:
        return source, target
    return Clouds.pack([one for one, _ in found]), Clouds.pack([other for _, other in found])


def _centered(clouds: Clouds, center: Tensor) -> Clouds:
    """Float64 points about the centers (B, 3), in Z order."""
    wide = clouds.to(dtype=torch.float64)
    lengths = torch.tensor(clouds.lengths, device=clouds.device)
    moved = wide.points - center.repeat_interleave(lengths, dim=0)
    order = morton_order(moved, clouds.offsets)
    return Clouds(
        points=moved[order],
        offsets=clouds.offsets,
        colors=None if wide.colors is None else wide.colors[order],
        normals=None if wide.normals is None else wide.normals[order],
    )


def _of(frames: Frames, pairs: list[int]) -> Frames:
    return Frames(*(zero[pairs] for zero in frames))


def _part(state: State, pairs: list[int]) -> State:
    """A copy of the state of some pairs."""
    return State(
        rotation=state.rotation[pairs],
        translation=state.translation[pairs],
        fitness=state.fitness[pairs],
        inlier_rmse=state.inlier_rmse[pairs],
        iterations=[state.iterations[b] for b in pairs],
        converged=[state.converged[b] for b in pairs],
        failed=[state.failed[b] for b in pairs],
    )


def write(state: State, pairs: list[int], part: State) -> None:
    """Put the state of some pairs back."""
    for name in ("rotation", "translation", "fitness", "inlier_rmse"):
        getattr(state, name)[pairs] = getattr(part, name)
    for name in ("iterations", "converged", "failed"):
        for b, value in zip(pairs, getattr(part, name), strict=True):
            getattr(state, name)[b] = value
