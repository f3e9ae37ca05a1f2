"""What registering a pair found, as links for the graph of a site: every candidate, not only the best.

``register`` is cautious in the middle: on real sites, nearly all pairs to which it gives 0.3 to 0.5 were right. A pair
alone may well be refused then; but what holds a site together should be weighed for what it is. So
log-odds s of candidates against none become a s + b, and their probabilities follow from these as ``register``'s do
from its own (``verification/model.py``). Fitted by likelihood on the pairs of all sites but one, a is 2.0 to 2.3 and b
1.8 to 2.0, whichever is left out, and its pairs become likelier each time.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import row_sums
from torchreg.geometry.se3 import apply_rotation
from torchreg.site.links import Link, loose_covariance
from torchreg.types import Clouds, RegistrationResult

_STEEPER, _HIGHER = 2.2, 1.9  # a and b
_UNREFINED = 0.4  # inlier thresholds: deviation of a right candidate that was not refined (measured: 0.1 to 0.4)
_FAINTEST = -16.0  # log-odds: candidates below cannot be right, whatever their neighbors say
_MOST = 12  # candidates of a pair


def links_of(result: RegistrationResult, pair: int, source: int, target: int) -> list[Link]:
    """The candidates of one pair of a result, best first, as links between the scans of these numbers.

    The best one of a pair that succeeded has its refined pose and the covariance of that; the others are known to a
    part of the inlier threshold. A pair whose clouds no rigid pose can join, such as mirrored ones, has no links.
    """
    clouds = result.source.select(pair), result.target.select(pair)
    candidates = result.candidates[pair]
    if min(len(cloud.points) for cloud in clouds) == 0 or not any(each.probability > 0 for each in candidates):
        return []
    odds = torch.tensor([_STEEPER * each.log_odds + _HIGHER for each in candidates], dtype=torch.float64)
    chances = torch.softmax(torch.cat([odds.new_zeros(1), odds]), dim=0)[1:].tolist()
    threshold: float = result.options[pair].inlier_threshold
    middles = [_middle(cloud) for cloud in clouds]
    reach = max(min(_size(cloud) for cloud in clouds), threshold)
    loose = loose_covariance(_UNREFINED * threshold, reach)
    links = []
    for rank, candidate in enumerate(candidates[:_MOST]):
        if float(odds[rank]) < _FAINTEST:
            break
        T, covariance, residual = candidate.T_target_source.cpu(), loose, math.nan
        center = (apply_rotation(T[:3, :3], middles[0]) + T[:3, 3] + middles[1]) / 2
        if rank == 0 and bool(result.success[pair]):
            T = result.T_target_source[pair].cpu()
            if result.covariance is not None and bool(result.covariance[pair].isfinite().all()):
                covariance, center = result.covariance[pair].cpu(), result.center[pair].cpu()  # type: ignore[index]
                residual = float(result.residual_median[pair])  # type: ignore[index]
        links.append(
            Link(
                target=target,
                source=source,
                T_target_source=T,
                log_odds=float(odds[rank]),
                probability=chances[rank],
                covariance=covariance,
                center=center,
                overlap=candidate.overlap,
                residual=residual,
                rank=rank,
                reason=result.reason[pair] if rank == 0 else "",
            )
        )
    return links


def _middle(cloud: Clouds) -> Tensor:
    """The mean (3,) float64 of the points of one cloud, in the frame of its file."""
    return (_mean(cloud.points.double()) + cloud.origin[0]).cpu()


def _size(cloud: Clouds) -> float:
    """The root mean square distance of the points of one cloud from their mean, meters."""
    points = cloud.points.double()
    return math.sqrt(float(_mean((points - _mean(points)).square()).sum()))


def _mean(rows: Tensor) -> Tensor:
    """The mean (3,) of rows (P, 3), summed in a fixed order."""
    return row_sums(rows.t().contiguous()) / len(rows)
