"""What a comparison with Open3D shows, as named numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from torchreg.io.result_json import plain_data
from torchreg.metrics import PoseErrors
from torchreg.reference.descriptors import DescriptorDifference
from torchreg.registration.options import RegistrationOptions


@dataclass(frozen=True, eq=False, kw_only=True)
class Side:
    """The run of one of the two.

    Attributes:
        T_target_source: (4, 4) float64, meters, origins included.
        success: whether it calls the pair registered.
        reason: why not, or an empty text.
        notes: what its result says a user should know.
        matches: how many correspondences it found.
        inliers: how many of them its transform brings within the inlier threshold.
        fitness: of its transform by Open3D's ``evaluate_registration``; ``None`` where it has none.
        inlier_rmse: likewise, meters.
        truth: errors against the true transform, where that is known and this one was found.
        seconds: of every stage after downsampling, by name, in order.
    """

    T_target_source: Tensor
    success: bool
    reason: str
    notes: tuple[str, ...]
    matches: int
    inliers: int
    fitness: float | None
    inlier_rmse: float | None
    truth: PoseErrors | None
    seconds: dict[str, float]

    @property
    def total_seconds(self) -> float:
        """The time of these stages."""
        return sum(self.seconds.values())


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """One pair registered by torchreg and by Open3D from the same points, and their FPFH row by row.

    Attributes:
        options: what both were run with, derived numbers included.
        features: what both matched: "fused" or "fpfh".
        points: of source and target, after downsampling.
        descriptors: source and target, in float64 and float32 each; empty where a cloud cannot be described.
        torchreg: its run.
        open3d: its run.
        shared_matches: correspondences that both found.
    """

    options: RegistrationOptions
    features: str
    points: tuple[int, int]
    descriptors: tuple[DescriptorDifference, ...]
    torchreg: Side
    open3d: Side
    shared_matches: int

    @property
    def descriptors_agree(self) -> bool:
        """Whether there are descriptors, and all rows without a tie are within their tolerance."""
        return len(self.descriptors) > 0 and all(difference.agree for difference in self.descriptors)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, texts and lists, ready for JSON; numbers that are not finite become ``None``."""
        counts = {"torchreg": self.torchreg.matches, "open3d": self.open3d.matches, "shared": self.shared_matches}
        differences = [{**plain_data(one), "share_off": one.share_off, "agree": one.agree} for one in self.descriptors]
        return {
            "features": self.features,
            "points": {"source": self.points[0], "target": self.points[1]},
            "descriptors_agree": self.descriptors_agree,
            "descriptors": differences,
            "matches": counts,
            "torchreg": plain_data(self.torchreg),
            "open3d": plain_data(self.open3d),
            "options": plain_data(self.options),
        }
