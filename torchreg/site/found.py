"""What registering a pair found, as links for the graph of a site: every candidate, not only the best.

``register`` refines the poses that it accepts. Here every candidate that has a chance is refined, since where flat
places of both clouds do not hold a pose near where it is, it is hardly right: of right candidates nine in ten could be
refined, of wrong ones four in ten. So log-odds s against none become s + b, and s + b + c where a pose was refined, and
what scanners of known places saw is added (``sight``). Probabilities follow from these as those of ``register`` from
its own (``verification/model.py``). b and c were fitted by likelihood on the pairs of seven real sites; fitted on six
of them, b is -2.1 to -1.3 and c 1.9 to 2.4, and the pairs of the seventh become likelier than by s alone, whichever it
is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import lane_sums
from torchreg.geometry.se3 import apply_rotation
from torchreg.refinement.refine import Refined
from torchreg.registration.refined import size_of
from torchreg.site.links import Link, loose_covariance
from torchreg.types import Clouds, RegistrationResult

_LOWER, _REFINED = -1.8, 2.1  # b and c
_UNREFINED = 0.4  # inlier thresholds: deviation of a right candidate that was not refined (measured: 0.1 to 0.4)
_FAINTEST = -12.0  # log-odds s: candidates below cannot be right, whatever their neighbors say
_CHANCE = -2.2  # log-odds s: candidates above are refined
_MOST = 12  # candidates of a pair


def links_of(result: RegistrationResult, pair: int, source: int, target: int) -> list[Link]:
    """The candidates of one pair of a result, best first, as links between the scans of these numbers.

    The best one of a pair that succeeded has its refined pose and the covariance of that; the others are known to a
    part of the inlier threshold. Log-odds and probabilities are those of ``register``. A pair whose clouds no rigid
    pose can join, such as mirrored ones, has no links.
    """
    clouds = result.source.select(pair), result.target.select(pair)
    candidates = result.candidates[pair]
    if min(len(cloud.points) for cloud in clouds) == 0 or not any(each.probability > 0 for each in candidates):
        return []
    threshold: float = result.options[pair].inlier_threshold
    middles = [_middle(cloud) for cloud in clouds]
    reach = max(min(size_of(cloud) for cloud in clouds), threshold)
    loose = loose_covariance(_UNREFINED * threshold, reach)
    links = []
    for rank, candidate in enumerate(candidates[:_MOST]):
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


def has_chance(link: Link) -> bool:
    """Whether a candidate, with ``register``'s log-odds, is worth refining, and was not refined yet."""
    return math.isnan(link.residual) and is_worth_a_look(link)


def is_worth_a_look(link: Link) -> bool:
    """Whether a candidate, with ``register``'s log-odds, may be right."""
    return link.log_odds > _CHANCE


def weighed(links: Sequence[Link]) -> list[Link]:
    """The candidates of one pair with their log-odds and probabilities among the links of a site."""
    return with_odds(links, [_odds(one) for one in links])


def _odds(link: Link) -> float:
    odds = link.log_odds + _LOWER + (0.0 if math.isnan(link.residual) else _REFINED)
    if not math.isnan(link.sight):
        odds += link.sight
    return odds


def with_odds(links: Sequence[Link], odds: Sequence[float]) -> list[Link]:
    """The candidates of one pair with these log-odds against none, and the probabilities that follow."""
    wide = torch.tensor([0.0, *odds], dtype=torch.float64)
    chances = torch.softmax(wide, dim=0)[1:].tolist()
    parts = zip(links, odds, chances, strict=True)
    return [link.weighed(value, chance) for link, value, chance in parts]


def refined_link(link: Link, refined: Refined, pair: int) -> Link:
    """A link with the pose of one pair after refinement and its covariance; as it was where there is none."""
    if refined.reason[pair] or not bool(refined.covariance[pair].isfinite().all()):
        return link
    return replace(
        link,
        T_target_source=refined.T_target_source[pair].cpu(),
        covariance=refined.covariance[pair].cpu(),
        center=refined.center[pair].cpu(),
        residual=float(refined.residuals[pair, 0]),
    )


def _middle(cloud: Clouds) -> Tensor:
    """The mean (3,) float64 of the points of one cloud, in the frame of its file."""
    return (lane_sums(cloud.points.double(), dim=0) / len(cloud.points) + cloud.origin[0]).cpu()
