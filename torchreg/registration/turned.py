"""Poses that equal a given one but for a turn that the place itself suggests, with translations by votes of matches.

Rooms, halls and courts have three directions that nearly all of their surfaces face. A turn by one, two or three right
angles about such a direction maps walls to walls: so if the place equals itself in part, then after such a turn. With
the rotation given, every match p, q votes for one translation, t = q - R p, and few of many votes suffice for a peak,
where a solver that has to find the rotation too would need a larger share.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.eigen import symmetric_eigen
from torchreg.geometry.se3 import apply_rotation
from torchreg.solvers import PairPoses
from torchreg.verification.candidates import quarter_turns

_CELL = 3.0  # inlier thresholds, edges of the cells that votes are counted in
_WITHIN = 1.5  # inlier thresholds about a peak, of the votes that are averaged
_ROUNDS = 2  # of averaging
_LEAST = 5  # votes of a peak
_LEAST_COSINES = (0.0,) * 6 + (0.9,) * 4  # of the normals that count, in the rounds that refine main directions


def turned(
    rotation: Tensor, normals: Tensor, source: Tensor, target: Tensor, threshold: float, scored: Tensor
) -> PairPoses:
    """Poses that equal ``rotation`` (3, 3) but for quarter and half turns about the main directions of the target.

    Args:
        rotation: float64, from the source to the target.
        normals: (P, 3) of the target.
        source: (M, 3) float64, meters, matched points, at least one.
        target: (M, 3) float64, meters, row by row the points matched to them.
        threshold: meters, of an inlier.
        scored: (S,) int64, the matches that inliers, support and error are counted over; all vote.

    Returns:
        At most 9, by falling votes, in the frames of the points.
    """
    turns = quarter_turns(_main_directions(normals))
    rotations = apply_rotation(turns[:, None], rotation.t()).transpose(1, 2).contiguous()  # (9, 3, 3)
    votes = target - apply_rotation(rotations[:, None], source)  # (9, M, 3)
    translation = _densest(votes, _CELL * threshold)
    for _ in range(_ROUNDS):
        near = (votes - translation[:, None]).square().sum(dim=-1) < (_WITHIN * threshold) ** 2
        count = near.sum(dim=1)
        mean = torch.where(near[..., None], votes, 0.0).cumsum(dim=1)[:, -1] / count.clamp(min=1)[:, None]
        translation = torch.where(count[:, None] > 0, mean, translation)
    square = (votes - translation[:, None]).square().sum(dim=-1)  # (9, M)
    agreeing = (square < threshold * threshold).sum(dim=1)
    order = agreeing.sort(descending=True, stable=True).indices
    order = order[agreeing[order] >= _LEAST]
    square = square[order][:, scored]
    inliers = square < threshold * threshold
    error = torch.where(inliers, square, 0.0).sum(dim=1)
    number = len(rotations)
    return PairPoses(
        rotations[order], translation[order], inliers, inliers.sum(dim=1), error, number, number, number, None
    )


def _main_directions(normals: Tensor) -> Tensor:
    """(3, 3), rows: orthogonal unit directions a that surfaces with normals n (P, 3) face, maxima of sum (n . a)^4.

    Starting from the principal axes, each round takes a to the sum of (n . a)^3 n, by which normals across a count for
    little (a fixed point of the gradient, as in FastICA: Hyvarinen, Neural Computation 9(7), 1997), and makes the
    three orthogonal again, the one that most surfaces face first. The last rounds leave out normals far from a.
    """
    columns = normals.double().t()  # (3, P)
    axes = symmetric_eigen((columns[:, None] * columns[None]).cumsum(dim=-1)[..., -1])[1].t()
    for least in _LEAST_COSINES:
        along = (axes[:, :, None] * columns[None]).sum(dim=1)  # (3, P)
        along = torch.where(along.abs() > least, along, 0.0)
        drawn = ((along * along * along)[:, None] * columns[None]).cumsum(dim=-1)[..., -1]
        size = drawn.square().sum(dim=1)
        if not bool((size > 0).all()):
            break
        first, second, _ = drawn[size.sort(descending=True, stable=True).indices]
        first = first / first.square().sum().sqrt()
        second = second - (first * second).sum() * first
        second = second / second.square().sum().sqrt().clamp(min=1e-12)
        axes = torch.stack([first, second, torch.linalg.cross(first, second)])
    return axes


def _densest(votes: Tensor, cell: float) -> Tensor:
    """The mean (K, 3) of the votes (K, M, 3), meters, in the fullest cell, of one of two grids half a cell apart."""
    low = votes.amin(dim=1, keepdim=True)  # (K, 1, 3)
    places = torch.stack([torch.floor((votes - low) / cell + shift) for shift in (0.0, 0.5)]).long()  # (2, K, M, 3)
    many = places.amax(dim=(1, 2)) + 1  # (2, 3)
    x, y, z = places.unbind(-1)
    key = (x * many[:, 1, None, None] + y) * many[:, 2, None, None] + z  # (2, K, M)
    ordered = key.sort(dim=-1).values
    counts = torch.searchsorted(ordered, ordered, right=True) - torch.searchsorted(ordered, ordered)
    rank = counts * counts.shape[-1] - torch.arange(counts.shape[-1], device=counts.device)  # the first of equals
    most, at = rank.max(dim=-1)  # (2, K)
    grid = most.argmax(dim=0)[None]  # (1, K)
    fullest = ordered.gather(-1, at[..., None]).gather(0, grid[..., None])[0]  # (K, 1)
    within = key.gather(0, grid[..., None].expand(1, -1, key.shape[-1]))[0] == fullest  # (K, M)
    total = torch.where(within[..., None], votes, 0.0).cumsum(dim=1)[:, -1]
    return total / within.sum(dim=1, keepdim=True)
