"""From the points as they came to the candidates: what each stage had and what it lost."""

from __future__ import annotations

import math

from torchreg.registration.options import RegistrationOptions
from torchreg.report.explain.facts import Facts
from torchreg.report.explain.words import chance, columns, indented, line, meters, number, part, percent
from torchreg.types.candidate import Candidate, Proposal, StageCounts

_SHOWN = 6
_HEADINGS = ("origin", "support", "by chance", "overlap", "normals", "colors", "conflict", "log-odds", "probability")


def stage_lines(facts: Facts) -> list[str]:
    """A line per stage: points, features, and every set of features with its solver."""
    lines = [] if facts.stages is None else _points(facts.stages, facts.options)
    proposals = () if facts.stages is None else facts.stages.proposals
    if proposals:
        lines += [text for proposal in proposals for text in _proposal(proposal)]
    else:
        lines += _search(facts)
    return lines + [line("Note", note) for note in facts.notes]


def candidate_lines(facts: Facts) -> list[str]:
    """The best candidates as a table; nothing where none was weighed."""
    if not facts.candidates:
        return []
    rows = [_HEADINGS, *(_cells(candidate) for candidate in facts.candidates[:_SHOWN])]
    rest = len(facts.candidates) - _SHOWN
    headline = "best first; " + (f"the best {_SHOWN} of {len(facts.candidates)}" if rest > 0 else "all of them")
    return [line("Candidates", headline), *(f"  {row}" for row in columns(rows))]


def _points(stages: StageCounts, options: RegistrationOptions | None) -> list[str]:
    (source, target), (few_source, few_target) = stages.given, stages.points
    given = f"{source:,} (source) and {target:,} (target) given"
    if options is not None and options.voxel_size is not None:
        given += f", {few_source:,} and {few_target:,} left by voxels of {meters(options.voxel_size)}"
    elif stages.points != stages.given:
        given += f", {few_source:,} and {few_target:,} used"
    else:
        given += ", used as they are"
    described = " and ".join(part(count, whole) for count, whole in zip(stages.described, stages.points, strict=True))
    radius = "" if options is None else f", from {meters(options.feature_radius)} about each"
    return [line("Points", given), line("Features", f"{described} have one{radius}")]


def _proposal(proposal: Proposal) -> list[str]:
    """What it is, and below that what it had."""
    poses = f"{proposal.poses:,} {'pose' if proposal.poses == 1 else 'poses'}"
    agree = percent(proposal.support / max(proposal.matches, 1))
    best = f", the best with {proposal.support:,} inliers ({agree})" if proposal.poses else ""
    hypotheses = f"{proposal.drawn:,} hypotheses, {proposal.kept:,} kept, {proposal.scored:,} scored"
    return [line("Proposal", proposal.origin), indented(f"{proposal.matches:,} matches; {hypotheses}; {poses}{best}")]


def _search(facts: Facts) -> list[str]:
    """What a result made by a solver alone knows of its search."""
    within = "" if facts.threshold is None else f" within {meters(facts.threshold)}"
    hypotheses = f"{facts.drawn:,} drawn, {facts.kept:,} kept by the first test, {facts.scored:,} scored on all matches"
    return [
        line("Matches", f"{facts.matches:,}"),
        line("Hypotheses", hypotheses),
        line("Inliers", f"{part(facts.inliers, facts.matches)} matches{within}"),
    ]


def _cells(candidate: Candidate) -> tuple[str, ...]:
    return (
        candidate.origin,
        f"{candidate.support:,} of {candidate.matches:,}" if candidate.matches else "-",
        _by_chance(candidate.surprise),
        number(candidate.overlap),
        number(candidate.normals),
        number(candidate.colors),
        number(candidate.conflict),
        number(candidate.log_odds, 1),
        chance(candidate.probability),
    )


def _by_chance(surprise: float) -> str:
    """How likely unrelated matches agree as well, as a power of ten."""
    if math.isnan(surprise):
        return "-"
    return f"10^-{surprise:.0f}" if surprise >= 0.5 else "1"
