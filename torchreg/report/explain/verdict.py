"""The pose that was chosen, how firmly, and what is said of it in the end."""

from __future__ import annotations

import math

from torchreg.report.explain.facts import Facts
from torchreg.report.explain.words import chance, line, meters, number, odds, percent

WEAK, FIRM = 0.03, 0.1
"""Strengths: below the one a pose hardly holds in some direction, above the other in all (of real pairs, 0.14 up)."""


def pose_lines(facts: Facts) -> list[str]:
    """Pose, runner-up, overlap, strength and fit: a line for each that the result speaks of."""
    lines = []
    if facts.candidates:
        chosen = "from" if facts.success else "none accepted; the likeliest is from"
        lines.append(line("Pose", f"{chosen} {facts.candidates[0].origin}"))
    if facts.margin is not None or facts.apart is not None:
        lines.append(line("Runner-up", runner_up_words(facts)))
    if facts.overlap is not None:
        lines.append(line("Overlap", f"{percent(facts.overlap)} of the points have a partner{_within(facts)}"))
    if facts.strength is not None:
        lines.append(line("Strength", f"{number(facts.strength)} of 1: {meaning_of_strength(facts.strength)}"))
    if facts.fitness > 0:
        near = f"fitness {number(facts.fitness)} (source points with a target point{_within(facts)})"
        lines.append(line("Fit", f"{near}, inlier_rmse {meters(facts.inlier_rmse)}"))
    return lines


def verdict_line(facts: Facts) -> str:
    """Registered or not, how likely that is right, and why not."""
    said = "registered" if facts.success else "not registered"
    if facts.probability is not None:
        said += f", probability {chance(facts.probability)} that the pose is right"
    return line("Verdict", said + ("" if facts.success or facts.failure is None else f"; {facts.failure}"))


def runner_up_words(facts: Facts) -> str:
    """How far away the best other pose is, and by how much the pose leads it."""
    if facts.apart is None:
        return "none: no other distinct pose was weighed"
    degrees, distance = facts.apart
    said = f"turned by {degrees:.3g} degrees, the middle of the overlap moved by {meters(distance)}"
    if facts.margin is None or not math.isfinite(facts.margin):
        return said
    return f"{said}; log-odds {number(facts.margin, 1)} lower ({odds(facts.margin)})"


def meaning_of_strength(strength: float) -> str:
    """What a strength says of the pose."""
    if strength < WEAK:
        return "in some direction the surfaces hardly hold the pose, it can slide or turn there"
    if strength < FIRM:
        return "in some direction the surfaces hold the pose weakly"
    return "the surfaces hold the pose in every direction"


def _within(facts: Facts) -> str:
    return " within the inlier threshold" if facts.threshold is None else f" within {meters(facts.threshold)}"
