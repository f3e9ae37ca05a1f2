"""From the poses that the recipes proposed to the result: the solver's best, or the choice on the clouds."""

from __future__ import annotations

from collections.abc import Sequence

from torchreg.registration.recipes import solvers_of
from torchreg.solvers import result_of_poses
from torchreg.types import Clouds, RegistrationOptions, RegistrationResult
from torchreg.verification import Care, Lengths, Proposed
from torchreg.verification.verify import verify

CARE = {
    "fast": Care(poses=6, sample=600, refined=1, iterations=5, accepted=0.75),
    "balanced": Care(poses=10, sample=1000, refined=3, iterations=10),
    "thorough": Care(poses=16, sample=1500, refined=8, iterations=20),
}
"""How closely candidates are looked at, by effort; points far apart tell less, so that fast asks for more."""


def decide(
    source: Clouds,
    target: Clouds,
    spacings: tuple[Sequence[float], Sequence[float]],
    proposed: Sequence[Proposed],
    options: Sequence[RegistrationOptions],
) -> RegistrationResult:
    """The best pose of every pair and the verdict on it; ``spacings`` are those of both sides' points, meters."""
    first = options[0]
    if first.effort == "plain":
        solvers = solvers_of(first.solver, options)
        return result_of_poses(source, target, proposed[0].matches, proposed[0].poses, solvers)
    lengths = [
        Lengths(option.ransac.inlier_threshold, max(apart))
        for option, apart in zip(options, zip(*spacings, strict=True), strict=True)
    ]
    return verify(source, target, proposed, lengths, CARE[first.effort])
