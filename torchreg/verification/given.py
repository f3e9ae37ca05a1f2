"""The verdict on a pose that the caller gave, among all candidates of its pair.

The given pose is refined by ICP and competes; candidates within a few inlier thresholds of one another count as one,
so that it stands or falls with the best of those about it. It settles to where ICP takes it, or to that best one where
this is clearly better: ICP stops short of poses that are farther away than its partners. The given pose is right where
that best one wins and is trusted as any winner is, and where the given pose itself lies within one inlier threshold of
the pose that it settles to, root mean square over the source's points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.neighborhoods.coverage import coverage
from torchreg.solvers import PairPoses
from torchreg.solvers.poses import no_pose
from torchreg.solvers.scoring import orthonormal
from torchreg.types import Candidate, Clouds, Correspondences, Failure
from torchreg.types.packing import offsets_of
from torchreg.verification.candidates import Candidates, joined
from torchreg.verification.impostors import IMPOSTORS
from torchreg.verification.pairs import GIVEN, CenteredPair, ProposedPoses, middle
from torchreg.verification.reasons import Displacement, displacement, failure_of, least_margin

_DISPLACED = "displaced"


class GivenVerdict(NamedTuple):
    """On the given pose of one pair; transforms between the frames of the files."""

    pose: Candidate  # exactly as given, with what supports it
    settled: Candidate  # the pose that it settles to
    rival: Candidate | None  # the best of the candidates that are not about it
    likeliest: Candidate  # the best of all
    displacement: Displacement  # from the given pose to the settled one
    fitness: float  # at the given pose
    inlier_rmse: float  # at the given pose, meters
    failure: Failure | None


def given_poses(
    source: Clouds, target: Clouds, T_target_source: Tensor, refused: Sequence[Failure | None]
) -> ProposedPoses:
    """Propose one given pose of every pair, origins included, but of those that are refused; it comes without matches.

    Args:
        source: B clouds.
        target: B clouds.
        T_target_source: (B, 4, 4) float64, meters, rigid but for the digits that a file lacks.
        refused: why a pair has no pose.
    """
    device = source.device
    none = torch.zeros(0, dtype=torch.int64, device=device)
    matches = Correspondences(none, none, offsets_of([0] * len(source)), source.points.new_zeros(0))
    R, t = T_target_source[:, :3, :3], T_target_source[:, :3, 3]
    t = apply_rotation(R, source.origin) + t - target.origin
    clouds, poses = source.unpack(), []
    for b, failure in enumerate(refused):
        pose = no_pose(0, device, failure)
        if failure is None:
            center = middle(clouds[b])
            moved = apply_rotation(R[b], center) + t[b]
            rotation = orthonormal(R[b, ..., None])[..., 0]  # about the cloud, which therefore stays where it is put
            one = torch.zeros(1, dtype=torch.float64, device=device)
            pose = PairPoses(
                rotation=rotation[None],
                translation=(moved - apply_rotation(rotation, center))[None],
                inliers=torch.zeros(1, 0, dtype=torch.bool, device=device),
                support=one.long(),
                error=one,
                drawn=1,
                kept=1,
                scored=1,
                failure=None,
            )
        poses.append(pose)
    return ProposedPoses(GIVEN, matches, poses)


def given_verdict(
    pair: CenteredPair,
    weighed: Candidates,
    described: tuple[Candidate, ...],
    failure: Failure | None,
    given: Candidates,
    exact: Sequence[Candidate],
    within_reach: int,
    least: float,
) -> GivenVerdict:
    """Judge the given pose of one pair.

    Args:
        pair: the clouds.
        weighed: all candidates, best first.
        described: the same for the result, with their probabilities.
        failure: why the best of them is refused, ``None`` where it is not.
        given: the pose as given, and refined: two rows.
        exact: the same for the result; their probability is not yet known.
        within_reach: the row of the candidate that the refined pose repeats.
        least: the least probability of a success.
    """
    points, threshold, poses = pair.source.points, pair.lengths.threshold, given.poses
    order = [within_reach, *(row for row in range(len(described)) if row != within_reach)]
    ranked, among = [described[row] for row in order], weighed.take(torch.tensor(order, device=points.device))
    settled, enough = exact[1]._replace(probability=ranked[0].probability), least_margin(weighed.evidence)
    if float(among.odds[0] - given.odds[1]) >= enough:
        settled = ranked[0]
        poses = joined([poses, among.poses.take(slice(1))]).take(torch.tensor([0, 2], device=points.device))
    moved = displacement(poses, points)
    if failure is None or failure.kind not in IMPOSTORS:
        if within_reach > 0 and _clearly_better(weighed, within_reach, least):
            away = displacement(joined([given.poses.take(slice(1)), weighed.poses.take(slice(1))]), points)
            failure = _outdone(away, ranked, exact[0], trusted=failure is None)
        elif within_reach > 0:
            failure = failure_of(among, [each.probability for each in ranked], ranked[0].strength, points, least)
        elif failure is None and moved.meters > threshold:
            failure = _displaced(moved, threshold, ranked[0].probability)
    probability = ranked[0].probability if moved.meters <= threshold else 0.0
    rotation, translation = given.poses.rotation[0], given.poses.translation[0]
    near = coverage(points, pair.target.points, rotation, translation, threshold)
    return GivenVerdict(
        pose=exact[0]._replace(probability=probability),
        settled=settled,
        rival=ranked[1] if len(ranked) > 1 else None,
        likeliest=described[0],
        displacement=moved,
        fitness=float(near.fitness),
        inlier_rmse=float(near.inlier_rmse),
        failure=failure,
    )


def moved_on(verdict: GivenVerdict, moved: Displacement, threshold: float) -> GivenVerdict:
    """The verdict with another displacement: from the given pose to the settled one, refined once more.

    ``threshold``, meters, is what is allowed; other reasons than the displacement stay.
    """
    probability, failure = verdict.settled.probability, verdict.failure
    if failure is None or failure.kind == _DISPLACED:
        failure = _displaced(moved, threshold, probability) if moved.meters > threshold else None
    pose = verdict.pose._replace(probability=probability if moved.meters <= threshold else 0.0)
    return verdict._replace(displacement=moved, failure=failure, pose=pose)


def _clearly_better(weighed: Candidates, row: int, least: float) -> bool:
    """Whether the best candidate beats this one as a success beats its runner-up, and can be right itself."""
    margin = float(weighed.odds[0] - weighed.odds[row])
    return margin >= least_margin(weighed.evidence) and float(torch.sigmoid(weighed.odds[0])) >= least


def _displaced(moved: Displacement, threshold: float, probability: float) -> Failure:
    text = (
        f"{_DISPLACED}: {moved.meters:.3g} m and {moved.degrees:.3g} degrees from the pose that it settles to, which "
        f"has a probability of {_stated(probability)}; {threshold:.3g} m are allowed"
    )
    figures = {"meters": moved.meters, "degrees": moved.degrees, "allowed": threshold}
    return Failure(_DISPLACED, text, {**figures, "settled_probability": probability})


def _outdone(away: Displacement, ranked: Sequence[Candidate], exact: Candidate, *, trusted: bool) -> Failure:
    """By the best candidate, so far away, which stands behind that of the given pose in ``ranked``."""
    meters, degrees = away
    own, best = ranked[:2]
    margin = best.log_odds - own.log_odds
    text = (
        f"another pose is better: {meters:.3g} m and {degrees:.3g} degrees away, probability "
        f"{_stated(best.probability)}, log-odds {margin:.2f} above this one; here {exact.overlap:.0%} of the points "
        f"find a partner, there {best.overlap:.0%}"
    )
    text += "" if trusted else "; that pose is not trusted either"
    figures = {"rival_meters": meters, "rival_degrees": degrees, "margin": -margin}
    probabilities = {"probability": own.probability, "rival_probability": best.probability}
    return Failure("another pose is better", text, figures | probabilities)


def _stated(probability: float) -> str:
    """To three digits, never rounded up to certainty."""
    return f"{math.floor(1000 * probability) / 1000:.3f}"
