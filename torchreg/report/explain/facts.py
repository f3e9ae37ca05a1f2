"""The figures of one pair, taken out of a result once, as plain numbers."""

from __future__ import annotations

import math
from typing import NamedTuple

from torch import Tensor

from torchreg.errors import expect
from torchreg.registration.options import RegistrationOptions
from torchreg.types import Candidate, Failure, RegistrationResult, StageCounts
from torchreg.types.packing import spans

WEAK, FIRM_STRENGTH = 0.03, 0.1
"""Strengths: below the one a pose hardly holds in some direction, above the other in all (of real pairs, 0.14 up)."""


class Facts(NamedTuple):
    """One pair in plain numbers; ``None`` for a figure that was not computed, or of a pose where there is none.

    The names are those of ``RegistrationResult`` and of its ``HypothesisCounts``, but for those with a comment.
    """

    success: bool
    failure: Failure | None
    notes: tuple[str, ...]
    colored: bool  # whether both clouds that were matched have colors
    unknown_viewpoints: tuple[str, ...]  # of which of "source" and "target" it is not known
    assumed_viewpoints: tuple[str, ...]  # of those, for which there is a guess
    options: RegistrationOptions | None
    stages: StageCounts | None
    matches: int  # number of correspondences
    inliers: int  # of those, how many agree with the pose
    drawn: int
    kept: int
    scored: int
    fitness: float
    inlier_rmse: float
    probability: float | None
    overlap: float | None
    strength: float | None
    margin: float | None
    residuals: tuple[float, float, float] | None  # meters: median, root mean square, 95 % of surfaces
    deviations: tuple[float, ...] | None  # of turns about x, y, z (radians) and shifts (meters), from the covariance
    axis_strength: tuple[float, ...] | None
    apart: tuple[float, float] | None  # degrees and meters between the pose and its runner-up
    candidates: tuple[Candidate, ...]

    @property
    def threshold(self) -> float | None:
        """The inlier threshold, meters."""
        return None if self.options is None else self.options.inlier_threshold

    @property
    def radius(self) -> float | None:
        """The support radius of the first descriptor, meters."""
        return None if self.options is None else self.options.descriptors[0].radius


def facts_of(result: RegistrationResult, pair: int) -> Facts:
    """The figures of one pair.

    Raises:
        ValueError: ``pair`` is not one of the result's.
    """
    expect(0 <= pair < len(result), "pair", f"a number from 0 to {len(result) - 1}", pair)
    begin, end = spans(result.correspondences.offsets)[pair]
    drawn, kept, scored = (int(value[pair]) for value in result.hypotheses)
    sides = {"source": result.source, "target": result.target}
    candidates = result.candidates[pair] if result.candidates else ()
    posed = not result.candidates or len(candidates) > 0
    return Facts(
        success=bool(result.success[pair]),
        failure=result.failure[pair],
        notes=result.notes[pair] if result.notes else (),
        colored=all(clouds.colors is not None for clouds in sides.values()),
        unknown_viewpoints=tuple(name for name, clouds in sides.items() if not clouds.viewpoint_known[pair]),
        assumed_viewpoints=tuple(name for name, clouds in sides.items() if clouds.viewpoint_assumed[pair]),
        options=result.options[pair] if result.options else None,
        stages=result.stages[pair] if result.stages else None,
        matches=end - begin,
        inliers=int(result.inliers[begin:end].sum()),
        drawn=drawn,
        kept=kept,
        scored=scored,
        fitness=float(result.fitness[pair]),
        inlier_rmse=float(result.inlier_rmse[pair]),
        probability=_known(result.probability, pair),
        overlap=_known(result.overlap, pair) if posed else None,
        strength=_known(result.strength, pair) if posed else None,
        margin=_known(result.margin, pair) if posed else None,
        residuals=_residuals(result, pair),
        deviations=_deviations(result, pair),
        axis_strength=_numbers(result.axis_strength, pair),
        apart=_apart(result, pair, candidates) if posed else None,
        candidates=candidates,
    )


def _known(values: Tensor | None, pair: int) -> float | None:
    value = math.nan if values is None else float(values[pair])
    return None if math.isnan(value) else value


def _apart(result: RegistrationResult, pair: int, candidates: tuple[Candidate, ...]) -> tuple[float, float] | None:
    """Degrees between the pose and its runner-up, and meters by which they part the middle of the overlap.

    The middle is that of the target points with a partner, which the information matrix holds; the difference of the
    translations would depend on how far the clouds lie from their zero. A failed pair's pose is its best candidate.
    """
    if result.runner_up is None or not (bool(result.success[pair]) or candidates):
        return None
    other = result.runner_up[pair].detach().cpu()
    pose = result.T_target_source[pair] if bool(result.success[pair]) else candidates[0].T_target_source
    pose = pose.detach().cpu()
    turn = (other[:3, :3] @ pose[:3, :3].T).tolist()
    if not all(math.isfinite(value) for row in turn for value in row):
        return None
    axis = math.hypot(turn[2][1] - turn[1][2], turn[0][2] - turn[2][0], turn[1][0] - turn[0][1])
    degrees = math.degrees(math.atan2(axis, turn[0][0] + turn[1][1] + turn[2][2] - 1))
    middle = _middle(result, pair)
    if middle is None:
        return degrees, float((other[:3, 3] - pose[:3, 3]).norm())
    x, y, z = middle
    at = pose.new_tensor([x, y, z])  # (3,) in the target's frame
    moved = (other[:3, :3] @ (pose[:3, :3].T @ (at - pose[:3, 3]))) + other[:3, 3]
    return degrees, float((moved - at).norm())


def _middle(result: RegistrationResult, pair: int) -> tuple[float, float, float] | None:
    """The mean of the target points that the information matrix sums: its off-diagonal block is their sum as [s]x."""
    if result.information is None:
        return None
    rows = result.information[pair].tolist()
    count = rows[3][3]
    return (rows[2][4] / count, rows[0][5] / count, rows[1][3] / count) if count > 0 else None


def _numbers(values: Tensor | None, pair: int) -> tuple[float, ...] | None:
    """The pair's numbers; ``None`` where one of them was not computed."""
    own = None if values is None else tuple(values[pair].tolist())
    return own if own is not None and all(map(math.isfinite, own)) else None


def _residuals(result: RegistrationResult, pair: int) -> tuple[float, float, float] | None:
    known = [_known(value, pair) for value in (result.residual_median, result.residual_rms, result.residual_95)]
    median, rms, most = known
    return None if median is None or rms is None or most is None else (median, rms, most)


def _deviations(result: RegistrationResult, pair: int) -> tuple[float, ...] | None:
    return None if result.covariance is None else _numbers(result.covariance.diagonal(dim1=1, dim2=2).sqrt(), pair)
