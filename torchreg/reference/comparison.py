"""What a comparison with Open3D shows, as named numbers."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
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
        seconds: time of every stage after downsampling, by name, in order.
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
    seconds: tuple[tuple[str, float], ...]

    @property
    def total_seconds(self) -> float:
        """The time of these stages."""
        return sum(seconds for _, seconds in self.seconds)


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
        content: dict[str, Any] = {
            "features": self.features,
            "points": {"source": self.points[0], "target": self.points[1]},
            "descriptors_agree": self.descriptors_agree,
            "descriptors": [
                {**asdict(one), "share_off": one.share_off, "agree": one.agree, "ties": [t._asdict() for t in one.ties]}
                for one in self.descriptors
            ],
            "matches": {
                "torchreg": self.torchreg.matches,
                "open3d": self.open3d.matches,
                "shared": self.shared_matches,
            },
            "torchreg": _side(self.torchreg),
            "open3d": _side(self.open3d),
            "options": plain_data(self.options),
        }
        return {key: _plain(value) for key, value in content.items()}


def _side(side: Side) -> dict[str, Any]:
    return {
        "T_target_source": side.T_target_source.tolist(),
        "success": side.success,
        "reason": side.reason,
        "notes": side.notes,
        "matches": side.matches,
        "inliers": side.inliers,
        "fitness": side.fitness,
        "inlier_rmse": side.inlier_rmse,
        "truth": None if side.truth is None else side.truth._asdict(),
        "seconds": dict(side.seconds),
    }


def _plain(value: Any) -> Any:  # noqa: ANN401
    """Lists for tuples and ``None`` for numbers that are not finite, all the way down."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
