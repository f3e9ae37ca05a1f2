"""Where the bins of a histogram end, as something to learn: widths that are positive and sum to one."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchreg.errors import at_least
from torchreg.nn.precision import widened

_LEAST = 0.01  # of the width of an equal bin: no bin vanishes, and edges ascend strictly in float32 too


class BinEdges(nn.Module):
    """Edges of several histograms over [0, 1], equal bins to begin with.

    A softmax over each row of ``log_widths``, all but a hundredth of it, makes the widths; their sums are the edges.

    Args:
        rows: histograms, such as the three angles of FPFH.
        bins: of each.

    Attributes:
        log_widths: (rows, bins) learnable; zeros for equal bins. A constant added to a row changes nothing.

    Raises:
        ValueError: ``rows`` or ``bins`` below 1.
    """

    def __init__(self, rows: int, bins: int) -> None:
        super().__init__()
        self.log_widths = nn.Parameter(torch.zeros(at_least(rows, "rows", 1), at_least(bins, "bins", 1)))

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
    widths = shares * (1 - _LEAST) + _LEAST / bins
    # not by cumsum, whose gradient the compiler of torch 2.13 gets wrong here on CPUs
    before = torch.ones(bins, bins, dtype=widths.dtype, device=widths.device).triu(1)[:, 1:]
    inner = (widths[:, :, None] * before).sum(dim=1)
    first = torch.zeros_like(widths[:, :1])
    return torch.cat([first, inner, first + 1], dim=1)
