"""A result in words."""

from __future__ import annotations

from torchreg.report.explain.advice import advice, settled
from torchreg.report.explain.facts import facts_of
from torchreg.report.explain.stages import candidate_lines, stage_lines
from torchreg.report.explain.verdict import pose_lines, verdict_line
from torchreg.report.explain.words import line
from torchreg.types.result import RegistrationResult, explained_by


@explained_by
def explanation(result: RegistrationResult, pair: int) -> str:
    """What each stage of one pair had and lost, and the settings most likely to help.

    A line per stage in the order of the run, a table of the candidates, then the pose, its runner-up, overlap,
    strength and fit, the verdict, and advice that each time names the figure it follows from. A result made by a
    solver alone is explained with what it has.

    Args:
        result: of B pairs.
        pair: which one, from 0 to B - 1.

    Returns:
        Lines of plain text without a line break at the end.

    Raises:
        ValueError: ``pair`` is not one of the result's.
    """
    facts = facts_of(result, pair)
    lines = stage_lines(facts) + candidate_lines(facts) + pose_lines(facts) + [verdict_line(facts)]
    said = advice(facts) or [settled(facts)]
    return "\n".join(lines + [line("May help" if place == 0 else "", text) for place, text in enumerate(said)])
