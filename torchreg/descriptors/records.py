"""The descriptors that the library has, as records over its functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch

from torchreg.descriptors.color import joint_color_values
from torchreg.descriptors.contrast import contrast
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import fpfh
from torchreg.descriptors.learned import shipped_color
from torchreg.descriptors.pcfh import CHANNELS, pcfh
from torchreg.errors import at_least, expect, one_of
from torchreg.types import Clouds, Features, Neighborhoods

EQUALIZATIONS = ("none", "cloud", "joint")


@dataclass(frozen=True, kw_only=True)
class Fpfh(Descriptor):
    """``torchreg.fpfh``: 33 numbers of local geometry.

    Attributes:
        mode: ``"open3d"`` or ``"pcl"``.
    """

    name: ClassVar[str] = "fpfh"
    is_histogram: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    mode: str = "open3d"

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of(self.mode, "mode", ("open3d", "pcl"))

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.fpfh``."""
        return fpfh(cloud, near, mode=self.mode)


@dataclass(frozen=True, kw_only=True)
class Pcfh(Descriptor):
    """``torchreg.pcfh``: histograms of color differences, the paper's unless told otherwise.

    Attributes:
        bins: of every channel's histogram.
        channels: which of ``"hue"``, ``"saturation"`` and ``"value"`` are compared.
        equalization: histogram equalization of hue: ``"none"``, per ``"cloud"``, or ``"joint"``, one map for both
            clouds of a pair.
        saturation_weighting: votes on hue count by the saturation of both points, so that gray has no say.
    """

    name: ClassVar[str] = "pcfh"
    needs_colors: ClassVar[bool] = True
    is_histogram: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    bins: int = 11
    channels: tuple[str, ...] = ("hue",)
    equalization: str = "cloud"
    saturation_weighting: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(self.bins, "bins", 1)
        expect(len(self.channels) > 0, "channels", "at least one channel", self.channels)
        for channel in self.channels:
            one_of(channel, "channels", CHANNELS)
        one_of(self.equalization, "equalization", EQUALIZATIONS)

    @property
    def is_pairwise(self) -> bool:
        """Whether hue is equalized jointly."""
        return self.equalization == "joint"

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.pcfh``; jointly equalized, ``cloud`` holds the two clouds of one pair."""
        return pcfh(
            cloud,
            near,
            bins=self.bins,
            channels=self.channels,
            equalization="none" if self.is_pairwise else self.equalization,
            saturation_weighting=self.saturation_weighting,
            values=torch.cat(joint_color_values(cloud.select(0), cloud.select(1))) if self.is_pairwise else None,
        )


@dataclass(frozen=True, kw_only=True)
class Contrast(Descriptor):
    """``torchreg.contrast``: spread and shift of brightness per channel, near and far."""

    name: ClassVar[str] = "contrast"
    needs_colors: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.contrast``."""
        return contrast(cloud, near, self.radius if near.radius is None else near.radius)


@dataclass(frozen=True, kw_only=True)
class Learned(Descriptor):
    """Histograms of color differences with trained bins and weights (``torchreg.LEARNED``)."""

    name: ClassVar[str] = "learned"
    needs_colors: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """By the weights that come with the library."""
        return shipped_color(cloud, near, self.radius if near.radius is None else near.radius)


DESCRIPTORS: dict[str, type[Descriptor]] = {record.name: record for record in (Fpfh, Pcfh, Contrast, Learned)}
"""Every descriptor by its name."""
