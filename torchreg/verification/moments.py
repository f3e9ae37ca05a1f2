"""The mean and the second moments of the points that are looked at, of every scan of a group."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.verification.side import Side
from torchreg.verification.sums import row_sums


class Moments(NamedTuple):
    """Of G scans.

    Attributes:
        mean: (G, 3) float64, meters.
        products: (G, 3, 3) float64, sums of products of distances to the mean, square meters.
        counts: (G,) float64, points.
    """

    mean: Tensor
    products: Tensor
    counts: Tensor


def moments(side: Side) -> Moments:
    """Of the samples of one side."""
    wide, count = side.points.double(), side.counts.clamp(min=1)
    mean = row_sums(wide) / count  # (3, G)
    apart = torch.where(side.real, wide - mean[..., None], 0.0)
    products = row_sums(torch.stack([apart[i] * apart for i in range(3)]))  # (3, 3, G)
    return Moments(mean.t(), products.permute(2, 0, 1), count)


def frames(of: Moments) -> Tensor:
    """(G, 4, 3): the columns of a root of each covariance, then the mean; what ``Poses.vectors`` takes."""
    values, vectors = torch.linalg.eigh(of.products / of.counts[:, None, None])
    root = vectors * values.clamp(min=0).sqrt()[:, None]
    return torch.cat([root.transpose(1, 2), of.mean[:, None]], dim=1)
