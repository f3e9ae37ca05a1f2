"""One scan as the verification sees it: an even choice of its points, a search tree over all, a range image."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.neighborhoods.point_index import PointIndex
from torchreg.types import Clouds
from torchreg.verification.free_space import RangeImage, range_image


class View(NamedTuple):
    """One scan, prepared.

    Attributes:
        points: (P, 3) float32, meters.
        normals: (P, 3) or ``None``.
        colors: (P, 3) or ``None``.
        origin: (3,) float64, meters, where the points' zero lies in the frame of the file.
        faced: whether the normals point to a known scanner.
        sample: (N,) int64, the rows that are looked at, evenly along the order of the points.
        tree: over all points.
        image: what the scanner saw, ``None`` where its place is not known.
    """

    points: Tensor
    normals: Tensor | None
    colors: Tensor | None
    origin: Tensor
    faced: bool
    sample: Tensor
    tree: PointIndex
    image: RangeImage | None


def view(cloud: Clouds, spacing: float, sample: int) -> View:
    """Prepare one cloud (a batch of one), points ``spacing`` meters apart, of which ``sample`` are looked at."""
    points = cloud.points.detach().float()
    count = min(sample, len(points))
    rows = torch.arange(count, device=points.device) * len(points) // max(count, 1)
    image = None if cloud.viewpoint is None else range_image(points, cloud.viewpoint[0].float(), spacing)
    normals = None if cloud.normals is None else cloud.normals.detach().float()
    colors = None if cloud.colors is None else cloud.colors.detach().float()
    faced = cloud.viewpoint is not None and bool(torch.isfinite(cloud.viewpoint).all())
    return View(points, normals, colors, cloud.origin[0], faced, rows, PointIndex(points), image)
