"""The votes of neighbors in the volumes of SHOT, each shared with the next volumes and the next bin.

Around a point the ball of radius R is cut, in the local reference frame, into 8 sectors of azimuth, the halves below
and above, and the shells within and beyond R / 2: 32 volumes, each with a histogram. A neighbor has a place between two
centers along four axes: with s the distance from its own center in widths, |s| <= 1/2,

    azimuth        atan2(y, x), centers 45 degrees apart
    elevation      acos(z / d), centers at 45 and 135 degrees, 90 apart
    distance       d, centers at R / 4 and 3 R / 4
    histogram      the value that is counted, one bin apart

the next center gets |s| and its own 1 - |s|, so that its own bin gets 4 - sum |s|. Beyond the outermost centers of
elevation and distance there is no next one, and |s| is lost. That is quadrilinear interpolation as PCL computes it: the
sum over the four axes, not the product.

Angles are differences from the middle of an octant, atan((m - t M) / (M + t m)) with t = tan(pi / 8), 0 <= m <= M: of
the smaller to the larger of |x| and |y| for the azimuth, and of half the elevation, tan(e / 2) = |(x, y)| / (d + |z|).
So one polynomial over a short range gives both, of basic operations that round the same everywhere, and as exactly near
the axes as elsewhere.

Votes are summed as whole numbers of 2^-26 (float64: 2^-44), so that no order of neighbors shows in a bit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.derivatives import TensorFunction, derivative_wanted, transformed

SECTORS = 8
VOLUMES = 4 * SECTORS

# atan(u) / (pi / 4) = u p(u^2) for |u| <= tan(pi / 8): p by its values at Chebyshev nodes, off by 8e-10 and 2e-18
_SINGLE = (
    1.2732395439341369, -0.4244128447752156, 0.2546247663455563, -0.181303205944093, 0.13457808430813653,
    -0.07672631859027536,
)  # fmt: skip
_DOUBLE = (
    1.2732395447351628, -0.42441318157838487, 0.25464790894627926, -0.18189136345122475, 0.1414710558602918,
    -0.11574889304741591, 0.09793816121605757, -0.08483531737856924, 0.07444461961793958, -0.06410824509102485,
    0.048337142777222564, -0.022668624940243152,
)  # fmt: skip
TAN_PI_8 = 0.41421356237309503


def angle_coefficients(dtype: torch.dtype) -> tuple[float, ...]:
    """The coefficients of the polynomial that gives angles, lowest first."""
    return _DOUBLE if dtype == torch.float64 else _SINGLE


def vote_steps(dtype: torch.dtype) -> float:
    """What part of a vote is counted as one."""
    return 2.0**44 if dtype == torch.float64 else 2.0**26


class Places(NamedTuple):
    """Where neighbors lie among the volumes, each (r, K)."""

    volume: Tensor  # int64 in [0, 32)
    own: Tensor  # the vote for it, in [0, 3], from azimuth, elevation and distance
    next_volumes: tuple[Tensor, Tensor, Tensor]  # int64; along distance, elevation and azimuth
    shares: tuple[Tensor, Tensor, Tensor]  # the votes for them, in [0, 1/2]


def places(x: Tensor, y: Tensor, z: Tensor, counted: Tensor, radius: Tensor) -> Places:
    """Places of neighbors by their coordinates (r, K) in the local frame, in supports of radius (r, 1).

    Votes are zero where ``counted`` is false. Gradients flow to coordinates, finite on the axes.
    """
    flat = x * x + y * y
    square = flat + z * z
    counted = counted & (square > 0)
    across, length = _root(flat, flat > 0), _root(square, counted)
    relative = (length / radius).clamp(max=1)
    outer = relative > 0.5
    outward = torch.where(outer, 1.5 - 2 * relative, 2 * relative - 0.5)  # towards the other shell
    downward = _octant(across, torch.where(counted, length + z.abs(), 1.0))  # towards the other half
    sector = _sector(x, y)
    longer, shorter = torch.maximum(x.abs(), y.abs()), torch.minimum(x.abs(), y.abs())
    around = longer > 0
    rising = _octant(shorter, torch.where(around, longer, 1.0))
    turn = torch.where(sector % 2 == 0, rising, -rising)  # towards a larger azimuth
    weight, weight_around = counted.to(x.dtype), (counted & around).to(x.dtype)
    above = (z > 0).long()
    volume = 4 * sector + 2 * outer.long() + above
    own = ((1 - outward.abs()) + (1 - downward.abs())) * weight + (1 - turn.abs()) * weight_around
    return Places(
        volume,
        own,
        (
            volume + 2 - 4 * outer.long(),
            volume + 1 - 2 * above,
            (volume + torch.where(turn > 0, 4, VOLUMES - 4)) % VOLUMES,
        ),
        (outward.clamp(min=0) * weight, downward.clamp(min=0) * weight, turn.abs() * weight_around),
    )


def votes(place: Places, value: Tensor, counted: Tensor, bins: int) -> tuple[Tensor, Tensor]:
    """Bins (r, 5 K) int64 and the votes for them, of values (r, K) in [0, bins] in histograms of bins + 1 each.

    As in PCL, what passes from the last bin but one to the last goes to the first instead. No other value, NaN neither,
    leaves the histogram.
    """
    nearest = (value.detach() + 0.5).floor()
    beside = value - nearest
    step = nearest.long().clamp(0, bins)
    next_step = torch.where(beside > 0, step + 1, step + bins - 1) % bins
    weight = counted.to(value.dtype)
    width = bins + 1
    index = [place.volume * width + step, place.volume * width + next_step]
    index += [volume * width + step for volume in place.next_volumes]
    shares = [place.own + (1 - beside.abs()) * weight, beside.abs() * weight, *place.shares]
    return torch.cat(index, dim=1), torch.cat(shares, dim=1)


def histograms(index: Tensor, shares: Tensor, size: int) -> Tensor:
    """Histograms (r, size) float64 of votes (r, N) for bins (r, N): exact sums of rounded votes.

    Gradients flow to votes as if they were not rounded.
    """
    if transformed(shares):
        return shares.new_zeros(shares.shape[0], size).scatter_add(1, index, shares).double()
    return _ExactSums.call(index, shares, size) if derivative_wanted(shares) else _sums(index, shares, size)


def unit_rows(rows: Tensor, sums: Tensor) -> Tensor:
    """Rows (r, D) divided by the roots of sums of squares (r,); zero where those are."""
    some = sums > 0
    return rows * torch.where(some, torch.where(some, sums, 1.0).rsqrt(), 0.0)[:, None]


class _ExactSums(TensorFunction):
    @staticmethod
    def forward(ctx: Any, index: Tensor, shares: Tensor, size: int) -> Tensor:  # noqa: ANN401
        ctx.save_for_backward(index)
        ctx.dtype = shares.dtype
        return _sums(index, shares, size)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[None, Tensor, None]:  # noqa: ANN401
        return None, grads[0].gather(1, ctx.saved_tensors[0]).to(ctx.dtype), None


def _sums(index: Tensor, shares: Tensor, size: int) -> Tensor:
    steps = vote_steps(shares.dtype)
    counts = (shares.detach() * steps).long()
    return counts.new_zeros(len(index), size).scatter_add_(1, index, counts).double() * (1 / steps)


def _octant(shorter: Tensor, longer: Tensor) -> Tensor:
    """(atan(shorter / longer) - pi / 8) / (pi / 4), in [-1/2, 1/2]; ``longer`` is above zero."""
    u = (shorter - TAN_PI_8 * longer) / (longer + TAN_PI_8 * shorter)
    square = u * u
    *rest, last = angle_coefficients(u.dtype)
    result = square * last + rest[-1]
    for coefficient in reversed(rest[:-1]):
        result = result * square + coefficient
    return result * u


def _sector(x: Tensor, y: Tensor) -> Tensor:
    """Which eighth of the circle, from azimuth -pi on, a direction points into: int64 in [0, 8).

    On the borders as in PCL: a turn of the frame by 180 degrees is one of the sector by 4.
    """
    upper = (y > 0) | ((y == 0) & (x < 0))
    right = (x > 0) | ((x == 0) & (y > 0))
    same = ((x > 0) & (y > 0)) | ((x < 0) & (y < 0)) | (x == 0)
    steep = x.abs() < y.abs()
    flat = x.abs() > y.abs()
    return 4 * upper.long() + 2 * (right ^ upper).long() + torch.where(same, steep, flat).long()


def _root(square: Tensor, above: Tensor) -> Tensor:
    """Square roots where ``above``, else zero, with a gradient of zero."""
    safe = torch.where(above, square, 1.0)
    return torch.where(above, safe * safe.rsqrt(), 0.0)
