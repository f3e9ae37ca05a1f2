"""How closely partners lie, whether their surfaces face the same way, and whether their colors go together."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.gather import gather, gather_columns
from torchreg.geometry.numerics.sums import SAMPLE_LANES, lane_sums
from torchreg.native import call, native
from torchreg.verification.partners import Partners
from torchreg.verification.scans import Scans, rotated

_LEAST_VARIANCE = 1e-5  # of a channel in [0, 1]: below it, the channel is one gray value and its rounding
_CHANNELS = 3


class PartnerTerms(NamedTuple):
    """Of R poses, (R,) float64 each, as in ``Evidence``."""

    partners: Tensor  # points with a partner
    closeness: Tensor
    normals: Tensor
    colors: Tensor


class _PartnerSums(NamedTuple):
    """Over the partners of R poses."""

    partners: Tensor  # (R,) int64
    closeness: Tensor  # (R,) float64
    cosines: Tensor  # (R,) float64, zeros without normals
    # (3, R) float64, of the colors of both sides about their means, channel by channel; any numbers without colors
    products: Tensor
    own_squares: Tensor
    other_squares: Tensor


def partner_terms(
    source: Scans, target: Scans, pair: Tensor, rotation: Tensor, found: Partners, square_limit: Tensor
) -> PartnerTerms:
    """Compare partners under R poses, whose rotations are (R, 3, 3) float32; ``pair`` (R,) int64 names their pairs.

    Points are partners below ``square_limit`` (R,) float32, squared meters.
    """
    sums = _summed(source, target, pair, rotation, found, square_limit)
    count = sums.partners.double()
    some = count.clamp(min=1)
    normals = colors = torch.full_like(count, float("nan"))
    if _have_normals(source, target):
        normals = torch.where(count > 0, sums.cosines / some, float("nan"))
    if _have_colors(source, target):
        colors = _correlation(*(part / some for part in sums[3:]))
    return PartnerTerms(count, sums.closeness / some, normals, colors)


def _have_normals(source: Scans, target: Scans) -> bool:
    return source.normals is not None and target.all_normals is not None


def _have_colors(source: Scans, target: Scans) -> bool:
    return source.colors is not None and target.all_colors is not None


def _correlation(products: Tensor, left: Tensor, right: Tensor) -> Tensor:
    """Correlation (R,) of colors from the means (3, R) of products and squares, the mean over the channels that vary.

    A change of brightness or contrast of a channel leaves it as it is. NaN where no channel varies on both sides.
    """
    varies = (left > _LEAST_VARIANCE) & (right > _LEAST_VARIANCE)
    scale = torch.where(varies, left * right, torch.ones_like(left)).sqrt()
    correlation = torch.where(varies, products / scale, torch.full_like(scale, float("nan")))
    return correlation.t().contiguous().nanmean(dim=1)


def _summed(
    source: Scans, target: Scans, pair: Tensor, rotation: Tensor, found: Partners, square_limit: Tensor
) -> _PartnerSums:
    if native(found.square, rotation):
        return _summed_compiled(source, target, pair, rotation, found, square_limit)
    close = found.square < square_limit[:, None]  # (R, L)
    weight = close.double()
    closeness = torch.where(close, 1 - found.square / square_limit[:, None], 0.0)
    cosines = torch.zeros_like(closeness)
    if source.normals is not None and target.all_normals is not None:
        facing = gather_columns(target.all_normals, found.row)
        x, y, z = rotated(rotation, source.normals[:, pair]).mul_(facing).unbind(0)
        cosine = x.add_(y).add_(z)
        known = source.faced[pair] & gather(target.all_faced, found.row)
        cosine = torch.where(known, cosine, cosine.abs())  # which side a surface faces may not be known
        cosines = torch.where(close, cosine, 0.0)
    squares = torch.zeros(3, _CHANNELS, len(pair), dtype=torch.float64, device=pair.device)
    if source.colors is not None and target.all_colors is not None:
        one, other = source.colors[:, pair], gather_columns(target.all_colors, found.row)  # (3, R, L)
        total = close.sum(dim=1).double().clamp(min=1)
        a, b = (
            (part - (lane_sums(part * weight, SAMPLE_LANES) / total)[..., None]).mul_(weight) for part in (one, other)
        )
        squares = torch.stack([lane_sums(x * y, SAMPLE_LANES) for x, y in ((a, b), (a, a), (b, b))])
    return _PartnerSums(
        close.sum(dim=1),
        lane_sums(closeness.double(), SAMPLE_LANES),
        lane_sums(cosines.double(), SAMPLE_LANES),
        *squares,
    )


def _summed_compiled(
    source: Scans, target: Scans, pair: Tensor, rotation: Tensor, found: Partners, square_limit: Tensor
) -> _PartnerSums:
    """As ``_summed``."""
    normals = (source.normals, target.all_normals) if _have_normals(source, target) else (None, None)
    colors = (source.colors, target.all_colors) if _have_colors(source, target) else (None, None)
    count, sums = torch.empty_like(pair), torch.empty(2 + 3 * _CHANNELS, len(pair), dtype=torch.float64)
    tensors = (*found, square_limit, pair, rotation, *normals, source.faced, target.all_faced, *colors, count, sums)
    call("partner_sums", *tensors, len(source.counts), target.all_points.shape[1], *found.square.shape)
    return _PartnerSums(count, sums[0], sums[1], *sums[2:].unflatten(0, (3, _CHANNELS)))
