"""Random crops: what lies on one side of a plane, in a box or in a sphere, of a size that keeps a share of points."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.augment.augmentation import Augmentation, Tracked, checked_range, uniform, unmoved
from torchreg.augment.rows import count_of, kept_rows
from torchreg.errors import one_of
from torchreg.types import Clouds


class RandomCrop(Augmentation):
    """Keeps the points in a random region, and exactly the share drawn: ``ceil(share * points)``, at least one.

    A plane lies across a random direction; a box and a sphere lie about a random point of the cloud, the box turned at
    random about z, with edges of random proportions between 1 and 2. Rows keep their order; of points equally far,
    the first stay. Gradients flow to the values of the rows that stay. Nothing is read back from the device.

    Args:
        keep: the share of points that stays is drawn evenly from this range, in [0, 1].
        shape: ``"plane"``, ``"box"`` or ``"sphere"``.
        probability: as for ``Augmentation``.
        generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range.

    Example:
        >>> crop = RandomCrop(keep=(0.5, 0.5), shape="sphere")
        >>> crop(Clouds(torch.rand(100, 3))).lengths
        [50]
    """

    def __init__(
        self,
        *,
        keep: tuple[float, float] = (0.6, 1.0),
        shape: str = "plane",
        probability: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        self.keep = checked_range(keep, "keep", 0, 1)
        self.shape = one_of(shape, "shape", tuple(_DEPTHS))
        self._depth = _DEPTHS[self.shape]

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """The points that lie least deep outside of the region's middle."""
        count = count_of(uniform(*self.keep, draw), len(cloud.points))
        depth = self._depth(cloud.points.detach().double(), draw)
        return Tracked(kept_rows(cloud, depth, count), unmoved(cloud))

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return f"keep={self.keep}, shape={self.shape!r}, probability={self.probability}"


def _along_direction(points: Tensor, draw: torch.Generator) -> Tensor:
    way = torch.nn.functional.normalize(torch.randn(3, generator=draw, dtype=torch.float64), dim=0)
    return (points * way.to(points.device)).sum(dim=1)


def _from_point(points: Tensor, draw: torch.Generator) -> Tensor:
    return _about_point(points, draw).square().sum(dim=1)


def _in_boxes(points: Tensor, draw: torch.Generator) -> Tensor:
    away = _about_point(points, draw)
    yaw, edges = uniform(-math.pi, math.pi, draw), 1 + torch.rand(3, generator=draw, dtype=torch.float64)
    x, y, z = away.unbind(1)
    turned = torch.stack([math.cos(yaw) * x - math.sin(yaw) * y, math.sin(yaw) * x + math.cos(yaw) * y, z], dim=1)
    return (turned.abs() / edges.to(points.device)).amax(dim=1)


def _about_point(points: Tensor, draw: torch.Generator) -> Tensor:
    row = torch.randint(len(points), (1,), generator=draw).to(points.device)
    return points - points[row]


_DEPTHS = {"plane": _along_direction, "box": _in_boxes, "sphere": _from_point}
