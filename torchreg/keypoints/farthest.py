"""Farthest point sampling: each keypoint is the point farthest from those chosen before it.

Eldar et al., The farthest point strategy for progressive image sampling, IEEE Trans. Image Processing 6(9), 1997,
doi:10.1109/83.623193.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import at_least
from torchreg.keypoints.keypoints import KeypointRows, Keypoints, rows_of_clouds
from torchreg.preprocess.downsample import farthest_rows
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.packing import spans


@entry
def farthest_keypoints(cloud: Clouds, count: int) -> KeypointRows:
    """Select ``count`` points of every cloud, each the farthest from those chosen before it.

    The first is the point farthest from the cloud's mean; ties go to the lower row. So nothing is drawn at random.
    Costs count x P operations.

    Args:
        cloud: B clouds.
        count: how many points are selected; of a cloud with fewer all are.

    Returns:
        KeypointRows, the points of ``farthest_point_downsample``. The same for any batch and number of threads. No
        gradients.

    Raises:
        ValueError: ``count`` below 1.

    Example:
        >>> import torch
        >>> cloud = Clouds(points=torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
        >>> farthest_keypoints(cloud, 2).rows
        tensor([0, 2])
    """
    at_least(count, "count", 1)
    chosen = [farthest_rows(cloud.points[begin:end].detach().double(), count) for begin, end in spans(cloud.offsets)]
    return rows_of_clouds(cloud, chosen)


@checked_record
@dataclass(frozen=True, kw_only=True)
class FarthestKeypoints(Keypoints):
    """``torchreg.farthest_keypoints``: points spread as far apart as so many can be.

    Attributes:
        count: how many points of a cloud are selected.

    Raises:
        ValueError: ``count`` below 1.

    Example:
        >>> import torchreg as tr
        >>> from dataclasses import replace
        >>> options = replace(tr.options_for(spacing=0.05), keypoints=tr.FarthestKeypoints(count=500))
        >>> options.keypoints.name
        'farthest'
    """

    name: ClassVar[str] = "farthest"

    count: int = 2000

    def __post_init__(self) -> None:
        at_least(self.count, "count", 1)

    @classmethod
    def for_spacing(cls, spacing: float) -> FarthestKeypoints:
        """2,000 points, whatever the spacing."""
        return cls()

    def select(self, cloud: Clouds, near: Neighborhoods | None) -> KeypointRows:
        """As ``torchreg.farthest_keypoints``."""
        return farthest_keypoints(cloud, self.count)
