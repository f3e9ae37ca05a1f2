"""The whole pipeline: two batches of clouds in, their transforms out.

downsample -> neighbors -> estimate_normals -> describe      each distinct cloud once (``describe_thin``)
-> fuse -> match_mutual -> solve -> rivals                   once per set of features (``recipes_of``)
-> weigh, refine by ICP, judge                               the poses of all sets together (``decide``)
-> the same once more, at other scales                       of pairs in doubt (``look_again``)
-> refine on surfels of the clouds as given                  the poses of pairs that succeed (``refined``)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.matching.mutual import match_mutual
from torchreg.registration.decide import Look, compared, look_again
from torchreg.registration.describe import description_of, expect_alike
from torchreg.registration.described import DescribedClouds
from torchreg.registration.inspect import (
    CloudFacts,
    few_points_notes,
    keypoints_failure,
    keypoints_notes,
    pair_notes,
    refusal,
    undescribed_failure,
    undescribed_note,
)
from torchreg.registration.matchings import Matched, Matching
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import Plan, joined
from torchreg.registration.recipes import Recipe
from torchreg.registration.refined import given_residuals, refined
from torchreg.registration.rivals import rivals
from torchreg.registration.stopwatch import stage, stopwatch
from torchreg.registration.trained import BY_OPTIONS, Trained, by_module
from torchreg.seeds import generator_of
from torchreg.solvers import Solver, base_seed, result_of_poses
from torchreg.solvers.batch import poses_of_pairs
from torchreg.types import Clouds, Correspondences, Failure, Features, Proposal, RegistrationResult, StageCounts
from torchreg.verification import WORK, ProposedPoses, proposals_of
from torchreg.verification.given import GivenVerdict, given_poses
from torchreg.verification.judge import judge_poses
from torchreg.verification.verdicts import JudgedPair, collect


@entry
def register(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    effort: str | None = None,
    solver: Solver | str | None = None,
    refine: str | None = None,
    describe: Trained | None = None,
    seed: int = 0,
    max_bytes: int | None = None,
) -> RegistrationResult:
    """Find the rigid transform of every pair, without a first guess.

    The paper's procedure (section 3.2): downsample, normals, FPFH, color histograms, fusion, mutual matches,
    hypotheses from them. Beyond the paper, poses compete: they are weighed on the clouds themselves, refined by ICP,
    and the winner is judged; pairs in doubt are looked at again at other scales (``effort``).

    A cloud that stands in several pairs is described once for every set of lengths that its pairs have.

    Args:
        source: B clouds.
        target: B clouds.
        options: in meters, for all pairs or one per pair (which then differ in lengths only); ``None`` derives
            them from the spacing of each pair's points (``derive_options``); ``PAPER`` has the paper's.
        effort: ``"plain"`` (the paper's procedure and no more), ``"fast"``, ``"balanced"`` or ``"thorough"``, as
            in ``RegistrationOptions``; ``None`` takes that of the options: balanced where they are derived, plain
            in ``PAPER``. Options given keep their lengths; derived ones are half as large again for ``"fast"``.
        solver: a record such as ``RansacOptions()``, or its name: then at the inlier threshold of the options.
            ``None`` takes that of the options.
        refine: how far the poses found are refined, ``"none"``, ``"coarse"`` or ``"full"``, as in
            ``RegistrationOptions``; ``None`` takes that of the options: full where they are derived, none in ``PAPER``.
        describe: an ``nn.Module`` (or a function) that describes clouds in place of the options' descriptors, which
            then judge poses alone. It is called in evaluation mode, without gradients, once for every distinct cloud:
            with ``Clouds`` of one thinned cloud with normals, and with colors where both sides have them; and, where it
            needs a second argument, with the ``Neighborhoods`` of its points, of the widest support of the options:
            the largest radius and the largest number of neighbors of the normals and of the first descriptors of
            geometry and of color. It returns features as ``register_features`` takes them: (P, D), or ``Features``.
        seed: of every random draw, any integer. The same seed gives the same bits, for any batch and number of threads.
        max_bytes: about the memory to work in, beyond the clouds, the result, and the descriptions of clouds that
            later pairs need again; ``None`` takes a quarter of what is free. A batch that needs more goes in slices,
            with the same result; one pair takes what it needs.

    Returns:
        RegistrationResult with the options, notes and times of the run. A pair that cannot be registered has
        ``success`` false and its ``failure``; it does not affect the others. No gradients.

    Raises:
        TypeError: something else than ``Clouds``, such as a tensor; a ``describe`` that cannot be called, or returns
            something else than features.
        ValueError: different numbers of clouds, options that do not fit, or features that do not fit the points.
        RuntimeError: what ``describe`` raised, with what it was given.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> result = tr.register(pair.source, pair.target)
        >>> result.T_target_source.shape
        torch.Size([1, 4, 4])
    """
    with stopwatch() as seconds, undisturbed(source.points):
        way = BY_OPTIONS if describe is None else by_module(describe)
        plan = Plan(
            source,
            target,
            options,
            effort=effort,
            solver=solver,
            refine=refine,
            max_bytes=max_bytes,
            described_by=way.description,
        )
        results = []
        for pairs in plan.slices:
            sides = plan.sides(pairs, way.describe)
            found = find_poses(*sides, plan.options[pairs], colored=plan.colored, seed=seed, matching=way.matching)
            results.append(found.result)
    return joined(results, seconds=seconds)


@entry
def register_described(
    source: DescribedClouds, target: DescribedClouds, options: Sequence[RegistrationOptions], *, seed: int = 0
) -> RegistrationResult:
    """Find the transform of every pair of described clouds: the second half of ``register``, with its results.

    Args:
        source: B clouds.
        target: B clouds.
        options: one per pair, complete, differing in lengths only, as both sides were described with.
        seed: of every random draw.

    Returns:
        RegistrationResult; as ``register``'s.

    Raises:
        ValueError: the numbers of clouds or options differ, options differ in more than lengths, or the clouds were
            described with other descriptors than the options'.
    """
    pairs = len(source)
    expect(len(target) == pairs, "target", f"{pairs} clouds, as the source has", len(target))
    expect(len(options) == pairs, "options", f"one per pair ({pairs})", len(options))
    expect(pairs > 0, "source", "at least one cloud", pairs)
    expect_alike(options)
    colored = source.cloud.colors is not None and target.cloud.colors is not None
    for name, side in (("source", source), ("target", target)):
        for option, described in zip(options, side.descriptions, strict=True):
            needed = description_of(option, colored=colored)
            expect(described == needed, name, f"descriptions by {needed}", described)
    with stopwatch() as seconds, undisturbed(source.cloud.points):
        result = find_poses(source, target, options, colored=colored, seed=seed).result
    return joined([result], seconds=seconds)


class Found(NamedTuple):
    """The poses of the pairs of one slice."""

    result: RegistrationResult
    given: tuple[GivenVerdict | None, ...]  # on the given pose of every pair; ``None`` where none was judged
    residuals: Tensor  # (B, 3) float64, meters, under the given poses, as ``residuals_under`` has them; NaN elsewhere


def find_poses(
    source: DescribedClouds,
    target: DescribedClouds,
    options: Sequence[RegistrationOptions],
    *,
    colored: bool,
    seed: int,
    T_given: Tensor | None = None,
    matching: Matching = BY_OPTIONS.matching,
) -> Found:
    """Match, solve and decide, for the pairs of one slice.

    ``matching`` says where matches come from.

    ``T_given`` (B, 4, 4) float64 are poses that compete with those that are found, unless the effort is plain; each
    then gets a verdict of its own.
    """
    pairs = usable_pairs(source, target, options)
    drawn = base_seed(generator_of(seed))
    proposed: list[ProposedPoses] = []
    for recipe in matching.recipes(pairs.source, options[0], colored=colored):
        matched = matching.match(pairs.source, pairs.target, recipe, options[0], _match)
        proposed.append(_solve(pairs.source, pairs.target, matched.matches, recipe, options, drawn))
        if len(proposed) == 1 and options[0].effort in ("balanced", "thorough"):
            proposed.append(_find_rivals(pairs.source, pairs.target, matched, proposed[0], options, drawn))
    return conclude(pairs, proposed, options, drawn, matching.look, T_given)


class UsablePairs(NamedTuple):
    """The pairs of one slice, the clouds of those that cannot be registered emptied."""

    source: DescribedClouds
    target: DescribedClouds
    facts: tuple[tuple[CloudFacts, CloudFacts], ...]  # of both clouds of every pair as they were given
    refused: tuple[Failure | None, ...]  # why a pair cannot be registered


def usable_pairs(
    source: DescribedClouds, target: DescribedClouds, options: Sequence[RegistrationOptions]
) -> UsablePairs:
    """Empty the clouds of pairs that cannot be registered, so that they do not affect the others."""
    facts = tuple(zip(source.facts, target.facts, strict=True))
    refused = tuple(refusal(*both, option) for both, option in zip(facts, options, strict=True))
    return UsablePairs(source.without(refused), target.without(refused), facts, refused)


def conclude(
    pairs: UsablePairs,
    proposed: Sequence[ProposedPoses],
    options: Sequence[RegistrationOptions],
    drawn: int,
    look: Look,
    T_given: Tensor | None = None,
) -> Found:
    """Decide among the poses that were proposed, and refine those of pairs that succeed.

    ``drawn`` is the seed of the call as solvers take it, ``look`` what looks again at pairs in doubt; ``T_given`` is as
    in ``find_poses``.
    """
    source, target, facts, refused = pairs
    effort = options[0].effort
    competing = (
        list(proposed) if T_given is None else [*proposed, given_poses(source.cloud, target.cloud, T_given, refused)]
    )
    given: tuple[GivenVerdict | None, ...] = (None,) * len(source)
    if effort == "plain":
        result = _take_best(source, target, proposed[0], options)
        again = {}
    else:
        judged = _decide(source, target, competing, options)
        again = look_again(source, target, competing, judged, options, drawn, look)
        last = [again[b].judged if b in again else pair for b, pair in enumerate(judged)]
        result, given = collect(source.cloud, target.cloud, last), tuple(pair.verdict.given for pair in last)
    proposals = [proposals_of(proposed, b) + (again[b].proposals if b in again else ()) for b in range(len(source))]
    stages = _stage_counts(source, target, proposals)
    keypoints = list(zip(_keypoint_counts(source), _keypoint_counts(target), strict=True))
    undescribed = [
        sum(both, ()) for both in zip(_undescribed(source, "source"), _undescribed(target, "target"), strict=True)
    ]
    late = map(undescribed_failure, map(keypoints_failure, result.failure, keypoints, options), undescribed)
    result = replace(result, failure=tuple(early or other for early, other in zip(refused, late, strict=True)))
    result, remarks = refined(source, target, result, options)
    few = [
        few_points_notes(counts.points, option) + keypoints_notes(selected, counts.points, option) + blind
        for counts, selected, option, blind in zip(stages, keypoints, options, undescribed, strict=True)
    ]
    result = replace(
        result,
        options=tuple(options),
        notes=tuple(
            pair_notes(*both, option) + more + last
            for both, option, more, last in zip(facts, options, few, remarks, strict=True)
        ),
        stages=stages,
    )
    return Found(result, given, given_residuals(source, target, T_given, refused))


@stage("matching")
def _match(source: Features, target: Features, recipe: Recipe, options: RegistrationOptions) -> Correspondences:
    """Match the features of a recipe mutually."""
    return match_mutual(source, target, ratio=options.ratio, neighbors=recipe.neighbors)


@stage("rivals")
def _find_rivals(
    source: DescribedClouds,
    target: DescribedClouds,
    matched: Matched,
    first: ProposedPoses,
    options: Sequence[RegistrationOptions],
    seed: int,
) -> ProposedPoses:
    """Propose what the best poses of the first recipe leave unexplained."""
    return rivals(source.cloud, target.cloud, matched.near(), first, options, seed)


@stage("hypotheses")
def _solve(
    source: DescribedClouds,
    target: DescribedClouds,
    matches: Correspondences,
    recipe: Recipe,
    options: Sequence[RegistrationOptions],
    seed: int,
) -> ProposedPoses:
    """Turn matches into the distinct poses of every pair, by the recipe's solver."""
    solvers = [option.solver_named(recipe.solver).at_effort(option.effort) for option in options]
    poses = poses_of_pairs(source.cloud, target.cloud, matches, solvers, seed=seed)
    return ProposedPoses(recipe.origin, matches, poses)


@stage("decision")
def _decide(
    source: DescribedClouds,
    target: DescribedClouds,
    proposed: Sequence[ProposedPoses],
    options: Sequence[RegistrationOptions],
) -> list[JudgedPair]:
    """Choose among the poses of every pair on the clouds, and judge the choice."""
    work = WORK[options[0].effort]
    return judge_poses(source.cloud, target.cloud, proposed, *compared(source, target, options), work)


@stage("decision")
def _take_best(
    source: DescribedClouds, target: DescribedClouds, proposed: ProposedPoses, options: Sequence[RegistrationOptions]
) -> RegistrationResult:
    """Take the pose of every pair that most matches agree on."""
    solvers = [option.solver for option in options]
    return result_of_poses(source.cloud, target.cloud, proposed.matches, proposed.poses, solvers)


def _stage_counts(
    source: DescribedClouds, target: DescribedClouds, proposals: Sequence[tuple[Proposal, ...]]
) -> tuple[StageCounts, ...]:
    """Points and poses of every pair, stage by stage."""

    def of_both(counts: Callable[[DescribedClouds], Iterable[int]]) -> Iterator[tuple[int, int]]:
        return zip(counts(source), counts(target), strict=True)

    given = of_both(lambda side: [facts.points for facts in side.facts])
    points = of_both(lambda side: side.cloud.lengths)
    described = of_both(_described_counts)
    return tuple(map(StageCounts, given, points, described, proposals))


def _described_counts(side: DescribedClouds) -> list[int]:
    """Of every cloud, its points with a valid feature; all of them where it is matched by none."""
    matched_by = side.features[:1] if side.outside is None else (side.outside,)
    if not matched_by:
        return side.cloud.lengths
    return [int(valid.sum()) for valid in matched_by[0].valid.split(side.cloud.lengths)]


def _undescribed(side: DescribedClouds, name: str) -> list[tuple[str, ...]]:
    """Of every cloud, remarks on the descriptors that describe none of its points; none where others are matched."""
    if side.outside is not None or not side.features:
        return [()] * len(side)
    described = torch.stack([block.valid for block in side.features], dim=1).split(side.cloud.lengths)
    clouds = zip(described, side.descriptions, side.spacing, side.facts, strict=True)
    return [
        tuple(
            undescribed_note(record, name, max(spacing, facts.spacing))
            for record, found in zip(description.descriptors, valid.any(dim=0).tolist(), strict=True)
            if not found and len(valid) > 0
        )
        for valid, description, spacing, facts in clouds
    ]


def _keypoint_counts(side: DescribedClouds) -> list[int]:
    """Of every cloud, the points that are matched."""
    if side.keypoints is None:
        return side.cloud.lengths
    return [int(part.sum()) for part in side.keypoints.split(side.cloud.lengths)]
