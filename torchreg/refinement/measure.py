"""What the surfaces of two clouds say about the pose between them, when they are about in place.

One Gauss-Newton step of ``settle`` from the present pose: the pose that the surfels of the overlap ask for, with the
covariance of ``certainty``. Where many scans share surfaces, no pair is settled alone; each says where it would go and
how firmly, and all poses follow from all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.refinement.blocks import dot, turned
from torchreg.refinement.certainty import Certainty, certainty
from torchreg.refinement.gauss_newton import solve
from torchreg.refinement.pairing import Pairing, enter, leave
from torchreg.refinement.settle import Settling, SurfelPairs
from torchreg.refinement.spread import normal_equations, residual_spread
from torchreg.refinement.surfels import Surfels

_LEAST = 1e-6  # meters, at the size of the overlap: a deviation that no covariance goes below
_MOST = 10.0  # times the reach, likewise: nothing is known beyond


class Measured(NamedTuple):
    """The pose of one pair that its surfaces ask for."""

    T_target_source: Tensor  # (4, 4) float64, origins included
    covariance: Tensor  # (6, 6) of a small turn (radians) about ``center`` and a shift (meters), target's frame
    center: Tensor  # (3,) meters, in the target's frame, origin included: the middle of the overlap
    residuals: Tensor  # (3,) meters: median, root mean square, 95th percentile of the surfels' distances to planes


def measure(
    source: Surfels,
    target: Surfels,
    pairing: Pairing,
    T_target_source: Tensor,
    reach: Sequence[float],
) -> list[Measured | None]:
    """Measure B pairs at their present poses.

    Where the scanners of both clouds are known, the two faces of one wall are no partners.

    Args:
        source: surfels of clouds, none of which is empty.
        target: likewise.
        pairing: which of them make the pairs.
        T_target_source: (B, 4, 4) float64, rigid, origins included.
        reach: B numbers, meters: how far partners may be apart; two spacings of surfels at least.

    Returns:
        Of each pair what it asks for; ``None`` where its overlap is too small to say. A pair has the same bits alone
        and in any batch.
    """
    pairs = SurfelPairs(source, target, pairing)
    R, t = enter(pairs.frames, T_target_source)
    limit = torch.maximum(torch.tensor(reach, dtype=torch.float64, device=R.device), pairs.nearest)
    matches = pairs.matched(R, t, limit)
    shown = pairs.residuals(matches, R)
    spread = residual_spread(shown, matches.blocks)
    update = solve(normal_equations(shown, matches, spread), pairs.frames.target_center)
    onwards = apply_rotation(update.rotation[:, None], R.transpose(1, 2)).transpose(1, 2)
    moved = apply_rotation(update.rotation, t) + update.translation
    sound = update.usable & (pairs.displacement(range(len(R)), onwards, moved, R, t) < limit)

    block = matches.blocks.pair
    matches.moved = turned(update.rotation[block], matches.moved) + update.translation[block].t()[:, :, None]
    shown = shown._replace(
        distance=dot(matches.moved - matches.partner[:3], shown.normal),
        turned=turned(update.rotation[block], shown.turned),
    )
    count = len(R)
    settling = Settling(
        matches, shown, residual_spread(shown, matches.blocks), onwards, moved, [True] * count, [1] * count
    )
    T = leave(pairs.frames, onwards, moved)
    middle = pairs.frames.target_center + pairs.frames.target_origin
    return [
        _measured(T[b], middle[b], certainty(settling, b, float(pairs.spacing[b])), float(limit[b])) if usable else None
        for b, usable in enumerate(sound.tolist())
    ]


def _measured(T: Tensor, middle: Tensor, known: Certainty, reach: float) -> Measured | None:
    if not bool(known.covariance.isfinite().all()):
        return None
    unit = torch.cat(
        [(1 / known.size).expand(3), torch.ones_like(known.size).expand(3)]
    )  # of 1 m at the overlap's size
    even = known.covariance / unit[:, None] / unit
    values, vectors = torch.linalg.eigh((even + even.t()) / 2)
    values = values.clamp(min=_LEAST**2, max=(_MOST * reach) ** 2)
    covariance = (vectors * values) @ vectors.t() * unit[:, None] * unit
    return Measured(T, (covariance + covariance.t()) / 2, known.center + middle, known.residuals)
