"""The whole pipeline: two batches of clouds in, their transforms out.

downsample -> neighbors -> estimate_normals -> describe      each distinct cloud once (``describe_thin``)
-> fuse -> match_mutual -> solve                             once per set of features (``recipes_of``)
-> weigh, refine by ICP, judge                               the poses of all sets together (``verify``)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import torch

from torchreg.errors import expect
from torchreg.matching.mutual import match_mutual
from torchreg.registration.describe import describe_thin, description_of, expect_alike
from torchreg.registration.described import DescribedClouds
from torchreg.registration.inspect import pair_notes, refusal
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import Plan, joined
from torchreg.registration.recipes import Recipe, fused, recipes_of
from torchreg.registration.stopwatch import stage, stopwatch
from torchreg.solvers import Solver, base_seed, result_of_poses
from torchreg.solvers.batch import poses_of_pairs
from torchreg.types import Clouds, Correspondences, RegistrationResult, StageCounts
from torchreg.verification import WORK, PairLengths, ProposedPoses, proposals_of
from torchreg.verification.verify import verify


def register(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    effort: str | None = None,
    solver: Solver | str | None = None,
    seed: int = 0,
    max_bytes: int | None = None,
) -> RegistrationResult:
    """Find the rigid transform of every pair, without a first guess.

    The paper's procedure (section 3.2): downsample, normals, FPFH, color histograms, fusion, mutual matches,
    hypotheses from them. Beyond the paper, the poses of several sets of features compete: they are weighed on the
    clouds themselves, refined by ICP, and the winner is judged (``effort``).

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
        seed: of every random draw. The same seed gives the same bits, for any batch and number of threads.
        max_bytes: about the memory to work in, beyond the clouds, the result, and the descriptions of clouds that
            later pairs need again; ``None`` takes a quarter of what is free. A batch that needs more goes in slices,
            with the same result; one pair takes what it needs.

    Returns:
        RegistrationResult with the options, notes and times of the run. A pair that cannot be registered has
        ``success`` false and its ``failure``; it does not affect the others. No gradients.

    Raises:
        ValueError: different numbers of clouds, or options that do not fit.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> result = tr.register(pair.source, pair.target)
        >>> result.T_target_source.shape
        torch.Size([1, 4, 4])
    """
    with stopwatch() as seconds:
        plan = Plan(source, target, options, effort=effort, solver=solver, max_bytes=max_bytes)
        results = []
        for pairs in plan.slices:
            described = plan.sides(pairs, describe_thin)
            results.append(_find_poses(*described, plan.options[pairs], colored=plan.colored, seed=seed))
    return joined(results, seconds=seconds)


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
    with stopwatch() as seconds:
        result = _find_poses(source, target, options, colored=colored, seed=seed)
    return joined([result], seconds=seconds)


def _find_poses(
    source: DescribedClouds,
    target: DescribedClouds,
    options: Sequence[RegistrationOptions],
    *,
    colored: bool,
    seed: int,
) -> RegistrationResult:
    """Match, solve and decide, for the pairs of one slice."""
    expect(isinstance(seed, int), "seed", "an integer", seed)
    facts = list(zip(source.facts, target.facts, strict=True))
    refused = [refusal(*both, option) for both, option in zip(facts, options, strict=True)]
    source, target = source.without(refused), target.without(refused)
    proposed = []
    for recipe in recipes_of(options[0], colored=colored):
        matches = _match(source, target, recipe, options[0])
        proposed.append(_solve(source, target, matches, recipe, options, seed))
    result = _decide(source, target, proposed, options)
    return replace(
        result,
        failure=tuple(early or late for early, late in zip(refused, result.failure, strict=True)),
        options=tuple(options),
        notes=tuple(pair_notes(*both, option) for both, option in zip(facts, options, strict=True)),
        stages=_stage_counts(source, target, proposed),
    )


@stage("matching")
def _match(
    source: DescribedClouds, target: DescribedClouds, recipe: Recipe, options: RegistrationOptions
) -> Correspondences:
    """Fuse the recipe's blocks and match them mutually."""
    return match_mutual(
        fused(source, recipe, options),
        fused(target, recipe, options),
        ratio=options.ratio,
        neighbors=recipe.neighbors,
    )


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
    drawn = base_seed(torch.Generator().manual_seed(seed))
    poses = poses_of_pairs(source.cloud, target.cloud, matches, solvers, seed=drawn)
    return ProposedPoses(recipe.origin, matches, poses)


@stage("decision")
def _decide(
    source: DescribedClouds,
    target: DescribedClouds,
    proposed: Sequence[ProposedPoses],
    options: Sequence[RegistrationOptions],
) -> RegistrationResult:
    """Take the solver's best pose of every pair (plain), or choose among all on the clouds and judge it."""
    effort = options[0].effort
    if effort == "plain":
        solvers = [option.solver for option in options]
        return result_of_poses(source.cloud, target.cloud, proposed[0].matches, proposed[0].poses, solvers)
    lengths = [
        PairLengths(option.inlier_threshold, max(spacings))
        for option, *spacings in zip(options, source.spacing, target.spacing, strict=True)
    ]
    return verify(source.cloud, target.cloud, proposed, lengths, WORK[effort])


def _stage_counts(
    source: DescribedClouds, target: DescribedClouds, proposed: Sequence[ProposedPoses]
) -> tuple[StageCounts, ...]:
    """Points and poses of every pair, stage by stage."""

    def of_both(counts: Callable[[DescribedClouds], Iterable[int]]) -> Iterator[tuple[int, int]]:
        return zip(counts(source), counts(target), strict=True)

    given = of_both(lambda side: [facts.points for facts in side.facts])
    points = of_both(lambda side: side.cloud.lengths)
    described = of_both(lambda side: [int(valid.sum()) for valid in side.features[0].valid.split(side.cloud.lengths)])
    proposals = (proposals_of(proposed, b) for b in range(len(source)))
    return tuple(map(StageCounts, given, points, described, proposals))
