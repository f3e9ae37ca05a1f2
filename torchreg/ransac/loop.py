"""RANSAC over every pair of a batch (Fischler and Bolles, Comm. ACM 24(6), 1981, doi:10.1145/358669.358692)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.chunks import stable_sum
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.neighbors.coverage import coverage
from torchreg.ransac.sampling import base_seed, pair_seed
from torchreg.ransac.search import Found, search
from torchreg.ransac.verdict import log10_false_alarms, refusal
from torchreg.types import Clouds, Correspondences, HypothesisCounts, RansacOptions, RegistrationResult
from torchreg.types.packing import spans


def ransac(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    options: RansacOptions | Sequence[RansacOptions] | None = None,
    *,
    generator: torch.Generator | None = None,
) -> RegistrationResult:
    """The transform that brings the most correspondences together, of every pair.

    Args:
        source: B clouds.
        target: B clouds.
        matches: correspondences between them, global rows.
        options: for all pairs, or one per pair; ``None`` for the paper's.
        generator: gives one seed for the call; ``None`` is a fixed one. Each pair draws from a generator of its
            own, made from that seed and the pair's correspondences, so its result is bit for bit the same in
            any batch, at any place in it, and with any number of threads.

    Returns:
        RegistrationResult. A pair with too few matches, or on which no hypothesis stands, has ``success``
        false and says why. No gradients.

    Raises:
        ValueError: the numbers of pairs differ, or a correspondence names a row outside its pair's clouds.
    """
    pairs = len(matches)
    expect(len(source) == pairs and len(target) == pairs, "matches", f"{len(source)} pairs", pairs)
    expect(len(target) == len(source), "target", f"{len(source)} clouds, as the source has", len(target))
    per_pair = [options or RansacOptions()] * pairs if not isinstance(options, Sequence) else list(options)
    expect(len(per_pair) == pairs, "options", f"one for all or one per pair ({pairs})", len(per_pair))
    _check_rows(matches.source, source, matches.offsets, "matches.source")
    _check_rows(matches.target, target, matches.offsets, "matches.target")
    seed = base_seed(generator)
    outcomes = [_register_pair(source, target, matches, b, per_pair[b], seed) for b in range(pairs)]
    return _collect(outcomes, matches)


class _Outcome:
    """One pair's share of the result."""

    def __init__(self, matches: int, device: torch.device) -> None:
        self.T = torch.eye(4, dtype=torch.float64, device=device)
        self.inliers = torch.zeros(matches, dtype=torch.bool, device=device)
        self.fitness, self.inlier_rmse, self.reason = 0.0, 0.0, ""
        self.found = Found(None, 0, 0, 0)


def _register_pair(
    source: Clouds, target: Clouds, matches: Correspondences, b: int, options: RansacOptions, seed: int
) -> _Outcome:
    begin, end = spans(matches.offsets)[b]
    outcome = _Outcome(end - begin, source.device)
    if end - begin < options.sample_size:
        outcome.reason = f"too few matches: {end - begin}, and a sample needs {options.sample_size}"
        return outcome
    one, other = source.select(b).points, target.select(b).points
    if not bool(torch.isfinite(one).all() & torch.isfinite(other).all()):
        outcome.reason = "points that are not finite"
        return outcome
    rows_p, rows_q = matches.source[begin:end], matches.target[begin:end]
    p, q = source.points[rows_p].double(), target.points[rows_q].double()  # (M, 3)
    center_p, center_q = stable_sum(p) / len(p), stable_sum(q) / len(q)
    own = pair_seed(seed, rows_p - int(source.offsets[b]), rows_q - int(target.offsets[b]))
    found = search((p - center_p).t().contiguous(), (q - center_q).t().contiguous(), options, own)
    outcome.found = found
    if found.best is None:
        outcome.reason = (
            f"no hypothesis left: of {found.drawn} samples {found.kept} passed the edge-length test, "
            f"and none fits within {options.inlier_threshold:g} m"
        )
        return outcome
    R = found.best.rotation[..., 0]
    t = found.best.translation[:, 0] + center_q - apply_rotation(R, center_p)
    outcome.inliers = found.best.inliers[0]
    near = coverage(one, other, R, t, options.inlier_threshold)
    outcome.fitness, outcome.inlier_rmse = float(near.fitness), float(near.inlier_rmse)
    outcome.T = rigid(R, t + target.origin[b] - apply_rotation(R, source.origin[b]))
    alarms = log10_false_alarms(
        apply_rotation(R, p) + t,
        q,
        options.inlier_threshold,
        sample_size=options.sample_size,
        scored=found.scored,
    )
    outcome.reason = refusal(int(found.best.support), end - begin, alarms)
    return outcome


def _collect(outcomes: list[_Outcome], matches: Correspondences) -> RegistrationResult:
    device = matches.source.device

    def column(values: list[float], dtype: torch.dtype) -> Tensor:
        return torch.tensor(values, dtype=dtype, device=device)

    empty = torch.zeros(0, 4, 4, dtype=torch.float64, device=device)
    counts = [
        column([getattr(outcome.found, name) for outcome in outcomes], torch.int64)
        for name in HypothesisCounts._fields
    ]
    return RegistrationResult(
        T_target_source=torch.stack([outcome.T for outcome in outcomes]) if outcomes else empty,
        inliers=torch.cat([matches.source.new_zeros(0).bool(), *(outcome.inliers for outcome in outcomes)]),
        fitness=column([outcome.fitness for outcome in outcomes], torch.float64),
        inlier_rmse=column([outcome.inlier_rmse for outcome in outcomes], torch.float64),
        success=column([not outcome.reason for outcome in outcomes], torch.bool),
        reason=tuple(outcome.reason for outcome in outcomes),
        hypotheses=HypothesisCounts(*counts),
        correspondences=matches,
    )


def _check_rows(rows: Tensor, clouds: Clouds, offsets: Tensor, name: str) -> None:
    for (begin, end), (first, last) in zip(spans(offsets), spans(clouds.offsets), strict=True):
        own = rows[begin:end]
        legal = begin == end or bool(((own >= first) & (own < last)).all())
        expect(legal, name, f"rows from {first} to {last - 1} in this pair", own)
