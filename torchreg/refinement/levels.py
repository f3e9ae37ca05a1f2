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
from torchreg.refinement.correspond import FEW, Search, Target, few_nearest
from torchreg.refinement.kernels import KERNELS, least_squares
from torchreg.refinement.loop import ActivePairs, Criteria, State, iterate
from torchreg.refinement.metric_search import MetricSearch
from torchreg.refinement.options import KINDS, IcpLevel, IcpOptions
from torchreg.refinement.pairing import Frames, Pairing, among, numbered
from torchreg.refinement.tree_correspond import correspondences
from torchreg.types import Clouds, Failure
from torchreg.types.packing import spans


class Prepared(NamedTuple):
    """Clouds centered, in float64 and in Z order, and the search in the points of every target."""

    source: Clouds
    target: Clouds
    search: tuple[Search, ...]  # in space
    pairing: Pairing


def refine_levels(
    source: Clouds,
    target: Clouds,
    pairing: Pairing,
    frames: Frames,
    options: Sequence[IcpOptions],
    state: State,
) -> None:
    """Refine all B pairs of ``state``, in place, level by level.

    The clouds are finite, not empty, and have what the kind needs; the options are alike in kind, kernel and number of
    levels.
    """
    pairs = list(range(len(options)))
    prepared: tuple[object, Prepared] | None = None
    for steps in zip(*(option.steps for option in options), strict=True):
        pairs = [b for b in pairs if not state.failed[b]]
        if not pairs:
            return
        voxels = {b: steps[b].voxel_size for b in pairs}
        if prepared is None or prepared[0] != voxels:
            thin = _thinned(source, target, pairing, voxels, state)
            pairs = [b for b in pairs if not state.failed[b]]
            if not pairs:
                return
            prepared = (voxels if len(pairs) == len(voxels) else None, prepare(*thin, frames.of(pairs)))
        part = state.of(pairs)
        _run(prepared[1], frames.of(pairs), [options[b] for b in pairs], [steps[b] for b in pairs], part)
        state.write(pairs, part)


def prepare(source: Clouds, target: Clouds, pairing: Pairing, frames: Frames) -> Prepared:
    """Bring the clouds of B pairs into their centered frames and in Z order, and build the targets' trees."""
    source = _centered(source, _of_clouds(frames.source_center, pairing.source, len(source)))
    target = _centered(target, _of_clouds(frames.target_center, pairing.target, len(target)))
    search = tuple(few_nearest(target.points[i:j]) for i, j in spans(target.offsets))
    return Prepared(source, target, search, pairing)


def _run(
    clouds: Prepared, frames: Frames, options: Sequence[IcpOptions], steps: Sequence[IcpLevel], state: State
) -> None:
    """One level of all pairs."""
    device, (of_source, of_target) = clouds.source.device, clouds.pairing
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
    kind, kernel = KINDS[options[0].kind], options[0].kernel
    estimator = kind.estimator(least_squares if kernel is None else KERNELS[kernel])
    sources, first = [spans(clouds.source.offsets)[b] for b in of_source], clouds.target.offsets.tolist()
    lengths = [end - begin for begin, end in sources]
    rows = torch.cat([torch.arange(begin, end) for begin, end in sources]).to(device)
    blocks = Blocks.of(lengths, device)
    max_distance = _of_clouds(criteria.max_distance, of_target, len(clouds.target))
    values, extra = kind.columns(clouds.source, clouds.target, max_distance)
    points, search = clouds.source.points[rows], clouds.search
    if kind.beside is not None:
        scale = numbers([option.color_scale or step.max_distance for option, step in zip(options, steps, strict=True)])
        of_rows = scale.repeat_interleave(torch.tensor(lengths, device=device))[:, None]
        points = torch.cat([points, of_rows * kind.beside(clouds.source)[rows]], dim=1)
        values = _with_axes(values, kind.beside(clouds.target), _of_clouds(scale, of_target, len(first) - 1), first)
        axes = points.shape[1]
        limits = max_distance.tolist()  # which later iterations only lower
        parts = zip(spans(clouds.target.offsets), limits, strict=True)
        search = tuple(MetricSearch(values[i:j, :axes], FEW, limit) for (i, j), limit in parts)
    searched = Target(values.t().contiguous(), tuple(first[b] for b in of_target), tuple(search[b] for b in of_target))
    matches = correspondences(blocks, blocks.fill(points), searched, criteria.max_distance)
    active = ActivePairs(matches, blocks.fill(extra[rows]), numbers(lengths))
    iterate(active, frames.target_center, estimator, criteria, state)


def _with_axes(values: Tensor, beside: Tensor, scale: Tensor, first: Sequence[int]) -> Tensor:
    """Columns (N, A) of target points with further coordinates (N, E) after x, y, z, scaled (T,) by their clouds."""
    counts = torch.tensor(first, device=values.device).diff()
    return torch.cat([values[:, :3], scale.repeat_interleave(counts)[:, None] * beside, values[:, 3:]], dim=1)


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
            state.failed[b] = Failure("too wide", str(error))
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
    """Values of pairs (B, ...) as values of their clouds (S, ...); pairs that share a cloud have the same value."""
    out = values.new_zeros(clouds, *values.shape[1:])
    out[list(which)] = values
    return out
