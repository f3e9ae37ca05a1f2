"""How well a settled pose is known: residuals, the covariance of the pose, and how firmly each motion is held.

The covariance is that of the jackknife: cells of space are left out in turn, and the poses without each of them spread
about as the pose itself does about the truth (Tukey, 1958; Cameron and Miller, A practitioner's guide to cluster-robust
inference, 2015, doi:10.3368/jhr.50.2.317). Neighboring surfels share points and bends of a surface, so each says less
than its noise suggests; how much less is read from the residuals of whole cells. What all cells have in common no such
rule can see, such as a step of a wall that either scanner sees from its own side: ``INFLATION`` stands for it, measured
on simulated scans (bench/refinement.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import lane_sums
from torchreg.refinement.point_to_plane import jacobian
from torchreg.refinement.settle import Settling
from torchreg.refinement.spread import CUT, FAINT

INFLATION = 2.25
"""Of the jackknife's variances."""

_GENUINE = 0.3  # share of the resistance to a motion: with less, surfaces do not hold it
_LOOSE = 1e4  # times what noise suggests, the error of a motion that nothing holds
_CELLS = (16.0, 8.0, 4.0, 2.0)  # spacings along a cell's edge: the first that gives enough cells
_ENOUGH_CELLS = 30
_LEAST_CELLS = 12  # twice the unknowns


class Certainty(NamedTuple):
    """Of one settled pose; NaN where too few surfels have partners."""

    residuals: Tensor  # (3,) meters: median, root mean square and 95th percentile of the distances to planes
    overlap: Tensor  # scalar, share of the source's surfels that lie on the target's
    covariance: Tensor  # (6, 6) of a small turn about ``center`` (radians) and a shift (meters), target's frame
    center: Tensor  # (3,) meters, in the centered frame of the target
    held: Tensor  # (6,) in [0, 1], how firmly the turns about x, y, z and the shifts along them are held
    size: Tensor  # scalar, meters, root mean square distance of the overlap's surfels from the center


class _Overlap(NamedTuple):
    """The surfels of one pair that lie on planes of the other, N of them."""

    point: Tensor  # (3, N) meters, in the centered frame of the target
    normal: Tensor  # (3, N) of the target's
    own: Tensor  # (3, N) of the source's, on the same side
    distance: Tensor  # (N,) meters, to the planes
    deviation: Tensor  # (N,) meters, by which noise alone moves it
    share: Tensor  # (N,) of the distance at which surfels lose all weight, in (-1, 1)
    of_all: Tensor  # scalar, share of the source's surfels
    shade: _Shade | None  # where colors take part


class _Shade(NamedTuple):
    """Their differences of intensity."""

    slope: Tensor  # (3, N) per meter
    difference: Tensor  # (N,)
    deviation: Tensor  # scalar


def certainty(settling: Settling, number: int, spacing: float) -> Certainty:
    """Of pair ``number``; ``spacing``, meters, is that of its surfels."""
    shared = _overlap_of(settling, number)
    count = len(shared.distance)
    nothing = shared.of_all.new_full((), torch.nan)
    if count < _LEAST_CELLS:
        few = nothing.expand(3)
        return Certainty(few, shared.of_all, nothing.expand(6, 6), few, nothing.expand(6), nothing)
    center = _means(shared.point)
    size = _means((shared.point - center[:, None]).square().sum(dim=0, keepdim=True)).sqrt()  # (1,)
    at = ((shared.point - center[:, None]) / size)[:, None]
    J, other = (  # (6, N), turns in units of 1 / size
        jacobian(at, normal[:, None], shared.distance[None])[:6, 0] for normal in (shared.normal, shared.own)
    )
    units = torch.cat([1 / size.expand(3), torch.ones_like(size).expand(3)])
    estimates = [_Estimate(J, shared.point, shared.distance, shared.share, 1 / shared.deviation.square())]
    if shared.shade is not None and bool(shared.shade.deviation >= FAINT):
        slope, difference, deviation = shared.shade
        bounded = (difference / (CUT * deviation)).clamp(-1, 1)  # beyond, without weight
        rows = jacobian(at, slope[:, None], difference[None])[:6, 0]
        noise = (settling.spread.scale[number] / deviation).square().expand_as(difference)
        estimates.append(_Estimate(rows, shared.point, difference, bounded, noise))
    # where colors take part, what planes leave open is theirs to hold
    growth = _growth(J, other, shared) if shared.shade is None else torch.eye(6, dtype=J.dtype, device=J.device)
    covariance = INFLATION * growth @ _jackknife(estimates, spacing) @ growth.t() * units[:, None] * units
    resisted = torch.diagonal(_inverse(_products(J, torch.ones_like(shared.distance))))
    held = (1 / (count * resisted)).clamp(min=0, max=1).sqrt()
    return Certainty(_residuals(shared), shared.of_all, covariance, center, held, size[0])


def residuals(settling: Settling, number: int) -> Tensor:
    """The residuals of pair ``number`` alone, as in ``Certainty``."""
    return _residuals(_overlap_of(settling, number))


def agreeing(settling: Settling, number: int) -> int:
    """How many surfels of the source of pair ``number`` lie on the target's."""
    return len(_overlap_of(settling, number).distance)


def _residuals(shared: _Overlap) -> Tensor:
    apart = shared.distance.abs()
    if len(apart) < _LEAST_CELLS:
        return apart.new_full((3,), torch.nan)
    return torch.stack([apart.median(), _means(apart.square()[None])[0].sqrt(), _quantile(apart, 0.95)])


def _overlap_of(settling: Settling, number: int) -> _Overlap:
    blocks, shown = settling.matches.blocks, settling.residuals
    end = sum(blocks.counts[: number + 1])
    rows = slice(end - blocks.counts[number], end)
    deviation = (shown.variance[rows] + settling.spread.excess[number]).sqrt()
    share = shown.distance[rows] / deviation / (CUT * settling.spread.scale[number])
    kept = (shown.alike[rows] & (share.abs() < 1)).reshape(-1)

    def chosen(values: Tensor) -> Tensor:
        return values.reshape(*values.shape[:-2], -1)[..., kept]

    shade = None
    if shown.shades is not None and settling.spread.shade is not None:
        slope, difference = chosen(shown.shades.slope[:, rows]), chosen(shown.shades.difference[rows])
        shade = _Shade(slope, difference, settling.spread.shade[number])
    normal, own = chosen(shown.normal[:, rows]), chosen(shown.turned[:, rows])
    return _Overlap(
        point=chosen(settling.matches.moved[:, rows]),
        normal=normal,
        own=torch.where((own * normal).sum(dim=0) < 0, -own, own),
        distance=chosen(shown.distance[rows]),
        deviation=chosen(deviation),
        share=chosen(share),
        of_all=kept.sum().double() / blocks.real[rows].sum(),
        shade=shade,
    )


class _Estimate(NamedTuple):
    """Rows of one kind that the pose is estimated from."""

    J: Tensor  # (6, N)
    point: Tensor  # (3, N) meters
    residual: Tensor  # (N,)
    share: Tensor  # (N,) of the residual at which rows lose all weight, in [-1, 1]
    per_noise: Tensor  # (N,) the inverse of the squared deviation that noise alone gives


def _jackknife(estimates: Sequence[_Estimate], spacing: float) -> Tensor:
    """The covariance (6, 6) of the estimate from rows of several kinds; NaN where there are few cells.

    How stiff the estimate is follows from the slope of Tukey's influence. Where so many residuals are near the cut that
    some motion meets a falling slope, half of the weights stand for it.
    """
    covariance = _left_out(estimates, spacing, lambda squares: (1 - squares) * (1 - 5 * squares))
    if covariance is None:
        covariance = _left_out(estimates, spacing, lambda squares: 0.5 * (1 - squares).square())
    return estimates[0].J.new_full((6, 6), torch.nan) if covariance is None else covariance


def _left_out(estimates: Sequence[_Estimate], spacing: float, stiffness: Callable[[Tensor], Tensor]) -> Tensor | None:
    """The spread (6, 6) of the estimates without each cell; ``None`` where cells are few or a motion meets nothing.

    ``stiffness`` is that of rows by the squares of their shares.
    """
    values = []
    for J, _, residual, share, per_noise in estimates:
        squares = share * share
        pulls = J * ((1 - squares) ** 2 * per_noise * residual)  # (6, N)
        values.append(torch.cat([pulls, (J[:, None] * J * (stiffness(squares) * per_noise)).view(36, -1)]))
    points = torch.cat([each.point for each in estimates], dim=1)
    rows = torch.cat(values, dim=1)  # (42, all N)
    for cells in _CELLS:
        sums = _cell_sums(points, rows, cells * spacing)  # (C, 42)
        if len(sums) >= _ENOUGH_CELLS:
            break
    if len(sums) < _LEAST_CELLS:
        return None
    pull, own = sums[:, :6], sums[:, 6:].view(-1, 6, 6)
    whole = own.cumsum(dim=0)[-1]
    moved = torch.linalg.solve_ex(whole - own, pull)[0]  # (C, 6), the update without each cell
    covariance = (moved[:, :, None] * moved[:, None]).cumsum(dim=0)[-1] * ((len(moved) - 1) / len(moved))
    sound = (torch.linalg.eigvalsh(whole)[0] > 0) & torch.isfinite(covariance).all()
    return covariance if bool(sound) else None


def _growth(J: Tensor, other: Tensor, shared: _Overlap) -> Tensor:
    """What errors grow by (6, 6), since noise in the normals feigns resistance; NaN where a motion meets none.

    Normals that noise tilts seem to resist motions that no surface holds, such as that along a corridor. The noise of
    one cloud's normals has nothing to do with that of the other's: what both resist (J with ``other``, both (6, N)) is
    genuine, as with an instrumental variable (Reiersol, 1941).
    """
    weight = ((1 - shared.share * shared.share) / shared.deviation).square()
    values, vectors = torch.linalg.eigh(_products(J, weight))
    root = values.clamp(min=0).sqrt()
    whitened, back = (vectors / root) @ vectors.t(), (vectors * root) @ vectors.t()
    both = lane_sums(J[:, None] * other * weight)
    if not bool(values[0] > 1e-12 * values[-1]):
        return torch.full_like(both, torch.nan)
    genuine, motions = torch.linalg.eigh(whitened @ ((both + both.t()) / 2) @ whitened)  # shares of the resistance
    by = torch.where(genuine > _GENUINE, 1 / genuine.clamp(min=_GENUINE, max=1), _LOOSE)
    growth: Tensor = whitened @ (motions * by) @ motions.t() @ back
    return growth


def _means(values: Tensor) -> Tensor:
    return lane_sums(values) / values.shape[1]


def _products(J: Tensor, weight: Tensor) -> Tensor:
    """Sum of w J J^T (6, 6) over rows (6, N)."""
    return lane_sums(J[:, None] * J * weight)


def _inverse(matrix: Tensor) -> Tensor:
    """The inverse of a symmetric matrix; infinite on the diagonal where it has none."""
    values, vectors = torch.linalg.eigh(matrix)
    sound = values[0] > 1e-12 * values[-1]
    return torch.where(sound, (vectors / values) @ vectors.t(), torch.inf)


def _cell_sums(points: Tensor, values: Tensor, edge: float) -> Tensor:
    """Sums (C, K) of values (K, N) over cubes of points (3, N), in a fixed order."""
    corner = torch.floor(points / edge).long()
    corner -= corner.amin(dim=1, keepdim=True)
    x, y, z = corner.unbind(0)
    _, cell = ((x * (y.amax() + 1) + y) * (z.amax() + 1) + z).unique(return_inverse=True)
    order = cell.argsort(stable=True)
    ends = torch.bincount(cell).cumsum(0) - 1
    running = values[:, order].cumsum(dim=1)[:, ends]
    return torch.diff(running, dim=1, prepend=torch.zeros_like(running[:, :1])).t()


def _quantile(values: Tensor, share: float) -> Tensor:
    ordered = values.sort().values
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]
