"""Pairs registered by features or matches that were computed elsewhere, as by a network of another library.

match, solve, rivals                    by what was given, alone (``matchings``)
-> weigh, refine, judge                 on the clouds, as ``register`` does, whoever proposed a pose
-> refine on surfels
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, expect_device
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.registration.matchings import FeatureMatching, GivenMatching
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.outside import (
    GivenFeatures,
    GivenMatches,
    both_sides,
    checked_matches,
)
from torchreg.registration.outside_plan import OutsidePlan, Wanted
from torchreg.registration.plan import joined
from torchreg.registration.register import find_poses
from torchreg.registration.rivals import NearMatches
from torchreg.registration.stopwatch import stopwatch
from torchreg.solvers import Solver
from torchreg.types import Clouds, RegistrationResult
from torchreg.types.packing import spans


@entry
def register_features(
    source: Clouds,
    target: Clouds,
    f: GivenFeatures,
    g: GivenFeatures,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    effort: str | None = None,
    solver: Solver | str | None = None,
    refine: str | None = None,
    seed: int = 0,
    max_bytes: int | None = None,
) -> RegistrationResult:
    """Find the rigid transform of every pair by features that were computed elsewhere.

    Features propose poses, by mutual nearest neighbors (Euclidean distance, values as they are), the solver, and what
    the best pose leaves unexplained; pairs in doubt are matched once more, less strictly. The clouds then decide as in
    ``register``, by the library's own descriptors too, so probability and reasons mean the same whatever was matched.

    Args:
        source: B clouds. All points are used exactly as they are, unless the options have a ``voxel_size``: then of
            every voxel one point with a feature is kept.
        target: B clouds.
        f: features of the source's points: (P, D) floating point, P rows of the packed clouds; ``Features``, whose
            rows may be invalid; or ``KeypointFeatures`` of some points. A row of zeros in a tensor describes nothing.
            Half precision is widened to float32.
        g: those of the target's points, of the same width.
        options: as for ``register``: lengths in meters, solver, effort. Their descriptors propose nothing and judge
            poses. ``None`` derives the lengths from the spacing of the points, without voxels.
        effort: as for ``register``; ``"plain"`` takes the pose that most matches agree on.
        solver: as for ``register``.
        refine: as for ``register``.
        seed: of every random draw. The same seed gives the same bits, for any batch and number of threads.
        max_bytes: as for ``register``.

    Returns:
        RegistrationResult, as ``register``'s; its clouds have their points in the order given. No gradients.

    Raises:
        TypeError: clouds or features of another type.
        ValueError: features whose rows, width, dtype or device do not fit or that are not finite, different numbers of
            clouds, or options that do not fit.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> f, g = (torch.rand(len(cloud.points), 32) for cloud in (pair.source, pair.target))  # from your network
        >>> result = tr.register_features(pair.source, pair.target, f, g)
        >>> result.T_target_source.shape
        torch.Size([1, 4, 4])
    """
    _expect_pairs(source, target)
    with stopwatch() as seconds, undisturbed(source.points):
        features = both_sides(source, target, f, g)
        plan = OutsidePlan(
            source,
            target,
            options,
            Wanted(features.source.valid, features.target.valid, every=False),
            effort=effort,
            solver=solver,
            refine=refine,
            max_bytes=max_bytes,
            point_bytes=2 * features.source.values[:1].nbytes,
        )
        results = []
        for pairs in plan.slices:
            one, other = (
                plan.features(pairs, side, *both)
                for side, both in enumerate(zip(plan.sides(pairs), features, strict=True))
            )
            found = find_poses(
                one, other, plan.options[pairs], colored=plan.colored, seed=seed, matching=FeatureMatching()
            )
            results.append(found.result)
    return plan.in_given_order(joined(results, seconds=seconds))


@entry
def register_matches(
    source: Clouds,
    target: Clouds,
    matches: GivenMatches,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    effort: str | None = None,
    solver: Solver | str | None = None,
    refine: str | None = None,
    seed: int = 0,
    max_bytes: int | None = None,
) -> RegistrationResult:
    """Find the rigid transform of every pair by matches that were found elsewhere.

    The solver proposes poses from the matches, and from those that the best pose leaves unexplained; the clouds then
    decide as in ``register_features``. All matches are used, whatever the ``keypoints`` of the options.

    Args:
        source: B clouds. All points are used exactly as they are, unless the options have a ``voxel_size``: then all
            matched points stay, and one of every voxel without any.
        target: B clouds.
        matches: index pairs (M, 2) of whole numbers, a row of the source and a row of the target, for one pair; a list
            of B of them, each with rows of its own two clouds; or ``Correspondences``, with rows of the packed clouds.
            Right ones may be few, and points may stand in several. Scores of ``Correspondences`` (the smaller, the
            better) reach the solver, and choose where there are more matches than one search for rivals takes.
        options: as for ``register_features``.
        effort: likewise.
        solver: likewise.
        refine: likewise.
        seed: likewise.
        max_bytes: likewise.

    Returns:
        RegistrationResult, as ``register_features``'s. A pair without matches has ``success`` false and a ``failure``.

    Raises:
        TypeError: clouds or matches of another type.
        ValueError: matches of another shape or dtype, or with rows that a cloud does not have, different numbers of
            clouds, or options that do not fit.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> result = tr.register_matches(pair.source, pair.target, torch.zeros(0, 2, dtype=torch.int64))
        >>> result.reason
        ('too few matches: 0, and a sample needs 3',)
    """
    _expect_pairs(source, target)
    with stopwatch() as seconds, undisturbed(source.points):
        pairs_of_rows = checked_matches(matches, source, target)
        plan = OutsidePlan(
            source,
            target,
            options,
            Wanted(
                _matched([pair.source for pair in pairs_of_rows], source),
                _matched([pair.target for pair in pairs_of_rows], target),
                every=True,
            ),
            effort=effort,
            solver=solver,
            refine=refine,
            max_bytes=max_bytes,
        )
        sources = plan.places(0, [pair.source for pair in pairs_of_rows])
        targets = plan.places(1, [pair.target for pair in pairs_of_rows])
        scores = [pair.score for pair in pairs_of_rows]
        kept = [NearMatches(*pair) for pair in zip(sources, targets, scores, strict=True)]
        results = []
        for pairs in plan.slices:
            found = find_poses(
                *plan.sides(pairs),
                plan.options[pairs],
                colored=plan.colored,
                seed=seed,
                matching=GivenMatching(kept[pairs]),
            )
            results.append(found.result)
    return plan.in_given_order(joined(results, seconds=seconds))


def _expect_pairs(source: Clouds, target: Clouds) -> None:
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    expect(len(source) > 0, "source", "at least one cloud", len(source))
    expect_device(target.points, "target", source.device)


def _matched(rows: Sequence[Tensor], clouds: Clouds) -> Tensor:
    """(P,) bool, the points that stand in a match, by the rows of every cloud."""
    marks = torch.zeros(len(clouds.points), dtype=torch.bool, device=clouds.device)
    for (begin, _), of_cloud in zip(spans(clouds.offsets), rows, strict=True):
        marks[begin + of_cloud] = True
    return marks
