"""One loop over the pairs of a batch, for any solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.chunks import stable_sum
from torchreg.geometry.se3 import apply_rotation
from torchreg.hypotheses.found import Found, MatchedPoints, PairPoses
from torchreg.hypotheses.seeds import pair_seed
from torchreg.types import Clouds, Correspondences
from torchreg.types.packing import spans

Options = TypeVar("Options")


def one_per_pair(options: Options | Sequence[Options] | None, default: Options, pairs: int) -> list[Options]:
    """Options for every pair, from one for all, one per pair, or ``None`` for the default."""
    if not isinstance(options, Sequence):
        return [default if options is None else options] * pairs
    expect(len(options) == pairs, "options", f"one for all or one per pair ({pairs})", len(options))
    return list(options)


def poses_of_pairs(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    solve: Callable[[MatchedPoints, Options], Found],
    options: Sequence[Options],
    *,
    least: Sequence[int],
    seed: int = 0,
) -> list[PairPoses]:
    """Run a solver on every pair.

    Args:
        source: B clouds.
        target: B clouds.
        matches: correspondences between them, global rows.
        solve: from the matched points of one pair and its options to distinct poses.
        options: one per pair.
        least: matches that the solver needs, per pair.
        seed: of the call.

    Returns:
        One per pair, in order. A pair that cannot be solved has no pose and says why.

    Raises:
        ValueError: the numbers of pairs differ, or a correspondence names a row outside its pair's clouds.
    """
    pairs = len(matches)
    expect(len(source) == pairs and len(target) == pairs, "matches", f"{len(source)} pairs", pairs)
    expect(len(target) == len(source), "target", f"{len(source)} clouds, as the source has", len(target))
    _check_rows(matches.source, source, matches.offsets, "matches.source")
    _check_rows(matches.target, target, matches.offsets, "matches.target")
    found = []
    for b, (begin, end) in enumerate(spans(matches.offsets)):
        refused = _refusal(source.select(b), target.select(b), end - begin, least[b])
        if refused:
            found.append(_no_pose(Found(None, 0, 0, 0, refused), end - begin, source.device))
        else:
            found.append(_solve_pair(source, target, matches, b, solve, options[b], seed))
    return found


def _refusal(source: Clouds, target: Clouds, matches: int, least: int) -> str:
    if matches < least:
        return f"too few matches: {matches}, and a sample needs {least}"
    if not bool(torch.isfinite(source.points).all() & torch.isfinite(target.points).all()):
        return "points that are not finite"
    return ""


def _solve_pair(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    b: int,
    solve: Callable[[MatchedPoints, Options], Found],
    options: Options,
    seed: int,
) -> PairPoses:
    begin, end = spans(matches.offsets)[b]
    rows_p, rows_q = matches.source[begin:end], matches.target[begin:end]
    p, q = source.points[rows_p].double(), target.points[rows_q].double()  # (M, 3)
    center_p, center_q = stable_sum(p) / len(p), stable_sum(q) / len(q)
    own = pair_seed(seed, rows_p - int(source.offsets[b]), rows_q - int(target.offsets[b]))
    centered = ((p - center_p).t().contiguous(), (q - center_q).t().contiguous())
    found = solve(MatchedPoints(*centered, own), options)
    if found.poses is None:
        return _no_pose(found, end - begin, source.device)
    R = found.poses.rotation.permute(2, 0, 1).contiguous()  # (H, 3, 3)
    t = found.poses.translation.t() + center_q - apply_rotation(R, center_p)
    return PairPoses(R, t, found.poses.inliers, found.poses.support, found.poses.error, *found[1:])


def _no_pose(found: Found, matches: int, device: torch.device) -> PairPoses:
    empty = torch.zeros(0, dtype=torch.float64, device=device)
    inliers = torch.zeros(0, matches, dtype=torch.bool, device=device)
    return PairPoses(empty.reshape(0, 3, 3), empty.reshape(0, 3), inliers, empty.long(), empty, *found[1:])


def _check_rows(rows: Tensor, clouds: Clouds, offsets: Tensor, name: str) -> None:
    for (begin, end), (first, last) in zip(spans(offsets), spans(clouds.offsets), strict=True):
        own = rows[begin:end]
        legal = begin == end or bool(((own >= first) & (own < last)).all())
        expect(legal, name, f"rows from {first} to {last - 1} in this pair", own)
