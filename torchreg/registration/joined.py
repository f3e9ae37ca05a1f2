"""The results of several slices as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchreg.types import Clouds, Correspondences, HypothesisCounts, RegistrationResult
from torchreg.types.packing import offsets_of, spans

_TENSORS = (
    *("T_target_source", "inliers", "fitness", "inlier_rmse", "success"),
    *("probability", "overlap", "information", "strength", "runner_up", "margin"),
)
_LISTED = ("failure", "options", "notes", "candidates", "stages")


def joined(results: Sequence[RegistrationResult], *, seconds: tuple[tuple[str, float], ...]) -> RegistrationResult:
    """The pairs of all results, in order; their matches count rows on through all clouds.

    Args:
        results: of one call, with ``stages``, at least one.
        seconds: of all of them together.
    """
    first = results[0]
    if len(results) == 1:
        return replace(first, seconds=seconds)

    def together(name: str) -> Tensor:
        return torch.cat([getattr(result, name) for result in results])

    fields: dict[str, Any] = {name: together(name) for name in _TENSORS if getattr(first, name) is not None}
    fields |= {name: tuple(item for result in results for item in getattr(result, name)) for name in _LISTED}
    return replace(
        first,
        **fields,
        hypotheses=HypothesisCounts(*map(torch.cat, zip(*(result.hypotheses for result in results), strict=True))),
        source=Clouds.pack([result.source for result in results]),
        target=Clouds.pack([result.target for result in results]),
        correspondences=_correspondences(results),
        seconds=seconds,
    )


def _correspondences(results: Sequence[RegistrationResult]) -> Correspondences:
    source, target, first = [], [], [0, 0]
    for result in results:
        source.append(result.correspondences.source + first[0])
        target.append(result.correspondences.target + first[1])
        first = [first[0] + len(result.source.points), first[1] + len(result.target.points)]
    counts = [end - begin for result in results for begin, end in spans(result.correspondences.offsets)]
    return Correspondences(
        source=torch.cat(source),
        target=torch.cat(target),
        offsets=offsets_of(counts),
        score=torch.cat([result.correspondences.score for result in results]),
    )
