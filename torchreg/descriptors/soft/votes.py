"""Histograms whose votes pass linearly from one bin to the next.

Where a hard histogram gives a vote to the bin that it falls into, here it is shared between two: across every inner
edge e the upper bin's share rises from 0 to 1 over a ramp of width h centered at e,

    share(x) = clamp((x - e) / h + 1/2, 0, 1),    h = bandwidth x the narrower of the two bins beside e.

The shares of a vote sum to one. With equal bins and bandwidth 1 the weight of a bin is a triangle over its center
that reaches to the centers of its neighbors (linear interpolation between bin centers, as in Lowe's histograms of
gradients, IJCV 2004, doi:10.1023/B:VISI.0000029664.99615.94); as the bandwidth shrinks, the hard histogram returns.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import hardtanh


class Shares(NamedTuple):
    """The two bins between which every vote is shared."""

    lower: Tensor  # (R, K) int64, one bin
    upper: Tensor  # (R, K) int64, the next one; the same bin beyond the outermost centers
    share: Tensor  # (R, K) in [0, 1], what ``upper`` gets


def shared_votes(shares: Shares, votes: Tensor, bins: int) -> Tensor:
    """Histograms (R, bins) of votes (R, K), each shared between two bins; a row sums to the sum of its votes.

    Gradients flow to shares and votes.
    """
    to_upper = votes * shares.share
    counts = votes.new_zeros(votes.shape[0], bins).scatter_add(1, shares.lower, votes - to_upper)
    return counts.scatter_add(1, shares.upper, to_upper)


class ShareGradient(NamedTuple):
    """The gradient of a histogram with respect to the votes in it."""

    step: Tensor  # (R, K), with respect to a vote's position in bins, for a vote of 1
    level: Tensor  # (R, K), with respect to the vote itself


def share_gradient(shares: Shares, grad: Tensor, bandwidth: float) -> ShareGradient:
    """From the gradient (R, bins) of ``shared_votes`` over equal bins to that of places and votes."""
    low = grad.gather(1, shares.lower)
    rise = grad.gather(1, shares.upper).sub_(low)
    level = low.add_(rise * shares.share)
    if bandwidth < 1:
        rise = rise.mul_(((shares.share > 0) & (shares.share < 1)).to(rise.dtype)).div_(bandwidth)
    return ShareGradient(rise, level)


def bin_shares(
    position: Tensor, bins: int, bandwidth: float, *, edges: Tensor | None = None, circular: bool = False
) -> Shares:
    """The two bins between which every vote is shared, of positions (R, K) in [0, 1]; ``bandwidth`` is in (0, 1].

    Edges (R, bins + 1) ascend from 0 to 1, the same in every row; ``None`` is for equal bins. Where ``circular``, the
    last bin borders on the first. Gradients flow to positions and edges: those of a piecewise linear function.
    """
    if edges is None:
        scaled = position * bins
        nearest = (scaled.detach() + 0.5).floor_().clamp(0, bins)
        share = scaled - nearest
        share = share + 0.5 if bandwidth == 1 else hardtanh(share / bandwidth + 0.5, 0, 1)
    else:
        share, nearest = _between_edges(position, bandwidth, edges, circular)
    lower, upper = nearest - 1, nearest
    if circular:
        lower = lower + bins * lower.lt(0).to(lower.dtype)
        upper = upper - bins * upper.ge(bins).to(upper.dtype)
    return Shares(lower.clamp(min=0).long(), upper.clamp(max=bins - 1).long(), share)


def _between_edges(position: Tensor, bandwidth: float, edges: Tensor, circular: bool) -> tuple[Tensor, Tensor]:
    """The share of the upper bin, and the edge between whose neighboring centers a vote lies."""
    width = edges[:, 1:] - edges[:, :-1]  # (R, bins)
    before = torch.cat([width[:, -1:] if circular else width[:, :1], width], dim=1)  # (R, bins + 1)
    after = torch.cat([width, width[:, :1] if circular else width[:, -1:]], dim=1)
    ramp = torch.minimum(before, after) * bandwidth
    fixed = edges[0].detach()
    nearest = torch.bucketize(position.detach(), (fixed[1:] + fixed[:-1]) / 2)
    ramp_there = ramp.gather(1, nearest).clamp(min=torch.finfo(position.dtype).eps)
    share = hardtanh((position - edges.gather(1, nearest)) / ramp_there + 0.5, 0, 1)
    return share, nearest.to(position.dtype)
