"""Whether the descriptors of partners agree, beyond how much those of any two points of the overlap do."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import SAMPLE_LANES, lane_sums
from torchreg.native import call, native
from torchreg.verification.partners import Partners
from torchreg.verification.scans import STRIDE, thinned

_LEAST = 6  # partners that tell anything
_ALIKE = 1e-12  # squared: features that differ by less are the same


class _FeatureSums(NamedTuple):
    """Over the partners of R poses, of every number of the features."""

    partners: Tensor  # (R,) int64
    apart: Tensor  # (R, D) float64, of squared differences
    squares: Tensor  # (R, D), of the squares of both
    one: Tensor  # (R, D)
    other: Tensor  # (R, D)


def concordance(one: Tensor, other: Tensor, pair: Tensor, found: Partners, square_limit: Tensor) -> Tensor:
    """Agreement (R,) of the features of partners, as the concordance correlation of numbers (Lin, 1989).

    1 less the mean squared difference of partners over that of each with the partners of all others: 1 where partners
    have the same features, about 0 where any two points of the overlap are as much alike. 0 for fewer than 6 partners.

    Args:
        one: (G, L', D) float32, of every third point of the samples.
        other: (P, D) float32, of the points that the rows of ``found`` name.
        pair: (R,) int64, which sample each row of ``found`` is of.
        found: (R, L), of all points of the samples.
        square_limit: (R,) float32, squared meters below which a point is a partner.
    """
    sums = _summed(one, other, pair, found, square_limit)
    count = sums.partners.double().clamp(min=1)[:, None]
    apart, square = (lane_sums(part / count) for part in (sums.apart, sums.squares))
    middle = lane_sums((sums.one / count) * (sums.other / count))
    strangers = square - 2 * middle  # of each with the partners of all others, squared
    enough = (sums.partners >= _LEAST) & (strangers > _ALIKE)
    return torch.where(enough, 1 - apart / strangers.clamp(min=_ALIKE), 0.0)


def _summed(one: Tensor, other: Tensor, pair: Tensor, found: Partners, square_limit: Tensor) -> _FeatureSums:
    if native(one, other, found.square):
        return _summed_compiled(one, other, pair, found, square_limit)
    close = thinned(found.square < square_limit[:, None])[..., None]  # (R, L', 1)
    row = thinned(found.row)
    own = torch.where(close, one[pair], 0.0)
    partner = torch.where(close, other.index_select(0, row.view(-1)).view(own.shape), 0.0)
    difference = own - partner
    numbers = (difference * difference, own * own + partner * partner, own, partner)
    return _FeatureSums(close.sum(dim=(1, 2)), *(lane_sums(values.double(), SAMPLE_LANES, dim=1) for values in numbers))


def _summed_compiled(one: Tensor, other: Tensor, pair: Tensor, found: Partners, square_limit: Tensor) -> _FeatureSums:
    """As ``_summed``."""
    width, (rows, length) = one.shape[2], found.square.shape
    count, sums = torch.empty_like(pair), torch.empty(4, rows, width, dtype=torch.float64)
    tensors = (one, other, *found, square_limit, pair, count, sums)
    call("feature_sums", *tensors, one.shape[1], STRIDE, width, rows, length)
    return _FeatureSums(count, *sums)
