"""Registration problems with known truth: correspondences of a given outlier ratio, and small colored rooms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torchreg as tr
from torchreg.geometry.se3 import rigid
from torchreg.synthetic.match_problems import MatchProblem, match_problem, random_rotation
from torchreg.types.packing import offsets_of


class RoomPair(NamedTuple):
    """Two scans of one room, each in the frame of its scanner.

    Attributes:
        source: B = 1, with colors and viewpoint.
        target: B = 1, likewise.
        T_target_source: (1, 4, 4) float64, true.
    """

    source: tr.Clouds
    target: tr.Clouds
    T_target_source: Tensor


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def numbers(*shape: int, seed: int = 0) -> Tensor:
    """Normal numbers in float64, other ones for every seed and size."""
    return torch.randn(shape, dtype=torch.float64, generator=seeded(seed + sum(shape)))


def uniform(*shape: int, seed: int = 0) -> Tensor:
    """Numbers in [0, 1) in float32, other ones for every seed and size."""
    return torch.rand(shape, generator=seeded(seed + sum(shape)))


def random_points(count: int, seed: int = 0, dtype: torch.dtype = torch.float32) -> Tensor:
    """Points (P, 3) in a cube of 1 m."""
    return torch.rand(count, 3, generator=seeded(seed), dtype=dtype)


def turned(
    degrees: float, axis: Sequence[float] = (0.0, 0.0, 1.0), translation: Sequence[float] = (0.0, 0.0, 0.0)
) -> Tensor:
    """A turn about an axis by Rodrigues' formula, then a shift in meters: (4, 4) float64."""
    x, y, z = torch.nn.functional.normalize(torch.tensor(axis, dtype=torch.float64), dim=0).tolist()
    K = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    angle = math.radians(degrees)
    R = torch.eye(3, dtype=torch.float64) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K
    return rigid(R, torch.tensor(translation, dtype=torch.float64))


def random_transform(generator: torch.Generator, reach: float = 5.0) -> Tensor:
    """A rigid transform (4, 4) float64 with translations of some ``reach`` meters."""
    return rigid(random_rotation(generator), reach * _normal(generator, 3))


def correspondence_problem(
    count: int = 500, outlier_ratio: float = 0.8, *, noise: float = 0.01, **options: Any
) -> MatchProblem:
    """A ``match_problem`` of middling size, as most tests need it."""
    return match_problem(count, outlier_ratio, noise=noise, **options)


def columns(problem: MatchProblem, dtype: torch.dtype | None = None) -> tuple[Tensor, Tensor]:
    """Source and target points (3, M) of the matches."""
    source = problem.source.points[problem.matches.source].t().contiguous()
    target = problem.target.points[problem.matches.target].t().contiguous()
    return source.to(dtype), target.to(dtype)


def features(values: Tensor, lengths: list[int] | None = None, valid: Tensor | None = None) -> tr.Features:
    """Features of one block, all valid by default."""
    valid = torch.ones(len(values), dtype=torch.bool) if valid is None else valid
    offsets = offsets_of([len(values)] if lengths is None else lengths)
    return tr.Features(values, offsets, (("any", values.shape[1]),), valid)


def matched(source: Tensor, target: Tensor) -> tr.Correspondences:
    """Matches of one pair, all with score zero."""
    return tr.Correspondences(source, target, torch.tensor([0, len(source)]), torch.zeros(len(source)))


def pack_problems(problems: list[MatchProblem]) -> tuple[tr.Clouds, tr.Clouds, tr.Correspondences]:
    """The batch of several problems, rows of their matches shifted to the packed clouds."""
    source = tr.Clouds.pack([problem.source for problem in problems])
    target = tr.Clouds.pack([problem.target for problem in problems])
    first_source, first_target = source.offsets.tolist(), target.offsets.tolist()
    matches = tr.Correspondences(
        torch.cat([problem.matches.source + first_source[b] for b, problem in enumerate(problems)]),
        torch.cat([problem.matches.target + first_target[b] for b, problem in enumerate(problems)]),
        offsets_of(len(problem.matches.source) for problem in problems),
        torch.cat([problem.matches.score for problem in problems]),
    )
    return source, target, matches


def room_pair(
    count: int = 6000,
    *,
    seed: int = 0,
    noise: float = 0.002,
    scale: float = 1.0,
    dtype: torch.dtype = torch.float32,
) -> RoomPair:
    """Two scans of a furnished room of 6 x 4.5 x 2.7 m times ``scale``, from two places.

    Each scan draws ``count`` points of its own and keeps those on faces that look at the scanner, about 87 %.
    """
    generator = torch.Generator().manual_seed(seed)
    T_source_world, T_target_world = (random_transform(generator, reach=2.0) for _ in range(2))
    places = torch.tensor([[2.2, 1.7, 1.6], [3.6, 2.9, 1.5]], dtype=torch.float64)
    source = _scan(count, places[0], T_source_world, noise, scale, generator, dtype)
    target = _scan(count, places[1], T_target_world, noise, scale, generator, dtype)
    return RoomPair(source, target, (T_target_world @ torch.linalg.inv(T_source_world))[None])


class RoomSite(NamedTuple):
    """Several scans of one room, each in the frame of its scanner, and their true poses (N, 4, 4) float64."""

    scans: list[tr.Clouds]
    T_world_scan: Tensor


def room_site(count: int = 3, *, points: int = 3000, seed: int = 0) -> RoomSite:
    """Scans of the room of ``room_pair`` from places of its middle."""
    generator = torch.Generator().manual_seed(seed)
    low, high = torch.tensor([[2.2, 1.6, 1.2], [4.1, 3.2, 1.7]], dtype=torch.float64)
    scans, poses = [], []
    for _ in range(count):
        place = low + (high - low) * torch.rand(3, dtype=torch.float64, generator=generator)
        T_scan_world = random_transform(generator, reach=2.0)
        scans.append(_scan(points, place, T_scan_world, 0.002, 1.0, generator, torch.float32))
        poses.append(torch.linalg.inv(T_scan_world))
    return RoomSite(scans, torch.stack(poses))


def oriented_room(
    count: int = 600, seed: int = 0, dtype: torch.dtype = torch.float32
) -> tuple[tr.Clouds, tr.Neighborhoods]:
    """One scan of a room with normals, and neighborhoods of 1 m in it."""
    scan = room_pair(count, seed=seed, dtype=dtype).source
    near = tr.neighbors(scan, 1.0, 40)
    return tr.estimate_normals(scan, near), near


def sphere_cloud(count: int, *, seed: int = 0, dtype: torch.dtype = torch.float64) -> tr.Clouds:
    """A bumpy colored sphere of about 1 m with its true-looking normals: no planes, no ties."""
    generator = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(_normal(generator, count, 3), dim=1)
    x, y, z = direction.unbind(1)
    radius = 1 + 0.2 * torch.sin(5 * x + 1) * torch.cos(4 * y) + 0.1 * torch.sin(7 * z)
    tilted = torch.nn.functional.normalize(direction + 0.3 * _normal(generator, count, 3), dim=1)
    colors = torch.rand(count, 3, dtype=torch.float64, generator=generator)
    return tr.Clouds(points=(radius[:, None] * direction).to(dtype), colors=colors.to(dtype), normals=tilted.to(dtype))


def plane_cloud(count: int, size: float, *, seed: int = 0) -> tr.Clouds:
    """Points drawn evenly over a square of ``size`` meters, float32, without colors."""
    generator = torch.Generator().manual_seed(seed)
    points = size * torch.rand(count, 3, generator=generator)
    points[:, 2] = 0
    return tr.Clouds(points=points)


def garbage_in_invalid_slots(near: tr.Neighborhoods, seed: int = 0) -> tr.Neighborhoods:
    """The same neighborhoods with other rows and distances where nothing is valid."""
    index = torch.randint(len(near), near.index.shape, generator=torch.Generator().manual_seed(seed))
    garbage = torch.full_like(near.sq_distance, 3.25)
    return replace(
        near,
        index=torch.where(near.valid, near.index, index),
        sq_distance=torch.where(near.valid, near.sq_distance, garbage),
    )


def _normal(generator: torch.Generator, *shape: int) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=generator)


def _scan(
    count: int,
    place: Tensor,
    T_scan_world: Tensor,
    noise: float,
    scale: float,
    generator: torch.Generator,
    dtype: torch.dtype,
) -> tr.Clouds:
    """Points of the faces that look at ``place``, drawn evenly by area, with noise, in the frame of the scan."""
    corner, first, second, hue = _faces()
    normal = torch.linalg.cross(first, second)
    area = torch.linalg.vector_norm(normal, dim=1)
    face = torch.multinomial(area, count, replacement=True, generator=generator)
    u, v = torch.rand(2, count, dtype=torch.float64, generator=generator)
    points = corner[face] + u[:, None] * first[face] + v[:, None] * second[face]
    seen = ((place - points) * normal[face]).sum(dim=1) > 0
    colors = _painted(hue[face], points)[seen]
    points = scale * (points[seen] + noise * _normal(generator, int(seen.sum()), 3))
    R, t = T_scan_world[:3, :3], T_scan_world[:3, 3]
    return tr.Clouds(
        points=(points @ R.t() + t).to(dtype),
        colors=colors.to(dtype),
        viewpoint=(R @ (scale * place) + t)[None].to(dtype),
    )


def _painted(hue: Tensor, points: Tensor) -> Tensor:
    """Saturated colors whose hue and brightness change along the walls."""
    x, y, z = points.unbind(1)
    turned = hue + 0.12 * torch.sin(1.7 * x + 0.4) + 0.1 * torch.cos(2.3 * y) + 0.08 * torch.sin(3.1 * z)
    value = 0.65 + 0.2 * torch.sin(2.9 * x + 1.3 * z) + 0.1 * torch.cos(3.7 * y)
    channels = [0.5 + 0.5 * torch.cos(2 * math.pi * (turned - shift / 3)) for shift in range(3)]
    return (torch.stack(channels, dim=1) * value[:, None]).clamp(0, 1)


def _faces() -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Corners, two edges (F, 3) each and hue (F,); the cross product of the edges looks into the free space."""
    faces = _box((0, 0, 0), (6, 4.5, 2.7), inward=True, hue=0.1)
    faces += _box((0.3, 0.2, 0), (1.6, 0.8, 0.9), inward=False, hue=0.5)
    faces += _box((4.4, 0.1, 0), (0.7, 1.9, 2.1), inward=False, hue=0.75)
    faces += _box((1.0, 3.3, 0), (1.2, 1.0, 0.5), inward=False, hue=0.3)
    faces += _box((4.9, 3.6, 0), (0.8, 0.7, 1.3), inward=False, hue=0.9)
    corner, first, second, hue = zip(*faces, strict=True)
    return tuple(torch.tensor(part, dtype=torch.float64) for part in (corner, first, second, hue))


def _box(
    low: tuple[float, ...], size: tuple[float, ...], *, inward: bool, hue: float
) -> list[tuple[list[float], list[float], list[float], float]]:
    faces = []
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        for high in (False, True):
            corner = list(map(float, low))
            corner[axis] += size[axis] if high else 0.0
            first, second = [0.0] * 3, [0.0] * 3
            first[i], second[j] = size[i], size[j]
            if high == inward:  # e_i x e_j = e_axis: outward on the high side
                first, second = second, first
            faces.append((corner, first, second, hue + 0.07 * len(faces)))
    return faces
