"""The verdict on a given transform in words: what speaks for and against it, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from torchreg.errors import expect
from torchreg.metrics import rre
from torchreg.report.explain.advice import advice
from torchreg.report.explain.explanation import CANDIDATE_HEADINGS, candidate_cells, stage_lines
from torchreg.report.explain.facts import Facts, facts_of
from torchreg.report.text import chance, columns, decimal, distance, line, meters, percent
from torchreg.types import Verification

_SAME = 1e-6  # meters


def explanation_of_given(result: Verification, pair: int) -> str:
    """Describe what the clouds and the search say of one given transform.

    A line per stage of the search, a table of the given transform beside the pose that it settles to and its rival,
    then its fit, where it settles, the verdict, and advice.

    Args:
        result: of B pairs.
        pair: which one, from 0 to B - 1.

    Returns:
        Lines of plain text without a line break at the end.

    Raises:
        ValueError: ``pair`` is not one of the result's.
    """
    expect(0 <= pair < len(result), "pair", f"a number from 0 to {len(result) - 1}", pair)
    facts = facts_of(result.search, pair)
    lines = [*stage_lines(facts), *_poses(result, pair), _verdict(result, pair)]
    helps = _advice(result, pair, facts)
    return "\n".join(lines + [line("May help" if place == 0 else "", text) for place, text in enumerate(helps)])


def deviation_text(result: Verification, pair: int) -> str:
    """How far the given transform lies from the pose that it settles to."""
    apart, turned = float(result.deviation_meters[pair]), float(result.deviation_degrees[pair])
    if apart == 0:
        return "where it is: refinement finds nothing better nearby"
    if apart < _SAME:
        return "where it is, to a micrometer"
    allowed = meters(result.options[pair].inlier_threshold)
    return f"{distance(apart)} and {turned:.3g} degrees away, root mean square over the source ({allowed} are allowed)"


def rival_text(result: Verification, pair: int) -> str:
    """How the best other pose compares with the pose that the given transform settles to."""
    rival = result.rival[pair]
    if rival is None:
        return "none: no other distinct pose was weighed"
    turned = float(rre(result.settled[pair], rival.T_target_source))
    return f"from {rival.origin}, turned by {turned:.3g} degrees; probability {chance(rival.probability)}"


def _poses(result: Verification, pair: int) -> Iterator[str]:
    """The given transform beside its rivals, and its figures; nothing where the clouds cannot be registered."""
    given, settled, rival = result.candidate[pair], result.settled_candidate[pair], result.rival[pair]
    if given is None:
        return
    named = (("as given", given), ("settled", settled), ("rival", rival))
    rows = [(name, each) for name, each in named if each is not None]
    yield line("Evidence", "of the given transform, of the pose that it settles to, and of the best other pose")
    cells = [("pose", *CANDIDATE_HEADINGS[1:]), *((name, *candidate_cells(each)[1:]) for name, each in rows)]
    yield from (f"  {row}" for row in columns(cells))
    within = meters(result.options[pair].inlier_threshold)
    fitness = decimal(float(result.fitness[pair]))
    near = f"fitness {fitness} (source points with a target point within {within})"
    yield line("Overlap", f"{percent(given.overlap)} of the points have a partner within {within}")
    yield line("Fit", f"{near}, inlier_rmse {meters(float(result.inlier_rmse[pair]))}")
    yield line("Settles", deviation_text(result, pair))
    yield line("Rival", rival_text(result, pair))


def _verdict(result: Verification, pair: int) -> str:
    right = bool(result.success[pair])
    stated = f"probability {chance(float(result.probability[pair]))} that the given transform is right"
    return line("Verdict", f"right, {stated}" if right else f"not right, {stated}; {result.reason[pair]}")


def _settled(result: Verification, pair: int, facts: Facts) -> list[str]:
    return ["the settled pose in its place: it is trusted, and the given transform lies too far from it"]


def _likeliest(result: Verification, pair: int, facts: Facts) -> list[str]:
    if facts.success:
        return ["the likeliest pose in its place, which is trusted"]
    return advice(facts)


_RULES: dict[str, Callable[[Verification, int, Facts], list[str]]] = {
    "displaced": _settled,
    "another pose is better": _likeliest,
}
"""By the kinds of failure that only a given transform has."""


def _advice(result: Verification, pair: int, facts: Facts) -> list[str]:
    """What to do; where the search is in doubt itself, what may help the search."""
    failure = result.failure[pair]
    if failure is None:
        apart = f"{distance(float(result.deviation_meters[pair]))} away"
        return [f"nothing needs to change to the inlier threshold; beyond it, take the settled pose, {apart}"]
    rule = _RULES.get(failure.kind)
    return advice(facts) if rule is None else rule(result, pair, facts)
