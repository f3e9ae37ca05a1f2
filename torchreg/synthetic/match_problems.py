"""Correspondence problems of known truth: matches of which a chosen share is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import at_least, expect, finite, fraction, one_of, positive
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.seeds import generator_of
from torchreg.types import Clouds, Correspondences

PLACES = ("cube", "room")

_ROOM = (1.0, 0.7, 0.4)  # of the size
_FURNITURE = ((0.1, 0.1, 0, 0.3, 0.1, 0.2), (0.7, 0.05, 0, 0.1, 0.3, 0.3), (0.4, 0.45, 0, 0.25, 0.15, 0.1))


@checked_record
@dataclass(frozen=True, eq=False)
class MatchProblem:
    """One pair of clouds with putative matches, and the truth about them.

    Attributes:
        source: batch of one cloud, M points.
        target: batch of one cloud, M points, in another order.
        matches: M correspondences; ``score`` is smaller for right ones on average, with much overlap.
        T_target_source: (1, 4, 4) float64, meters.
        is_inlier: (M,) bool, which matches are right.

    Example:
        >>> import torchreg as tr
        >>> problem = tr.synthetic.match_problem(100, 0.75)
        >>> int(problem.is_inlier.sum()), problem.T_target_source.shape
        (25, torch.Size([1, 4, 4]))
    """

    source: Clouds
    target: Clouds
    matches: Correspondences
    T_target_source: Tensor
    is_inlier: Tensor


@entry
def match_problem(
    count: int,
    outlier_ratio: float,
    *,
    place: str = "cube",
    size: float = 10.0,
    noise: float = 0.02,
    rival: float = 0.0,
    seed: int = 0,
    dtype: torch.dtype = torch.float64,
) -> MatchProblem:
    """Draw a problem.

    Args:
        count: correspondences, M.
        outlier_ratio: share of wrong ones.
        place: ``"cube"``: points anywhere in a cube. ``"room"``: on the walls and the furniture of a room, so that
            wrong matches agree by chance as those of scans do.
        size: meters, the edge of the cube or the length of the room.
        noise: meters, standard deviation per coordinate of right targets.
        rival: share of all matches, taken from the wrong ones, that agree on another motion: the true one after
            half a turn about the vertical through the middle.
        seed: of the draw, any integer.
        dtype: of the points.

    Returns:
        MatchProblem.

    Raises:
        ValueError: an argument out of range, or more rivals than wrong matches.

    Example:
        >>> from torchreg.synthetic import match_problem
        >>> int(match_problem(1000, 0.95).is_inlier.sum())
        50
    """
    at_least(count, "count", 1)
    fraction(outlier_ratio, "outlier_ratio", zero=True)
    fraction(rival, "rival", zero=True)
    one_of(place, "place", PLACES)
    positive(size, "size")
    expect(finite(noise, "noise") >= 0, "noise", "meters of at least 0", noise)
    wrong, rivals = round(outlier_ratio * count), round(rival * count)
    expect(rivals <= wrong, "rival", f"at most the share of wrong matches, {outlier_ratio}", rival)
    generator = generator_of(seed)
    draw = _in_cube if place == "cube" else _in_room
    p = size * draw(count, generator)
    T = rigid(random_rotation(generator), 5 * torch.randn(3, dtype=torch.float64, generator=generator))
    order = torch.randperm(count, generator=generator)
    world = p + noise * torch.randn(count, 3, dtype=torch.float64, generator=generator)
    world[order[:wrong]] = size * draw(wrong, generator)
    middle = size * torch.tensor([0.5, 0.5 * (1 if place == "cube" else _ROOM[1]), 0], dtype=torch.float64)
    turned = (p - middle) * torch.tensor([-1.0, -1, 1], dtype=torch.float64) + middle
    world[order[:rivals]] = turned[order[:rivals]]
    is_inlier = torch.ones(count, dtype=torch.bool)
    is_inlier[order[:wrong]] = False
    score = torch.rand(count, generator=generator) + 0.3 * (~is_inlier).float()
    target = torch.empty_like(p)
    rows = torch.randperm(count, generator=generator)
    target[rows] = apply_rotation(T[:3, :3], world) + T[:3, 3]
    matches = Correspondences(torch.arange(count), rows, torch.tensor([0, count]), score)
    return MatchProblem(Clouds(points=p.to(dtype)), Clouds(points=target.to(dtype)), matches, T[None], is_inlier)


def _in_cube(count: int, generator: torch.Generator) -> Tensor:
    return torch.rand(count, 3, dtype=torch.float64, generator=generator)


def _in_room(count: int, generator: torch.Generator) -> Tensor:
    """Points (M, 3) spread evenly over the faces of boxes."""
    boxes = torch.tensor([(0, 0, 0, *_ROOM), *_FURNITURE], dtype=torch.float64)
    low, edge = boxes[:, :3], boxes[:, 3:]
    area = torch.stack([edge[:, 1] * edge[:, 2], edge[:, 2] * edge[:, 0], edge[:, 0] * edge[:, 1]], dim=1)  # (B, 3)
    face = torch.multinomial(area.flatten(), max(1, count), replacement=True, generator=generator)[:count]
    box, axis = face // 3, face % 3
    where = torch.rand(count, 3, dtype=torch.float64, generator=generator)
    side = (torch.rand(count, generator=generator) < 0.5).double()
    where.scatter_(1, axis[:, None], side[:, None])
    return low[box] + where * edge[box]


def random_rotation(generator: torch.Generator) -> Tensor:
    """A rotation (3, 3) float64, uniform over SO(3), from a random unit quaternion."""
    w, x, y, z = torch.nn.functional.normalize(torch.randn(4, dtype=torch.float64, generator=generator), dim=0).tolist()
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.tensor(rows, dtype=torch.float64)
