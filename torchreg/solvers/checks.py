"""What poses can be sought for: rows inside their pair's clouds, matches enough, finite points."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.types import Clouds, Correspondences, Failure
from torchreg.types.packing import spans


def check_matches(source: Clouds, target: Clouds, matches: Correspondences) -> None:
    """Raise ``ValueError`` where the numbers of pairs differ, or a match names a row outside its pair's clouds."""
    pairs = len(matches)
    expect(len(source) == pairs and len(target) == pairs, "matches", f"{len(source)} pairs", pairs)
    expect(len(target) == len(source), "target", f"{len(source)} clouds, as the source has", len(target))
    _check_rows(matches.source, source, matches.offsets, "matches.source")
    _check_rows(matches.target, target, matches.offsets, "matches.target")


def refusals(source: Clouds, target: Clouds, matches: Correspondences, least: Sequence[int]) -> list[Failure | None]:
    """Why a pair cannot be solved, of every pair; ``None`` where it can."""
    finite = [one and other for one, other in zip(_finite(source), _finite(target), strict=True)]
    counts = matches.offsets.diff().tolist()
    return [
        too_few_matches(count, needed)
        if count < needed
        else (None if sound else Failure("not finite", "points that are not finite"))
        for count, needed, sound in zip(counts, least, finite, strict=True)
    ]


def too_few_matches(count: int, needed: int) -> Failure:
    """Fewer matches than fix a transform."""
    text = f"too few matches: {count}, and a sample needs {needed}"
    return Failure("too few matches", text, {"matches": count, "needed": needed})


def _finite(clouds: Clouds) -> list[bool]:
    """Whether all points of a cloud are finite, of every cloud."""
    bad = (~torch.isfinite(clouds.points)).any(dim=1).cumsum(dim=0)
    counts: list[int] = torch.nn.functional.pad(bad, (1, 0))[clouds.offsets.to(bad.device)].diff().tolist()
    return [count == 0 for count in counts]


def _check_rows(rows: Tensor, clouds: Clouds, offsets: Tensor, name: str) -> None:
    of_match = offsets.diff().to(rows.device)
    first, end = (
        side.to(rows.device).repeat_interleave(of_match) for side in (clouds.offsets[:-1], clouds.offsets[1:])
    )
    legal = (rows >= first) & (rows < end)
    if bool(legal.all()):
        return
    for (begin, stop), (low, high) in zip(spans(offsets), spans(clouds.offsets), strict=True):
        expect(bool(legal[begin:stop].all()), name, f"rows from {low} to {high - 1} in this pair", rows[begin:stop])
