"""FPFH and PCFH as modules, whose bins may be learned."""

from __future__ import annotations

from torch import Tensor, nn

from torchreg.descriptors.fpfh import fpfh
from torchreg.descriptors.pair_features import ANGLE_BINS
from torchreg.descriptors.pcfh import CHANNELS, pcfh
from torchreg.descriptors.soft.arguments import expect_binning
from torchreg.errors import at_least, expect, one_of
from torchreg.nn.bin_edges import BinEdges
from torchreg.nn.precision import full_precision
from torchreg.types import Clouds, Features, Neighborhoods

_ANGLES = 3


class FPFH(nn.Module):
    """``torchreg.fpfh`` with its options, by soft binning unless told otherwise.

    Args:
        mode: ``"open3d"`` or ``"pcl"``.
        binning: ``"soft"``, with gradients, or ``"hard"``, without.
        bandwidth: of soft binning, in (0, 1].
        learn_edges: whether the ends of the bins of the three angles are learned; needs soft binning.

    Attributes:
        edges: ``BinEdges`` (3, 11), or ``None`` for equal bins.

    Raises:
        ValueError: an unknown name, a bandwidth out of its range, or edges to learn with hard binning.
    """

    def __init__(
        self, *, mode: str = "open3d", binning: str = "soft", bandwidth: float = 1.0, learn_edges: bool = False
    ) -> None:
        super().__init__()
        self.mode = one_of(mode, "mode", ("open3d", "pcl"))
        self.binning, self.bandwidth = _checked(binning, bandwidth, learn_edges)
        self.edges = BinEdges(_ANGLES, ANGLE_BINS) if learn_edges else None

    @full_precision
    def forward(self, cloud: Clouds, near: Neighborhoods, *, neighbor_weights: Tensor | None = None) -> Features:
        """Features of one block ("fpfh", 33); arguments, gradients and errors are those of ``torchreg.fpfh``.

        Args:
            cloud: points and unit normals; P rows.
            near: the support of every point.
            neighbor_weights: (P, K) not below 0, or ``None``.

        Gradients flow to points, normals, neighbor weights and edges where binning is soft.
        """
        return fpfh(
            cloud,
            near,
            mode=self.mode,
            binning=self.binning,
            bandwidth=self.bandwidth,
            edges=None if self.edges is None else self.edges(),
            neighbor_weights=neighbor_weights,
        )

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return f"mode={self.mode!r}, binning={self.binning!r}, bandwidth={self.bandwidth}"


class PCFH(nn.Module):
    """``torchreg.pcfh`` with its options, by soft binning unless told otherwise.

    Args:
        bins: over [0, 1] per channel.
        channels: which of ``"hue"``, ``"saturation"``, ``"value"`` are compared.
        equalization: of hue, ``"cloud"`` or ``"none"``; not read when ``forward`` is given values.
        saturation_weighting: hue votes count by the product of both points' saturations.
        binning: ``"soft"``, with gradients, or ``"hard"``, without.
        bandwidth: of soft binning, in (0, 1].
        learn_edges: whether the ends of the bins of every channel are learned; needs soft binning.

    Attributes:
        edges: ``BinEdges`` (channels, bins), or ``None`` for equal bins.

    Raises:
        ValueError: an unknown name, a number out of its range, or edges to learn with hard binning.
    """

    def __init__(
        self,
        *,
        bins: int = 11,
        channels: tuple[str, ...] = ("hue",),
        equalization: str = "cloud",
        saturation_weighting: bool = False,
        binning: str = "soft",
        bandwidth: float = 1.0,
        learn_edges: bool = False,
    ) -> None:
        super().__init__()
        self.bins = at_least(bins, "bins", 1)
        expect(len(channels) > 0, "channels", "at least one channel", channels)
        self.channels = tuple(one_of(channel, "channels", CHANNELS) for channel in channels)
        self.equalization = one_of(equalization, "equalization", ("none", "cloud"))
        self.saturation_weighting = saturation_weighting
        self.binning, self.bandwidth = _checked(binning, bandwidth, learn_edges)
        self.edges = BinEdges(len(channels), bins) if learn_edges else None

    @full_precision
    def forward(
        self,
        cloud: Clouds,
        near: Neighborhoods,
        *,
        values: Tensor | None = None,
        neighbor_weights: Tensor | None = None,
    ) -> Features:
        """Features of one block ("pcfh", bins x channels); as of ``torchreg.pcfh``.

        Args:
            cloud: points and colors; P rows.
            near: the support of every point.
            values: (P, 3) hue, saturation and value instead of those of the cloud, such as from ``Equalize``.
            neighbor_weights: (P, K) not below 0, or ``None``.

        Gradients flow to points, colors (or values), neighbor weights and edges where binning is soft.
        """
        return pcfh(
            cloud,
            near,
            bins=self.bins,
            channels=self.channels,
            equalization=self.equalization,
            saturation_weighting=self.saturation_weighting,
            values=values,
            binning=self.binning,
            bandwidth=self.bandwidth,
            edges=None if self.edges is None else self.edges(),
            neighbor_weights=neighbor_weights,
        )

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return (
            f"bins={self.bins}, channels={self.channels}, equalization={self.equalization!r}, "
            f"saturation_weighting={self.saturation_weighting}, binning={self.binning!r}, bandwidth={self.bandwidth}"
        )


def _checked(binning: str, bandwidth: float, learn_edges: bool) -> tuple[str, float]:
    expect_binning(binning, bandwidth, edges=None, neighbor_weights=None)
    expect(binning == "soft" or not learn_edges, "learn_edges", "False with hard binning", learn_edges)
    return binning, bandwidth
