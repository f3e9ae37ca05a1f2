"""Options in whose place something was said, field by field."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

from torchreg.registration.options import RegistrationOptions
from torchreg.registration.presets import PAPER

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class OptionOverrides:
    """What was said over the options that a preset or the clouds' scale gives; ``None`` where nothing was.

    Attributes:
        voxel: meters, the edge of the cubes that points are averaged over.
        normal_radius: meters.
        feature_radius: meters.
        color_radius: meters.
        inlier_threshold: meters.
        hypotheses: how many RANSAC draws at most.
        confidence: at which drawing stops.
        no_color: leaves color out of the features.

    Raises:
        ValueError: a value that ``RegistrationOptions`` would refuse.
    """

    voxel: float | None = None
    normal_radius: float | None = None
    feature_radius: float | None = None
    color_radius: float | None = None
    inlier_threshold: float | None = None
    hypotheses: int | None = None
    confidence: float | None = None
    no_color: bool = False

    def __post_init__(self) -> None:
        self.over(PAPER)

    def over(self, options: RegistrationOptions) -> RegistrationOptions:
        """The options with what was said in their place."""
        return replace(
            options,
            voxel_size=_either(self.voxel, options.voxel_size),
            normal_radius=_either(self.normal_radius, options.normal_radius),
            feature_radius=_either(self.feature_radius, options.feature_radius),
            color_radius=_either(self.color_radius, options.color_radius),
            color=() if self.no_color else options.color,
            color_weights=() if self.no_color else options.color_weights,
            ransac=replace(
                options.ransac,
                inlier_threshold=_either(self.inlier_threshold, options.ransac.inlier_threshold),
                hypotheses=_either(self.hypotheses, options.ransac.hypotheses),
                confidence=_either(self.confidence, options.ransac.confidence),
            ),
        )


def _either(given: _T | None, otherwise: _T) -> _T:
    return otherwise if given is None else given
