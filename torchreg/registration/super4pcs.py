"""Pairs registered without a feature: poses by 4-point congruent sets, judged on the clouds as by ``register``.

downsample -> normals, descriptors      as ``register`` does; descriptors judge poses and propose none
-> thin -> bases, pairs, congruent sets -> poses -> ICP         ``congruent/search.py``, pair by pair
-> weigh, refine, judge -> the same with narrower bases         of pairs in doubt (``conclude``)
-> refine on surfels
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import torch

from torchreg.congruent import Super4pcsOptions, search_pair
from torchreg.entry import entry
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.matching.mutual import match_mutual
from torchreg.preprocess.downsample import voxel_downsample
from torchreg.registration.describe import describe_thin
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import Plan, joined
from torchreg.registration.recipes import fused, recipes_of
from torchreg.registration.register import UsablePairs, conclude, usable_pairs
from torchreg.registration.spacing import CloudScale
from torchreg.registration.stopwatch import stage, stopwatch
from torchreg.registration.verify import judging_effort
from torchreg.seeds import generator_of
from torchreg.solvers import PairPoses, base_seed, hypothesis_counts
from torchreg.solvers.poses import no_pose
from torchreg.types import Clouds, Correspondences, Failure, RegistrationResult
from torchreg.types.packing import offsets_of
from torchreg.verification import ProposedPoses

_NARROWER = 0.5  # of the assumed overlap, at a second look


@entry
def super4pcs(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    search: Super4pcsOptions | None = None,
    effort: str | None = None,
    refine: str | None = None,
    seed: int = 0,
    max_bytes: int | None = None,
) -> RegistrationResult:
    """Find the rigid transform of every pair by 4-point congruent sets, without a feature and without a first guess.

    4PCS (Aiger, Mitra and Cohen-Or, ACM Trans. Graph. 27(3), 2008, doi:10.1145/1360612.1360684) with the smart index of
    Super4PCS (Mellado, Aiger and Mitra, Comput. Graph. Forum 33(5), 2014, doi:10.1111/cgf.12446): four nearly coplanar
    points of the source make a base; the target's pairs as far apart as the ends of its diagonals, cut by the same
    ratios, make the sets congruent to it; every set gives a pose, and poses are compared by how many points lie
    together. Normals and colors filter the pairs. The best poses then compete on the clouds as in ``register``, whose
    descriptors judge poses here and propose none, so probability and reasons mean the same.

    Args:
        source: B clouds.
        target: B clouds.
        options: as for ``register``: lengths in meters, and what poses are judged by. Their solver proposes nothing.
        search: how poses are searched for; ``None`` takes the defaults.
        effort: ``"fast"``, ``"balanced"`` or ``"thorough"``, as for ``register``; ``None`` takes that of the options,
            and balanced where they are derived or plain, which weighs no pose.
        refine: as for ``register``.
        seed: of the bases, any integer. The same seed gives the same bits, for any batch and number of threads.
        max_bytes: as for ``register``. The search of one pair takes what it needs beside: about 12 bytes times the
            square of ``search.points``.

    Returns:
        RegistrationResult, as ``register``'s; ``hypotheses`` counts bases, congruent sets, and poses whose corners fit.
        No gradients.

    Raises:
        TypeError: something else than ``Clouds`` or ``Super4pcsOptions``.
        ValueError: different numbers of clouds, or options that do not fit.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> result = tr.super4pcs(pair.source, pair.target, search=tr.Super4pcsOptions(bases=16, points=500))
        >>> result.T_target_source.shape
        torch.Size([1, 4, 4])
    """
    search = Super4pcsOptions() if search is None else search
    with stopwatch() as seconds, undisturbed(source.points):
        effort = judging_effort(options, effort)
        plan = Plan(source, target, options, effort=effort, solver=None, refine=refine, max_bytes=max_bytes)
        drawn = base_seed(generator_of(seed))
        results = []
        for rows in plan.slices:
            pairs = usable_pairs(*plan.sides(rows, describe_thin), plan.options[rows])
            proposed = [
                _proposed(pairs.source, pairs.target, search, drawn, pairs.refused),
                _evidence(pairs, plan.options[rows], colored=plan.colored),
            ]
            found = conclude(pairs, proposed, plan.options[rows], drawn, _Look(search))
            hypotheses = hypothesis_counts(proposed[0].poses, source.device)
            results.append(replace(found.result, hypotheses=hypotheses))
    return joined(results, seconds=seconds)


class _Look:
    """The second look at a pair in doubt: the same search with narrower bases."""

    def __init__(self, search: Super4pcsOptions) -> None:
        self._search = replace(search, overlap=_NARROWER * search.overlap)

    def __call__(
        self,
        b: int,
        source: DescribedClouds,
        target: DescribedClouds,
        options: RegistrationOptions,
        seed: int,
        before: Collection[str],
    ) -> list[ProposedPoses]:
        """Poses of pair ``b``, whose clouds these are."""
        return [_proposed(source, target, self._search, seed, (None,))]


@stage("hypotheses")
def _proposed(
    source: DescribedClouds,
    target: DescribedClouds,
    search: Super4pcsOptions,
    seed: int,
    refused: Sequence[Failure | None],
) -> ProposedPoses:
    """The poses that the search proposes for every pair; they come without matches."""
    poses = [
        no_pose(0, source.cloud.device, failure) if failure is not None else _of_pair(one, other, search, seed)
        for one, other, failure in zip(source.cloud.unpack(), target.cloud.unpack(), refused, strict=True)
    ]
    none = torch.zeros(0, dtype=torch.int64, device=source.cloud.device)
    matches = Correspondences(none, none, offsets_of([0] * len(poses)), source.cloud.points.new_zeros(0))
    return ProposedPoses(f"congruent sets, overlap {search.overlap:g}", matches, poses)


def _of_pair(source: Clouds, target: Clouds, search: Super4pcsOptions, seed: int) -> PairPoses:
    """The poses of one pair of clouds with normals, which are thinned for the search."""
    voxel = max(CloudScale(cloud, search.points).thinning_voxel for cloud in (source, target))
    if voxel > 0:
        source, target = voxel_downsample(source, voxel), voxel_downsample(target, voxel)
    spacing = max(CloudScale(cloud).spacing() for cloud in (source, target))
    signed = bool((source.viewpoint_known & target.viewpoint_known).all())
    return search_pair(source, target, search, spacing, seed, signed=signed)


@stage("matching")
def _evidence(pairs: UsablePairs, options: Sequence[RegistrationOptions], *, colored: bool) -> ProposedPoses:
    """Mutual matches of the options' descriptors, on which poses are weighed; they propose none."""
    recipe = recipes_of(options[0], colored=colored)[0]
    features = fused(pairs.source, recipe, options[0]), fused(pairs.target, recipe, options[0])
    matches = match_mutual(*features, ratio=options[0].ratio, neighbors=recipe.neighbors)
    counts = matches.offsets.diff().tolist()
    device: torch.device = pairs.source.cloud.device
    poses = [no_pose(count, device, failure) for count, failure in zip(counts, pairs.refused, strict=True)]
    return ProposedPoses(" + ".join(recipe.names) + ", to judge by", matches, poses)
