"""What registering a pair found, as links for the graph of a site: every candidate, not only the best."""

from __future__ import annotations

import math

from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.site.links import Link, loose_covariance
from torchreg.types import Clouds, RegistrationResult

_FAINTEST = -12.0  # log-odds: candidates below cannot be right, whatever their neighbors say
_MOST = 12  # candidates of a pair


def links_of(result: RegistrationResult, pair: int, source: int, target: int) -> list[Link]:
    """The candidates of one pair of a result, best first, as links between the scans of these numbers.

    The best one of a pair that succeeded has its refined pose and the covariance of that; the others are as good as
    the inlier threshold that they were found at.
    """
    clouds = result.source.select(pair), result.target.select(pair)
    if min(len(cloud.points) for cloud in clouds) == 0:
        return []
    threshold: float = result.options[pair].inlier_threshold
    middles = [_middle(cloud) for cloud in clouds]
    reach = max(min(_size(cloud) for cloud in clouds), threshold)
    loose = loose_covariance(threshold, reach)
    links = []
    for rank, candidate in enumerate(result.candidates[pair][:_MOST]):
        if candidate.log_odds < _FAINTEST:
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
                log_odds=candidate.log_odds,
                probability=candidate.probability,
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
    return (cloud.points.double().mean(dim=0) + cloud.origin[0]).cpu()


def _size(cloud: Clouds) -> float:
    """The root mean square distance of the points of one cloud from their mean, meters."""
    points = cloud.points.double()
    return math.sqrt(float((points - points.mean(dim=0)).square().sum(dim=1).mean()))
