"""Coarse to fine: the same loop on clouds of smaller and smaller voxels, with nearer and nearer correspondences."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
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
from torchreg.refinement.pairing import Pairing, among, numbered
from torchreg.refinement.point_to_plane import point_to_plane
from torchreg.refinement.point_to_point import point_to_point
from torchreg.types import Clouds
from torchreg.types.packing import spans


class Prepared(NamedTuple):
    """Clouds made ready: centered, float64, in Z order, and the searches in the points of every target."""

    source: Clouds
    target: Clouds
    search: tuple[Search, ...]
    pairing: Pairing


def refine_levels(
    source: Clouds,
    target: Clouds,
    pairing: Pairing,
    frames: Frames,
    options: Sequence[IcpOptions],
    state: State,
) -> None:
    """Take all pairs of ``state`` through the levels of their options.

    Args:
        source: clouds, finite and not empty.
        target: clouds likewise, with the normals and colors that the kind needs.
        pairing: which of them make up the B pairs.
        frames: of the B pairs.
        options: B of them, alike in kind, kernel and number of levels.
        state: where the pairs start from; in the end, where they stand.
    """
    pairs = list(range(len(options)))
    ready: tuple[object, Prepared] | None = None
    for steps in zip(*(option.steps for option in options), strict=True):
        pairs = [b for b in pairs if not state.failed[b]]
        if not pairs:
            return
        voxels = {b: steps[b].voxel_size for b in pairs}
        if ready is None or ready[0] != voxels:
            thin = _thinned(source, target, pairing, voxels, state)
            pairs = [b for b in pairs if not state.failed[b]]
            if not pairs:
                return
            ready = (voxels if len(pairs) == len(voxels) else None, prepare(*thin, _of(frames, pairs)))
        part = _part(state, pairs)
        _run(ready[1], _of(frames, pairs), [options[b] for b in pairs], [steps[b] for b in pairs], part)
        write(state, pairs, part)


def prepare(source: Clouds, target: Clouds, pairing: Pairing, frames: Frames) -> Prepared:
    """Bring the clouds of B pairs into their centered frames and in Z order, and build the targets' trees."""
    source = _centered(source, _of_clouds(frames.source_center, pairing.source, len(source)))
    target = _centered(target, _of_clouds(frames.target_center, pairing.target, len(target)))
    search = tuple(few_nearest(target.points[i:j]) for i, j in spans(target.offsets))
    return Prepared(source, target, search, pairing)


def _run(
    ready: Prepared, frames: Frames, options: Sequence[IcpOptions], steps: Sequence[IcpLevel], state: State
) -> None:
    """One level of all pairs."""
    device, (of_source, of_target) = ready.source.device, ready.pairing
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
    sources, first = [spans(ready.source.offsets)[b] for b in of_source], ready.target.offsets.tolist()
    lengths = [end - begin for begin, end in sources]
    rows = torch.cat([torch.arange(begin, end) for begin, end in sources]).to(device)
    blocks = Blocks.of(lengths, device)
    radius = _of_clouds(criteria.max_distance, of_target, len(ready.target))
    estimator, values, extra = _estimator(ready, options[0], radius)
    searched = Target(
        values.t().contiguous(), tuple(first[b] for b in of_target), tuple(ready.search[b] for b in of_target)
    )
    matches = Correspondence(blocks, blocks.fill(ready.source.points[rows]), searched, criteria.max_distance)
    work = Work(matches, blocks.fill(extra[rows]), numbers(lengths))
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


def _thinned(
    source: Clouds, target: Clouds, pairing: Pairing, voxels: dict[int, float | None], state: State
) -> tuple[Clouds, Clouds, Pairing]:
    """The clouds of the pairs named, averaged over their voxels; a pair whose voxels cannot be numbered fails."""
    one, other, numbers = among(source, target, pairing, list(voxels))
    if all(size is None for size in voxels.values()):
        return one, other, numbers
    sides = one.unpack(), other.unpack()

    @cache
    def thin(side: int, number: int, size: float | None) -> Clouds:
        return sides[side][number] if size is None else voxel_downsample(sides[side][number], size)

    keys: list[tuple[tuple[int, int, float | None], tuple[int, int, float | None]]] = []
    for (b, size), of_source, of_target in zip(voxels.items(), *numbers, strict=True):
        key = (0, of_source, size), (1, of_target, size)
        try:
            thin(*key[0]), thin(*key[1])
        except ValueError as error:
            state.failed[b] = str(error)
        else:
            keys.append(key)
    if not keys:
        return one, other, numbers
    (sources, of_sources), (targets, of_targets) = (numbered(side) for side in zip(*keys, strict=True))
    return (
        Clouds.pack([thin(*key) for key in sources]),
        Clouds.pack([thin(*key) for key in targets]),
        Pairing(of_sources, of_targets),
    )


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


def _of_clouds(values: Tensor, which: Sequence[int], clouds: int) -> Tensor:
    """What pairs have (B, ...) as what their clouds (S, ...) have; pairs that share a cloud have the same."""
    out = values.new_zeros(clouds, *values.shape[1:])
    out[list(which)] = values
    return out


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
