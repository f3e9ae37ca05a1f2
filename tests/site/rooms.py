"""Scans of a row of furnished rooms with thick walls and doors between them, by ray casting, with the exact truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from problems import seeded
from torch import Tensor

import torchreg as tr
from torchreg.geometry.se3 import apply_rotation, compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of
from torchreg.site.links import Link, loose_covariance

LENGTH, WIDTH, HEIGHT, WALL = 4.0, 5.0, 2.8, 0.15
"""Meters, of a room and of the walls between rooms."""


class Rooms(NamedTuple):
    """Scans with a scanner each, and the true poses (N, 4, 4)."""

    scans: list[tr.Clouds]
    poses: Tensor


class _Rectangles(NamedTuple):
    """Rectangles across one axis each."""

    axis: Tensor  # (Q,) int64
    at: Tensor  # (Q,) where on that axis
    low: Tensor  # (Q, 3), infinite on that axis
    high: Tensor  # (Q, 3)


def rooms(count: int, points: int = 12_000, *, noise: float = 0.004, seed: int = 0, furnished: bool = True) -> Rooms:
    """One scan in each of ``count`` rooms in a row along x, and one in each door between them, in any tilt."""
    generator = seeded(seed)
    scene = _scene(count, generator, furnished=furnished)
    scans, poses = [], []
    for number in range(2 * count - 1):
        x = (number // 2) * (LENGTH + WALL) + (LENGTH / 2 if number % 2 == 0 else LENGTH + WALL / 2)
        jitter = 0.3 * (torch.rand(3, generator=generator, dtype=torch.float64) - 0.5)
        place = torch.tensor([x, WIDTH / 2, 1.5], dtype=torch.float64) + jitter * (1 if number % 2 == 0 else 0.3)
        turn = torch.tensor([0.0, 0.0, math.pi], dtype=torch.float64) * torch.rand(1, generator=generator).double()
        tilt = 0.02 * torch.randn(3, generator=generator, dtype=torch.float64)
        pose = rigid(rotation_of(turn) @ rotation_of(tilt), place)
        scans.append(_scan(scene, pose, points, noise, generator))
        poses.append(pose)
    return Rooms(scans, torch.stack(poses))


def rough_links(made: Rooms, pairs: list[tuple[int, int]], meters: float = 0.02, seed: int = 5) -> list[Link]:
    """Links of pairs (target, source) that are off by deviations of ``meters`` and as much at 5 m in their turn."""
    generator = seeded(seed)
    links = []
    for target, source in pairs:
        T = compose(inverse(made.poses[target]), made.poses[source])
        turn = meters / 5 * torch.randn(3, generator=generator, dtype=torch.float64)
        shift = meters * torch.randn(3, generator=generator, dtype=torch.float64)
        R, middle = rotation_of(turn), T[:3, 3] / 2
        error = rigid(R, middle - apply_rotation(R, middle) + shift)
        links.append(
            Link(
                target=target,
                source=source,
                T_target_source=compose(error, T),
                log_odds=5.0,
                probability=0.99,
                covariance=loose_covariance(meters, 5.0),
                center=middle,
            )
        )
    return links


def best_fit(T_world_scan: Tensor, truth: Tensor) -> Tensor:
    """Meters (N,) between scanners and true ones after the rigid motion that lays them and their axes on each other."""
    ends = torch.cat([torch.eye(3), -torch.eye(3)]).double() * 3.0
    one, other = ((T[:, :3, :3] @ ends.t()).transpose(1, 2) + T[:, None, :3, 3] for T in (T_world_scan, truth))
    motion = tr.kabsch(one.reshape(-1, 3), other.reshape(-1, 3))
    return (compose(motion, T_world_scan) - truth)[:, :3, 3].norm(dim=1)


def _scene(count: int, generator: torch.Generator, *, furnished: bool) -> _Rectangles:
    low, high = [], []  # of solid boxes
    end = count * (LENGTH + WALL)
    low += [[-WALL, -WALL, -0.2], [-WALL, -WALL, HEIGHT], [-WALL, -WALL, 0], [-WALL, WIDTH, 0]]
    high += [[end, WIDTH + WALL, 0], [end, WIDTH + WALL, HEIGHT + 0.2], [end, 0, HEIGHT], [end, WIDTH + WALL, HEIGHT]]
    for number in range(-1, count):
        x = number * (LENGTH + WALL) + LENGTH
        door = [] if number in (-1, count - 1) else [(WIDTH / 2 - 0.5, WIDTH / 2 + 0.5)]
        edges = [0.0, *(edge for pair in door for edge in pair), WIDTH]
        for y0, y1 in zip(edges[::2], edges[1::2], strict=True):
            low.append([x, y0, 0])
            high.append([x + WALL, y1, HEIGHT])
        if door:
            low.append([x, door[0][0], 2.1])
            high.append([x + WALL, door[0][1], HEIGHT])
    for number in range(count if furnished else 0):
        for side in (0, 1):
            for _ in range(2):
                a, b, c, d = torch.rand(4, generator=generator).tolist()
                x = number * (LENGTH + WALL) + 0.1 + 2.9 * a
                deep, wide, tall = 0.3 + 0.4 * b, 0.4 + 0.5 * c, 0.4 + 1.4 * d
                y = 0.0 if side == 0 else WIDTH - deep
                low.append([x, y, 0])
                high.append([x + wide, y + deep, tall])
    boxes_low, boxes_high = (torch.tensor(each, dtype=torch.float64) for each in (low, high))
    parts = []
    for axis in range(3):
        for at in (boxes_low, boxes_high):
            spread = boxes_low.clone(), boxes_high.clone()
            spread[0][:, axis], spread[1][:, axis] = -torch.inf, torch.inf
            parts.append(_Rectangles(torch.full((len(at),), axis), at[:, axis], *spread))
    return _Rectangles(*(torch.cat(each) for each in zip(*parts, strict=True)))


def _scan(scene: _Rectangles, pose: Tensor, points: int, noise: float, generator: torch.Generator) -> tr.Clouds:
    rays = torch.nn.functional.normalize(torch.randn(points, 3, generator=generator, dtype=torch.float64), dim=1)
    rays = rays[rays[:, 2] > -0.87]  # the tripod is below
    ahead, place = apply_rotation(pose[:3, :3], rays), pose[:3, 3]
    reach = torch.full((len(rays),), torch.inf, dtype=torch.float64)
    for axis, at, low, high in zip(*scene, strict=True):
        distance = (at - place[axis]) / ahead[:, axis]
        hit = place + distance[:, None] * ahead
        inside = ((hit >= low) & (hit <= high)).all(dim=1) & (distance > 0.05)
        reach = torch.where(inside, torch.minimum(reach, distance), reach)
    reach = reach + noise * torch.randn(len(rays), generator=generator, dtype=torch.float64)
    seen = reach < 30.0
    return tr.Clouds(points=(reach[:, None] * rays)[seen].float(), viewpoint=torch.zeros(1, 3))
