"""A result in words: a line per stage, the candidates, the pose and its verdict, and what may help."""

from __future__ import annotations

import math
from collections.abc import Iterator

from torchreg.report.explain.advice import advice
from torchreg.report.explain.facts import FIRM_STRENGTH, WEAK, Facts, facts_of
from torchreg.report.text import chance, columns, decimal, line, meters, millimeters, odds, percent, share
from torchreg.types import Candidate, RegistrationResult, StageCounts

_SHOWN = 6
_EVEN, _NOTHING = 0.5, 1e-3  # strengths: about alike in all directions; not held at all in one
CANDIDATE_HEADINGS = (
    "origin",
    "support",
    "by chance",
    "overlap",
    "normals",
    "colors",
    "conflict",
    "log-odds",
    "probability",
)


def explanation(result: RegistrationResult, pair: int) -> str:
    """Describe how much each stage of one pair had and lost, and the settings most likely to help.

    A line per stage in the order of the run, a table of the candidates, then the pose, its runner-up, overlap,
    strength and fit, the verdict, and advice that each time names the figure it follows from. A result made by a
    solver alone is explained by the fields it has.

    Args:
        result: of B pairs.
        pair: which one, from 0 to B - 1.

    Returns:
        Lines of plain text without a line break at the end.

    Raises:
        ValueError: ``pair`` is not one of the result's.
    """
    facts = facts_of(result, pair)
    lines = [*stage_lines(facts), *_candidates(facts), *_pose(facts), line("Verdict", verdict_text(facts))]
    return "\n".join(lines + [line("May help" if place == 0 else "", text) for place, text in enumerate(advice(facts))])


def runner_up_text(facts: Facts) -> str:
    """How far away the best other pose is, and by how much the pose leads it."""
    if facts.apart is None:
        return "none: no other distinct pose was weighed"
    degrees, distance = facts.apart
    text = f"turned by {degrees:.3g} degrees, the middle of the overlap moved by {meters(distance)}"
    if facts.margin is None or not math.isfinite(facts.margin):
        return text
    return f"{text}; log-odds {decimal(facts.margin, 1)} lower ({odds(facts.margin)})"


def residuals_text(facts: Facts) -> str:
    """How far the surfaces of the overlap lie apart; empty where it was not measured."""
    if facts.residuals is None:
        return ""
    return residuals_line(*facts.residuals)


def residuals_line(median: float, rms: float, most: float) -> str:
    """Residuals of surfaces, meters, in words."""
    between = f"median {millimeters(median)}, RMS {millimeters(rms)}, 95 % below {millimeters(most)}"
    return f"{between}, between the surfaces of the overlap"


def deviations_text(facts: Facts) -> str:
    """The standard deviations of the pose; empty where they are not known."""
    if facts.deviations is None:
        return ""
    turns = ", ".join(f"{math.degrees(turn):.2g}" for turn in facts.deviations[:3])
    return (
        f"{millimeters(*facts.deviations[3:])} along x, y, z; {turns} degrees about them, at the middle of the overlap"
    )


def axis_strength_text(facts: Facts) -> str:
    """How firmly each motion is held; empty where it is not known."""
    if facts.axis_strength is None:
        return ""
    turns, shifts = ([f"{value:.2f}" for value in part] for part in (facts.axis_strength[:3], facts.axis_strength[3:]))
    return f"{', '.join(shifts)} of 1 along x, y, z; {', '.join(turns)} about them"


def meaning_of_strength(strength: float) -> str:
    """How firmly the surfaces hold a pose of this strength where they hold it least.

    The information about a direction is the inverse square of how far the pose may be off there, so 1 / strength is
    by how many times it may be farther off in the loosest direction than in the firmest.
    """
    times = f"{1 / strength:.2g} times" if strength > _NOTHING else "far"
    held = f"held {times} less firmly in its loosest direction than in its firmest"
    if strength < WEAK:
        return f"{held}: it can slide or turn there"
    if strength < FIRM_STRENGTH:
        return f"{held}, which is weak"
    if strength < _EVEN:
        return f"{held}, which is usual"
    return "held about as firmly in every direction"


def stage_lines(facts: Facts) -> Iterator[str]:
    """Points, features, every set of features with its solver, and notes."""
    if facts.stages is not None:
        yield from _points(facts.stages, facts)
    if facts.stages is not None and facts.stages.proposals:
        for proposal in facts.stages.proposals:
            poses = f"{proposal.poses:,} {'pose' if proposal.poses == 1 else 'poses'}"
            agree = percent(proposal.support / max(proposal.matches, 1))
            best = f", the best with {proposal.support:,} inliers ({agree})" if proposal.poses else ""
            hypotheses = f"{proposal.drawn:,} hypotheses, {proposal.kept:,} kept, {proposal.scored:,} scored"
            yield line("Proposal", proposal.origin)
            yield line("", f"{proposal.matches:,} matches; {hypotheses}; {poses}{best}")
    else:
        drawn = f"{facts.drawn:,} drawn, {facts.kept:,} kept by the first test, {facts.scored:,} scored on all matches"
        within = "" if facts.threshold is None else f" within {meters(facts.threshold)}"
        yield line("Matches", f"{facts.matches:,}")
        yield line("Hypotheses", drawn)
        yield line("Inliers", f"{share(facts.inliers, facts.matches)} matches{within}")
    for note in facts.notes:
        yield line("Note", note)


def _points(stages: StageCounts, facts: Facts) -> Iterator[str]:
    options = facts.options
    (source, target), (few_source, few_target) = stages.given, stages.points
    given = f"{source:,} (source) and {target:,} (target) given"
    if options is not None and options.voxel_size is not None:
        given += f", {few_source:,} and {few_target:,} left by voxels of {meters(options.voxel_size)}"
    elif stages.points != stages.given:
        given += f", {few_source:,} and {few_target:,} used"
    else:
        given += ", used as they are"
    pairs = zip(stages.described, stages.points, strict=True)
    described = " and ".join(share(count, whole) for count, whole in pairs)
    radius = "" if facts.radius is None else f", from {meters(facts.radius)} about each"
    yield line("Points", given)
    yield line("Features", f"{described} have one{radius}")


def _candidates(facts: Facts) -> Iterator[str]:
    """The best candidates as a table; nothing where none was weighed."""
    if not facts.candidates:
        return
    rest = len(facts.candidates) - _SHOWN
    extent = f"the best {_SHOWN} of {len(facts.candidates)}" if rest > 0 else "all of them"
    yield line("Candidates", f"best first; {extent}")
    rows = [CANDIDATE_HEADINGS, *(candidate_cells(candidate) for candidate in facts.candidates[:_SHOWN])]
    yield from (f"  {row}" for row in columns(rows))


def candidate_cells(candidate: Candidate) -> tuple[str, ...]:
    """What the table of the candidates has of one, below its headings."""
    return (
        candidate.origin,
        f"{candidate.support:,} of {candidate.matches:,}" if candidate.matches else "-",
        _by_chance(candidate.surprise),
        decimal(candidate.overlap),
        decimal(candidate.normals),
        decimal(candidate.colors),
        decimal(candidate.conflict),
        decimal(candidate.log_odds, 1),
        chance(candidate.probability),
    )


def _by_chance(surprise: float) -> str:
    """How likely unrelated matches agree as well, as a power of ten."""
    if math.isnan(surprise):
        return "-"
    return f"10^-{surprise:.0f}" if surprise >= 0.5 else "1"


def _pose(facts: Facts) -> Iterator[str]:
    """Pose, runner-up, overlap, strength and fit: a line for each that is known."""
    within = "the inlier threshold" if facts.threshold is None else meters(facts.threshold)
    if facts.candidates:
        chosen = "from" if facts.success else "none accepted; the likeliest is from"
        yield line("Pose", f"{chosen} {facts.candidates[0].origin}")
    if facts.margin is not None or facts.apart is not None:
        yield line("Runner-up", runner_up_text(facts))
    if facts.overlap is not None:
        yield line("Overlap", f"{percent(facts.overlap)} of the points have a partner within {within}")
    if facts.strength is not None:
        yield line("Strength", f"{decimal(facts.strength)} of 1: {meaning_of_strength(facts.strength)}")
    for name, text in (
        ("Residuals", residuals_text(facts)),
        ("Deviation", deviations_text(facts)),
        ("By axis", axis_strength_text(facts)),
    ):
        if text:
            yield line(name, text)
    if facts.fitness > 0:
        near = f"fitness {decimal(facts.fitness)} (source points with a target point within {within})"
        yield line("Fit", f"{near}, inlier_rmse {meters(facts.inlier_rmse)}")


def verdict_text(facts: Facts) -> str:
    """Registered or not, how likely that is right, and why not."""
    verdict = "registered" if facts.success else "not registered"
    if facts.probability is not None:
        verdict += f", probability {chance(facts.probability)} that the pose is right"
    return verdict + ("" if facts.success or facts.failure is None else f"; {facts.failure}")
