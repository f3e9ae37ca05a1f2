"""The whole pipeline by Open3D: the same options, the same result type, another implementation.

Its RANSAC draws from one generator that its threads share, so a seed does not make a run repeatable on several
threads. It does not refit the winner to its inliers, and it calls every transform a success that brings one point
near the target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchreg.errors import expect, one_of
from torchreg.open3d_loader import load_open3d
from torchreg.reference.pair import FEATURES, PairOutcome, register_pair
from torchreg.reference.stages import estimate_normals, evaluate, fpfh, neighborhoods, voxel_downsample
from torchreg.registration import derive_options
from torchreg.registration.inspect import notes_on, refuse, set_aside
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import options_of_pairs
from torchreg.registration.stopwatch import stopwatch
from torchreg.seeds import open3d_seed
from torchreg.types import Clouds, Correspondences, HypothesisCounts, RegistrationResult
from torchreg.types.packing import offsets_of

__all__ = ["estimate_normals", "evaluate", "fpfh", "neighborhoods", "register", "voxel_downsample"]


def register(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    seed: int = 0,
    features: str = "fpfh",
) -> RegistrationResult:
    """Find the rigid transform of every pair with Open3D, pair by pair on the CPU.

    Args:
        source: B clouds.
        target: B clouds.
        options: as in ``torchreg.register``, lengths derived in the same way; those on color count for "fused".
        seed: of Open3D's generator, for every pair; any integer.
        features: "fpfh", Open3D's alone, or "fused", the very features that ``torchreg.register`` matches,
            handed over (its rows that are not valid are left out).

    Returns:
        RegistrationResult on the CPU. ``hypotheses`` are -1: Open3D does not return them. ``notes`` say where it took
        one-way matches because mutual ones were few.

    Raises:
        ValueError: different numbers of clouds, or another kind of features.
        ImportError: Open3D is not there.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> tr.reference.open3d.register(pair.source, pair.target).T_target_source.shape
        torch.Size([1, 4, 4])
    """
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    one_of(features, "features", FEATURES)
    o3d = load_open3d()
    source, target = source.to("cpu"), target.to("cpu")
    refused = refuse(source, target)
    outcomes = []
    with stopwatch() as seconds:
        if options is None:
            options = derive_options(set_aside(source, refused), set_aside(target, refused))
        per_pair = options_of_pairs(options, len(source))
        for one, other, option, failure in zip(source.unpack(), target.unpack(), per_pair, refused, strict=True):
            if failure is not None:
                outcomes.append(PairOutcome(one, other, failure))
                continue
            o3d.utility.random.seed(open3d_seed(seed))
            outcomes.append(register_pair(one, other, option, features))
    what = "on FPFH alone" if features == "fpfh" else "matches and RANSAC, on torchreg's features"
    origin = f"by Open3D {o3d.__version__}, {what}"
    remarks = notes_on(source, target, per_pair)
    notes = tuple((origin, *more, *outcome.notes) for more, outcome in zip(remarks, outcomes, strict=True))
    return _collect(source, target, outcomes, per_pair, notes, tuple(seconds.items()))


def _collect(
    source: Clouds,
    target: Clouds,
    outcomes: list[PairOutcome],
    options: tuple[RegistrationOptions, ...],
    notes: tuple[tuple[str, ...], ...],
    seconds: tuple[tuple[str, float], ...],
) -> RegistrationResult:
    empty = PairOutcome(source, target)
    if outcomes:
        source = Clouds.pack([replace(one.source, normals=None) for one in outcomes])
        target = Clouds.pack([replace(one.target, normals=None) for one in outcomes])
    first = torch.stack([source.offsets, target.offsets], dim=1)  # (B+1, 2)
    matches = torch.cat([empty.matches, *(one.matches + at for one, at in zip(outcomes, first[:-1], strict=True))])
    return RegistrationResult(
        T_target_source=torch.stack([one.T for one in outcomes])
        if outcomes
        else torch.zeros(0, 4, 4, dtype=torch.float64),
        inliers=torch.cat([empty.inliers, *(one.inliers for one in outcomes)]),
        fitness=torch.tensor([one.fitness for one in outcomes], dtype=torch.float64),
        inlier_rmse=torch.tensor([one.inlier_rmse for one in outcomes], dtype=torch.float64),
        success=torch.tensor([one.failure is None for one in outcomes], dtype=torch.bool),
        failure=tuple(one.failure for one in outcomes),
        hypotheses=HypothesisCounts(*torch.full((3, len(outcomes)), -1).unbind(0)),
        source=source,
        target=target,
        correspondences=Correspondences(
            matches[:, 0].contiguous(),
            matches[:, 1].contiguous(),
            offsets_of(len(one.matches) for one in outcomes),
            torch.cat([empty.score, *(one.score for one in outcomes)]),
        ),
        options=options,
        notes=notes,
        seconds=seconds,
    )
