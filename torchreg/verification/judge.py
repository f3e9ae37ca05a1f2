"""The verdict on every pair of a batch: poses of all proposals in, one transform with its probability out.

The candidates of a pair compete on its clouds: all poses are weighed, the best are refined, and poses that the
solvers did not propose are tried beside the best. All pairs of a group take every step together; the verdict on a pair
depends on that pair alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.geometry.numerics.threads import shared_out
from torchreg.native import kernel_threads
from torchreg.refinement.icp import refine_pairs
from torchreg.refinement.options import IcpOptions
from torchreg.refinement.pairing import Pairing
from torchreg.types import Clouds
from torchreg.types.packing import offsets_of
from torchreg.verification.agreement import agreement
from torchreg.verification.candidates import (
    Candidates,
    Choice,
    GivenPoses,
    Poses,
    distinct,
    frames,
    joined,
    point_moments,
    runs_of,
    slides,
    turns,
)
from torchreg.verification.evidence import Overlap, evidence, overlap
from torchreg.verification.information import WeakestMotion, information_matrices, weakest_motions
from torchreg.verification.model import log_odds
from torchreg.verification.pairs import (
    GIVEN,
    OverlapFeatures,
    PairLengths,
    PreparedPairs,
    ProposedPoses,
    WorkPerPair,
    centered_pair,
    groups_of,
    initial_poses,
    match_endpoints,
    prepared_pairs,
    work_of_pairs,
)
from torchreg.verification.scans import even_rows
from torchreg.verification.verdicts import JudgedPair, Verdict, judged_pair, no_pose, verdicts

_APART = 6.0  # inlier thresholds by which distinct poses move the source at least (rms); ICP bridges less
_PROBE_GAP = 3.5  # log-odds below the best at which a probe is not worth refining
_ICP_POINTS = 600  # of each source


def judge_poses(
    source: Clouds,
    target: Clouds,
    proposed: Sequence[ProposedPoses],
    lengths: Sequence[PairLengths],
    features: Sequence[OverlapFeatures],
    work: WorkPerPair,
) -> list[JudgedPair]:
    """Choose among the candidate poses of every pair and judge the choice; ``collect`` makes a result of the verdicts.

    Args:
        source: B clouds with normals.
        target: B clouds with normals.
        proposed: at least one. That with the origin ``GIVEN``, if any, has one pose of every pair that has poses;
            it competes like the others, and the verdict on a pair then has one on this pose too.
        lengths: one per pair.
        features: one per pair.
        work: spent per pair.

    Returns:
        The verdict on every pair, with the matches of the proposal that supports the pose most. No gradients.
    """
    source, target = source.detach(), target.detach()
    sources, targets, names = source.unpack(), target.unpack(), [part.origin for part in proposed]
    given = names.index(GIVEN) if GIVEN in names else None
    # one row per pair, with a column per proposal
    matches = list(zip(*(match_endpoints(source, target, part) for part in proposed), strict=True))
    poses = list(zip(*(part.poses for part in proposed), strict=True))

    def judge(members: Sequence[int]) -> list[Verdict]:
        pairs = [
            centered_pair(sources[b], targets[b], matches[b], poses[b], lengths[b], features[b], work.poses)
            for b in members
        ]
        choice = choose(prepared_pairs(pairs, work.sample), initial_poses(pairs), work, given)
        return verdicts(pairs, choice, names, work.accepted)

    workers = kernel_threads() if source.device.type == "cpu" else 1
    groups = groups_of(work_of_pairs(source, target, proposed, work), workers)
    judged: dict[int, Verdict] = {}
    for members, group in zip(groups.small, shared_out(judge, groups.small, workers), strict=True):
        judged.update(zip(members, group, strict=True))
    for b in groups.large:  # alone, and every operation on all threads
        judged[b] = judge([b])[0]
    every = [judged[b] if b in judged else no_pose(poses[b][0]) for b in range(len(source))]
    return [judged_pair(verdict, proposed[verdict.proposal], source, target, b) for b, verdict in enumerate(every)]


def choose(pairs: PreparedPairs, poses: Poses, work: WorkPerPair, given: int | None = None) -> Choice:
    """Choose among the poses of every pair.

    ``poses``, at least one of every pair, come pair by pair, in order of their proposals, best first within each.
    ``given`` is the number of the proposal that has the given pose of every pair, which is refined whatever its odds.
    """
    source, target = pairs.source, pairs.target

    def best_held(candidates: Candidates) -> tuple[Candidates, Overlap, WeakestMotion]:
        """The best candidate of every pair, the overlap under it, and the motion that this overlap resists least."""
        best = candidates.take(_foremost(candidates, 1))
        shared = overlap(source, target, best.poses.rotation, best.poses.translation, pairs.threshold)
        return best, shared, weakest_motions(*shared)

    span = frames(point_moments(source.points, source.valid, source.counts), pairs.threshold)
    middle = point_moments(target.points, target.valid, target.counts)
    icp = _Icp(pairs, work.iterations)
    found, parts = weigh(pairs, poses), []
    if given is not None:  # beside the search, which goes on as it does without
        is_given = poses.origin == given
        as_given, found = found.take(is_given), found.take(~is_given)
        refined_given = icp.refine(as_given)
        parts = [refined_given]
    if len(found.odds) > 0:
        found = _distinct(pairs, span, found)
        foremost = found.take(_foremost(found, work.refined))
        parts += [icp.refine(foremost), found]
    candidates = _distinct(pairs, span, joined(parts))

    best, shared, motion = best_held(candidates)
    probes = joined([slides(best.poses, motion, pairs.threshold), turns(best.poses, middle)])
    probed = weigh(pairs, probes.take(probes.pair.sort(stable=True).indices))
    promising = (probed.odds > best.odds[probed.poses.pair] - _PROBE_GAP).nonzero()[:, 0]
    if len(promising) > 0:
        refined = icp.refine(probed.take(promising))
        candidates = _distinct(pairs, span, joined([candidates, refined]))
        _, shared, motion = best_held(candidates)

    of_given = None
    if given is not None:
        # one of the candidates is within reach of it from here on
        candidates = _distinct(pairs, span, joined([candidates, refined_given]))
        of_given = GivenPoses(as_given, refined_given, _within_reach(pairs, span, candidates, refined_given.poses))
    in_file = shared.points.double() + target.origin.t()[..., None]
    sampled = torch.tensor(source.sizes, device=in_file.device) / source.counts.clamp(min=1)
    information = information_matrices(in_file, shared.valid) * sampled[:, None, None]
    return Choice(candidates, information, motion, of_given)


def weigh(pairs: PreparedPairs, poses: Poses) -> Candidates:
    """Weigh poses, those of each pair together: evidence of the clouds and agreement of the matches, as log-odds."""
    shown = evidence(pairs.source, pairs.target, poses.pair, poses.rotation, poses.translation, pairs.threshold)
    runs = runs_of(poses.pair)
    supports, surprises = [], []
    for number in range(len(pairs.matches[0])):
        agreements = [
            agreement(pairs.matches[pair][number], poses.rotation[begin:end], poses.translation[begin:end])
            for pair, begin, end in runs
        ]
        supports.append(torch.cat([part.support for part in agreements]))
        surprises.append(torch.cat([part.surprise for part in agreements]))
    surprise, proposal = torch.stack(surprises).max(dim=0)  # over proposals
    support = torch.stack(supports).gather(0, proposal[None])[0]
    # pair by pair, since logarithms round differently at the end of a range
    odds = [log_odds(shown.take(slice(begin, end)), surprise[begin:end]) for _, begin, end in runs]
    return Candidates(poses, shown, support, proposal, surprise, torch.cat(odds))


class _Icp:
    """ICP for poses of a group of pairs, all at once, on clouds that are thinned once."""

    def __init__(self, pairs: PreparedPairs, iterations: int) -> None:
        """Thin the clouds of the pairs."""
        self._pairs = pairs
        source, target = pairs.source, pairs.target
        rows = even_rows(source.sizes, _ICP_POINTS, source.all_points.device)
        self._source = Clouds(
            points=source.all_points[:, torch.cat(rows)].t().contiguous(), offsets=offsets_of(map(len, rows))
        )
        self._target = Clouds(
            points=target.all_points.t().contiguous(),
            offsets=offsets_of(target.sizes),
            normals=None if target.all_normals is None else target.all_normals.t().contiguous(),
        )
        self._options = [
            IcpOptions(kind="point_to_plane", max_distance=threshold, iterations=iterations)
            for threshold in pairs.threshold.tolist()
        ]

    def refine(self, candidates: Candidates) -> Candidates:
        """The poses after ICP, each as it was where that lowers its odds."""
        numbers = candidates.poses.pair.tolist()
        result = refine_pairs(
            self._source,
            self._target,
            Pairing(numbers, numbers),
            candidates.poses.matrices(),
            [self._options[pair] for pair in numbers],
        )
        T = result.T_target_source
        moved = candidates.poses._replace(rotation=T[:, :3, :3], translation=T[:, :3, 3])
        after = weigh(self._pairs, moved)
        rows = torch.arange(len(numbers), device=candidates.odds.device)
        better = after.odds > candidates.odds
        return joined([candidates, after]).take(torch.where(better, rows + len(numbers), rows))


def _foremost(candidates: Candidates, count: int) -> Tensor:
    """The rows of the first ``count`` of every pair."""
    runs = runs_of(candidates.poses.pair)
    rows = [row for _, begin, end in runs for row in range(begin, min(end, begin + count))]
    return torch.tensor(rows, dtype=torch.int64, device=candidates.odds.device)


def _within_reach(pairs: PreparedPairs, span: Tensor, candidates: Candidates, poses: Poses) -> list[int]:
    """Of every pair, the row of its best candidate that one pose of it, of G, repeats."""
    vectors, others = candidates.poses.vectors(span), poses.vectors(span)  # (12, H), (12, G)
    rows = []
    for pair, begin, end in runs_of(candidates.poses.pair):
        square = (vectors[:, begin:end] - others[:, pair, None]).square().sum(dim=0)
        near = square <= (_APART * pairs.threshold[pair]).square()
        rows.append(torch.where(near, 0.0, square).argmin())  # the first of those that are near
    found: list[int] = torch.stack(rows).tolist()
    return found


def _distinct(pairs: PreparedPairs, span: Tensor, candidates: Candidates) -> Candidates:
    """Best first, without poses that repeat a better one; a probe near a proposed pose takes the origin of that one."""
    ordered = candidates.best_first()
    apart = _APART * pairs.threshold
    vectors = ordered.poses.vectors(span)  # (12, H)
    rows = distinct(vectors, ordered.poses.pair, apart)
    best = ordered.take(torch.tensor(rows, dtype=torch.int64, device=ordered.odds.device))
    origin = best.poses.origin.clone()
    runs = {run.pair: run for run in runs_of(ordered.poses.pair)}
    for place in (origin < 0).nonzero()[:, 0].tolist():
        pair, begin, end = runs[int(best.poses.pair[place])]
        origins = ordered.poses.origin[begin:end]
        close = (vectors[:, begin:end] - vectors[:, rows[place], None]).square().sum(dim=0) <= apart[pair].square()
        solved = origins[close & (origins >= 0)]
        origin[place] = solved[0] if len(solved) > 0 else origin[place]
    return best._replace(poses=best.poses._replace(origin=origin))
