"""One joint vector from several descriptors (the paper, section 3.2, step 5)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, positive
from torchreg.types import Features

_LEAST = 1e-2  # percent


@entry
def fuse(*features: Features, weights: tuple[float, ...] | None = None) -> Features:
    """Scale every block to unit length, row by row, weigh it and concatenate.

    Args:
        features: descriptors of the same points, such as FPFH (33) and PCFH (11).
        weights: one per argument, above 0; ``None`` for equal weights, as in the paper.

    Returns:
        Features with the blocks of all arguments in order (FPFH and PCFH: 44). A row whose block is zero takes
        part with that block zero; a row with all blocks zero is not valid. Gradients flow.

    Raises:
        ValueError: nothing to fuse, different points, or a weight that is not above 0.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3), colors=torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=20)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.fuse(tr.fpfh(cloud, near), tr.pcfh(cloud, near), weights=(1.0, 0.5)).blocks
        (('fpfh', 33), ('pcfh', 11))
    """
    expect(len(features) > 0, "features", "at least one descriptor", features)
    weights = (1.0,) * len(features) if weights is None else weights
    expect(len(weights) == len(features), "weights", f"one per descriptor ({len(features)})", weights)
    first = features[0]
    for other in features[1:]:
        same = torch.compiler.is_compiling() or torch.equal(other.offsets, first.offsets)  # a graph reads no value
        expect(same, "features", "descriptors of the same points", other.offsets)
    for weight in weights:
        positive(weight, "weights")
    blocks = [unit_rows(item.values) * weight for item, weight in zip(features, weights, strict=True)]
    values = torch.cat(blocks, dim=1)
    return Features(
        values,
        first.offsets,
        tuple(block for item in features for block in item.blocks),
        # the largest entry, since ``any`` of a row is several times slower
        valid=torch.stack([item.valid for item in features]).any(dim=0) & (values.detach().abs().amax(dim=1) != 0),
    )


def unit_rows(values: Tensor) -> Tensor:
    """Rows of unit length; zero rows stay zero. Gradients are finite everywhere."""
    square = (values * values).sum(dim=1, keepdim=True)
    zero = square == 0
    length = torch.where(zero, torch.ones_like(square), square).sqrt()
    return values / length


def rooted(histograms: Tensor, share: float | Tensor = 1.0) -> Tensor:
    """Move entries of histograms in percent from x towards 10 sqrt(x), which maps 100 to 100.

    Square roots keep a few large entries from deciding alone: the distance of unit rows is Hellinger's (Arandjelovic
    and Zisserman, CVPR 2012, doi:10.1109/CVPR.2012.6248018).

    Args:
        histograms: (P, D), not below 0.
        share: in [0, 1], how far.

    Returns:
        (P, D). Zero stays zero, and gradients, to entries and share, are finite. Basic operations alone, which round
        alike in every lane.
    """
    roots: Tensor = (histograms + _LEAST).sqrt() - math.sqrt(_LEAST)
    return histograms * (1 - share) + roots * (10 * share)
