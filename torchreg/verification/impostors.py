"""A pair that no rigid motion explains is refused by name: mirrored, or of another scale."""

from __future__ import annotations

from torchreg.types import Failure
from torchreg.verification.agreement import MatchEndpoints
from torchreg.verification.similarity import Mirrored, RigidFit, Scaled, impossible_as_rigid

IMPOSTORS = ("mirrored", "scaled")
"""Kinds of failure of pairs that no rigid pose can be right for."""


def impostor(matches: MatchEndpoints, threshold: float, rigid: RigidFit) -> Failure | None:
    """Why no rigid pose of one pair can be right, by its matches; ``None`` where one may be.

    ``threshold`` is that within which these matches agree, meters; ``rigid`` is what supports the best pose among them.
    """
    finding = impossible_as_rigid(matches.source, matches.target, threshold, rigid)
    if finding is None:
        return None
    count, explained = len(matches.source), int(rigid.inliers.sum())
    if isinstance(finding, Mirrored):
        return mirrored_failure(finding, count, explained)
    return scaled_failure(finding, count, explained)


def mirrored_failure(finding: Mirrored, matches: int, rigid: int) -> Failure:
    """The failure of a pair of which one cloud is mirrored; so many ``matches``, and ``rigid`` of them agree as is."""
    text = (
        f"mirrored: {finding.support:,} of {matches:,} matches agree when one cloud is mirrored, "
        f"{rigid:,} when it is not: a left-handed export?"
    )
    return Failure("mirrored", text, {"support": finding.support, "matches": matches, "rigid_support": rigid})


def scaled_failure(finding: Scaled, matches: int, rigid: int) -> Failure:
    """The failure of a pair whose clouds differ by a factor; ``matches`` and ``rigid`` as of ``mirrored_failure``."""
    larger, smaller, factor, deviation = "target", "source", finding.factor, finding.deviation
    if factor < 1:
        larger, smaller, factor, deviation = "source", "target", 1 / factor, deviation / factor**2
    text = (
        f"scaled: the {larger} is {factor:.3g} times as large as the {smaller} ({factor:.4f} +- {deviation:.4f}): "
        f"{finding.support:,} of {matches:,} matches agree at one scale, {rigid:,} as the clouds are"
    )
    figures = {"factor": finding.factor, "deviation": finding.deviation}
    return Failure("scaled", text, {**figures, "support": finding.support, "matches": matches, "rigid_support": rigid})
