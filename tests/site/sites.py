"""Graphs of made sites with known poses."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from problems import seeded
from torch import Tensor

from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of, rotation_vector
from torchreg.site import SiteResult
from torchreg.site.links import Link
from torchreg.synthetic.match_problems import random_rotation

TURN, SHIFT = math.radians(0.03), 0.004
"""Deviations of right links: radians, meters."""


class MadeSite(NamedTuple):
    """Links, which of them are right, and the true poses (N, 4, 4)."""

    links: list[Link]
    right: list[bool]
    poses: Tensor


def made_poses(count: int, seed: int = 0, *, floors: int = 1, spacing: float = 8.0) -> Tensor:
    """Scanners in a building, one per ``spacing`` squared on every floor, turned in any way about the vertical."""
    generator = seeded(seed)
    each = -(-count // floors)
    side = spacing * math.sqrt(each)
    places = torch.rand(count, 3, dtype=torch.float64, generator=generator) * torch.tensor([side, side, 0.5])
    places[:, 2] += 3.0 * torch.arange(count).div(each, rounding_mode="floor")
    angles = torch.zeros(count, 3, dtype=torch.float64)
    angles[:, 2] = 2 * math.pi * torch.rand(count, dtype=torch.float64, generator=generator)
    return rigid(rotation_of(angles), places)


def near_pairs(poses: Tensor, pairs: int) -> list[tuple[int, int]]:
    """The ``pairs`` pairs of scanners that are nearest to each other."""
    places = poses[:, :3, 3]
    i, j = torch.triu_indices(len(poses), len(poses), 1)
    order = (places[i] - places[j]).norm(dim=1).argsort(stable=True)[:pairs]
    return list(zip(i[order].tolist(), j[order].tolist(), strict=True))


def right_link(
    poses: Tensor,
    pair: tuple[int, int],
    generator: torch.Generator,
    log_odds: float = 4.0,
    noise: float = 1.0,
    **more: object,
) -> Link:
    """The true link of a pair with ``noise`` times the noise that its covariance promises."""
    target, source = pair
    T = compose(inverse(poses[target]), poses[source])
    center = T[:3, 3] / 2
    turn = noise * TURN * torch.randn(3, dtype=torch.float64, generator=generator)
    shift = noise * SHIFT * torch.randn(3, dtype=torch.float64, generator=generator)
    error = rigid(rotation_of(turn), shift + center - rotation_of(turn) @ center)
    return link_of(pair, compose(error, T), log_odds, center=center, **more)


def wrong_link(pair: tuple[int, int], generator: torch.Generator, log_odds: float = 0.0, **more: object) -> Link:
    """A pose that has nothing to do with the truth."""
    T = rigid(random_rotation(generator), 5 * torch.randn(3, dtype=torch.float64, generator=generator))
    return link_of(pair, T, log_odds, **more)


def link_of(pair: tuple[int, int], T: Tensor, log_odds: float, **more: object) -> Link:
    """A link with the covariance of right ones."""
    covariance = torch.tensor([TURN**2] * 3 + [SHIFT**2] * 3, dtype=torch.float64).diag()
    fields = {"probability": 1 / (1 + math.exp(-log_odds)), **more}
    return Link(target=pair[0], source=pair[1], T_target_source=T, log_odds=log_odds, covariance=covariance, **fields)


def made_site(
    count: int = 40,
    pairs: int = 160,
    wrong: float = 0.2,
    seed: int = 0,
    *,
    odds: tuple[float, float] = (4.0, 1.5),
    wrong_odds: tuple[float, float] = (0.5, 1.5),
    floors: int = 1,
) -> MadeSite:
    """A site of which a share ``wrong`` of the links is wrong: half between near scans, half between any."""
    generator = seeded(seed + 1)
    poses = made_poses(count, seed, floors=floors)
    near = near_pairs(poses, pairs)
    bad = round(wrong * len(near))
    mixed = [near[k] for k in torch.randperm(len(near), generator=generator).tolist()]
    taken = set(mixed[bad // 2 :])
    links, right = [], []

    def drawn(mean: float, spread: float) -> float:
        return mean + spread * float(torch.randn((), generator=generator))

    for pair in mixed[bad:]:
        links.append(right_link(poses, pair, generator, drawn(*odds)))
        right.append(True)
    for number in range(bad):
        pair = mixed[number]
        while number < bad // 2 and (pair in taken or pair[0] == pair[1]):
            one, other = torch.randint(count, (2,), generator=generator).tolist()
            pair = (min(one, other), max(one, other))
        taken.add(pair)
        links.append(wrong_link(pair, generator, drawn(*wrong_odds)))
        right.append(False)
    return MadeSite(links, right, poses)


def look_alike_site(
    count: int, pairs: int, alike: int, between: int, seed: int = 0, *, floors: int = 3, odds: float = 4.0
) -> MadeSite:
    """Floors of one plan: ``alike`` links take scans of one floor for those of another, ``between`` are right.

    The wrong ones agree with each other; their log-odds are lower, 0.5 in the mean.
    """
    generator = seeded(seed + 2)
    poses = made_poses(count, seed, floors=floors)
    floor = torch.arange(count).div(-(-count // floors), rounding_mode="floor")
    flat = poses.clone()
    flat[:, 2, 3] -= 3.0 * floor
    near = near_pairs(flat, 20 * (pairs + alike + between))
    same = [pair for pair in near if floor[pair[0]] == floor[pair[1]]][:pairs]
    other = [pair for pair in near if abs(int(floor[pair[0]] - floor[pair[1]])) == 1]
    stairs = sorted(other, key=lambda pair: float(flat[pair[0], :2, 3].norm() + flat[pair[1], :2, 3].norm()))
    right = stairs[:between]
    wrong = [pair for pair in other if pair not in right][:alike]

    def drawn(mean: float, spread: float) -> float:
        return mean + spread * float(torch.randn((), generator=generator))

    links = [right_link(poses, pair, generator, drawn(odds, 1.5)) for pair in same + right]
    links += [right_link(flat, pair, generator, drawn(0.5, 1.0)) for pair in wrong]
    return MadeSite(links, [True] * len(same + right) + [False] * len(wrong), poses)


def errors(T_world_scan: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    """Meters and degrees (K,) between poses and true ones, in the frame of that scan with which most are right."""
    best = None
    for one in range(len(truth)):
        motion = compose(truth[one], inverse(T_world_scan[one]))
        off = compose(inverse(truth), compose(motion, T_world_scan))
        meters = off[:, :3, 3].norm(dim=1)
        if best is None or meters.median() < best[0].median():
            best = meters, torch.rad2deg(rotation_vector(off[:, :3, :3]).norm(dim=1))
    return best


def site_of_poses(poses: Tensor, group: list[int]) -> SiteResult:
    """A result with these poses (N, 4, 4) and groups, and no links."""
    count = len(group)
    return SiteResult(
        T_world_scan=poses,
        group=torch.tensor(group),
        covariance=torch.zeros(count, 6, 6, dtype=torch.float64),
        center=torch.zeros(count, 3, dtype=torch.float64),
        reason=("",) * count,
        notes=((),) * count,
        links=(),
        pairs=(),
        scale=1.0,
        doubt=0.0,
        control=(),
        remarks=(),
        seconds=(),
    )
