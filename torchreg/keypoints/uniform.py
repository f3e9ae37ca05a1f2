"""Uniform keypoints: of every voxel the point nearest to its center, as PCL's ``UniformSampling`` takes it.

Unlike voxel means they are points of the cloud. PCL counts voxels from zero; here the grid starts half a voxel below
the least coordinates of a cloud, as that of ``voxel_downsample``, so that it moves with the cloud.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import positive
from torchreg.keypoints.keypoints import KeypointRows, Keypoints, rows_of_clouds
from torchreg.preprocess.downsample import sizes_of_clouds, voxel_numbers
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.lengths import length
from torchreg.types.packing import spans


@entry
def uniform_keypoints(cloud: Clouds, voxel_size: float | Tensor) -> KeypointRows:
    """Select of every voxel the point nearest to its center, ties to the lower row.

    Args:
        cloud: B clouds.
        voxel_size: meters, the edge of a cube: a number, or one per cloud (B,).

    Returns:
        KeypointRows. The same for any batch and number of threads. No gradients.

    Raises:
        ValueError: ``voxel_size`` not above 0, or so small against the extent that voxels cannot be numbered.

    Example:
        >>> cloud = Clouds(points=torch.tensor([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [1.0, 0.0, 0.0]]))
        >>> uniform_keypoints(cloud, 1.0).rows
        tensor([0, 2])
    """
    sizes = sizes_of_clouds(voxel_size, cloud)
    points = [cloud.points[begin:end].detach().double() for begin, end in spans(cloud.offsets)]
    return rows_of_clouds(cloud, list(map(_nearest_to_centers, points, sizes)))


@checked_record
@dataclass(frozen=True, kw_only=True)
class UniformKeypoints(Keypoints):
    """``torchreg.uniform_keypoints``: one point of every voxel.

    Attributes:
        voxel_size: meters, the edge of a cube.

    Raises:
        ValueError: ``voxel_size`` not above 0.

    Example:
        >>> import torchreg as tr
        >>> from dataclasses import replace
        >>> options = replace(tr.options_for(spacing=0.05), keypoints=tr.UniformKeypoints(voxel_size=0.1))
        >>> options.keypoints.name
        'uniform'
    """

    name: ClassVar[str] = "uniform"

    voxel_size: float = length()

    def __post_init__(self) -> None:
        positive(self.voxel_size, "voxel_size")

    @classmethod
    def for_spacing(cls, spacing: float) -> UniformKeypoints:
        """Voxels of 2 spacings."""
        return cls(voxel_size=2 * spacing)

    def select(self, cloud: Clouds, near: Neighborhoods | None) -> KeypointRows:
        """As ``torchreg.uniform_keypoints``."""
        return uniform_keypoints(cloud, self.voxel_size)


def _nearest_to_centers(points: Tensor, size: float) -> Tensor:
    """Ascending rows of points (P, 3) float64, one of every voxel."""
    if len(points) == 0:
        return torch.zeros(0, dtype=torch.int64, device=points.device)
    cell, key = voxel_numbers(points, size)
    x, y, z = (points - points.amin(dim=0) - cell * size).unbind(1)
    nearest_first = (x * x + y * y + z * z).sort(stable=True).indices
    ordered, place = key[nearest_first].sort(stable=True)
    first = torch.ones_like(ordered, dtype=torch.bool)
    first[1:] = ordered[1:] != ordered[:-1]
    return nearest_first[place[first]].sort().values
