"""FPFH and PCFH as modules, with bins whose edges can be learned."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchreg.arguments import checked
from torchreg.descriptors.fpfh import fpfh
from torchreg.descriptors.pair_features import ANGLE_BINS
from torchreg.descriptors.pcfh import CHANNELS, pcfh
from torchreg.descriptors.soft.arguments import expect_binning
from torchreg.errors import at_least, expect, one_of
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.precision import full_precision, widened

_ANGLES = 3
_LEAST_WIDTH = 0.01  # of an equal bin's: no bin vanishes, and edges ascend strictly in float32 too


class FPFH(nn.Module):
    """``torchreg.fpfh`` with its options, by soft binning by default.

    Args:
        mode: ``"open3d"`` or ``"pcl"``.
        binning: ``"soft"``, with gradients, or ``"hard"``, without.
        bandwidth: of soft binning, in (0, 1].
        learn_edges: whether the edges of the bins of the three angles are learned; needs soft binning.

    Attributes:
        edges: ``BinEdges`` (3, 11), or ``None`` for equal bins.

    Raises:
        ValueError: an unknown name, a bandwidth out of its range, or edges to learn with hard binning.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=20)
        >>> tr.nn.FPFH()(tr.estimate_normals(cloud, near), near).values.shape
        torch.Size([50, 33])
    """

    @checked
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
    """``torchreg.pcfh`` with its options, by soft binning by default.

    Args:
        bins: over [0, 1] per channel.
        channels: which of ``"hue"``, ``"saturation"``, ``"value"`` are compared.
        equalization: of hue, ``"cloud"`` or ``"none"``; ignored when ``forward`` is given values.
        saturation_weighting: hue votes count by the product of both points' saturations.
        binning: ``"soft"``, with gradients, or ``"hard"``, without.
        bandwidth: of soft binning, in (0, 1].
        learn_edges: whether the edges of the bins of every channel are learned; needs soft binning.

    Attributes:
        edges: ``BinEdges`` (channels, bins), or ``None`` for equal bins.

    Raises:
        ValueError: an unknown name, a number out of its range, or edges to learn with hard binning.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3), colors=torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=20)
        >>> tr.nn.PCFH()(cloud, near).values.shape
        torch.Size([50, 11])
    """

    @checked
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
        """Features of one block ("pcfh", bins x channels); arguments and errors are those of ``torchreg.pcfh``.

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


class BinEdges(nn.Module):
    """Learnable edges of several histograms over [0, 1], initially of equal bins.

    Widths are a softmax over each row of ``log_widths``, mixed with a hundredth of equal widths; their sums are the
    edges.

    Args:
        rows: histograms, such as the three angles of FPFH.
        bins: of each.

    Attributes:
        log_widths: (rows, bins) learnable; zeros give equal bins. A constant added to a row changes nothing.

    Raises:
        ValueError: ``rows`` or ``bins`` below 1.

    Example:
        >>> import torchreg as tr
        >>> tr.nn.BinEdges(rows=3, bins=11)().shape
        torch.Size([3, 12])
    """

    @checked
    def __init__(self, rows: int, bins: int) -> None:
        super().__init__()
        self.log_widths = nn.Parameter(
            torch.zeros(at_least(rows, "rows", 1), at_least(bins, "bins", 1), dtype=torch.float32)
        )

    def forward(self) -> Tensor:
        """The edges (rows, bins + 1), strictly ascending from 0 to 1, in float32 or float64. Gradients flow."""
        return ascending_edges(widened(self.log_widths))

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        rows, bins = self.log_widths.shape
        return f"rows={rows}, bins={bins}"


def ascending_edges(log_widths: Tensor) -> Tensor:
    """Edges (rows, bins + 1) from logarithms of widths (rows, bins). Gradients flow."""
    shares = log_widths.softmax(dim=1)
    bins = shares.shape[1]
    widths = shares * (1 - _LEAST_WIDTH) + _LEAST_WIDTH / bins
    # not by cumsum, whose gradient the compiler of torch 2.13 gets wrong here on CPUs
    before = torch.ones(bins, bins, dtype=widths.dtype, device=widths.device).triu(1)[:, 1:]
    inner = (widths[:, :, None] * before).sum(dim=1)
    first = torch.zeros_like(widths[:, :1])
    return torch.cat([first, inner, first + 1], dim=1)
