"""What a page says of one pair, gathered once for all of its sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from torchreg.metrics import PoseErrors
from torchreg.report.explain.facts import Facts, facts_of
from torchreg.types import Clouds, RegistrationResult


@dataclass(frozen=True, eq=False, kw_only=True)
class ReportedPair:
    """One pair of a result, with what the page is told beside it.

    Attributes:
        result: of B pairs.
        pair: which one.
        source: the B clouds that were registered, on the processor.
        target: likewise.
        facts: the figures of the pair.
        names: of source and target, short, for headings.
        words: of source and target, for the table, such as file and size.
        file_notes: what reading the clouds showed.
        truth: errors under the true transform, where it is known.
        max_points: of each cloud in the 3D view.
    """

    result: RegistrationResult
    pair: int
    source: Clouds
    target: Clouds
    facts: Facts
    names: tuple[str, str]
    words: tuple[str, str]
    file_notes: Sequence[str]
    truth: PoseErrors | None
    max_points: int

    @property
    def heading(self) -> str:
        """Both names."""
        return f"{self.names[0]} to {self.names[1]}"

    @property
    def clouds(self) -> tuple[Clouds, Clouds]:
        """Source and target of this pair alone."""
        return self.source.select(self.pair), self.target.select(self.pair)

    @property
    def pose(self) -> Tensor | None:
        """The transform (4, 4), of a refused pair its likeliest pose; ``None`` where no pose was weighed."""
        if self.facts.success:
            return self.result.T_target_source[self.pair].detach().cpu()
        candidates = self.facts.candidates
        return candidates[0].T_target_source.detach().cpu() if candidates else None


def reported_pair(
    result: RegistrationResult,
    source: Clouds,
    target: Clouds,
    pair: int,
    *,
    names: tuple[str, str],
    words: tuple[str, str] | None,
    file_notes: Sequence[str],
    truth: PoseErrors | None,
    max_points: int,
) -> ReportedPair:
    """Gather the figures of a pair; ``words`` that are not given are the names and the numbers of points."""
    facts = facts_of(result, pair)
    if words is None:
        counts = [len(clouds.select(pair).points) for clouds in (source, target)]
        words = (f"{names[0]}: {counts[0]:,} points", f"{names[1]}: {counts[1]:,} points")
    return ReportedPair(
        result=result,
        pair=pair,
        source=source.to("cpu"),
        target=target.to("cpu"),
        facts=facts,
        names=names,
        words=words,
        file_notes=tuple(file_notes),
        truth=truth,
        max_points=max_points,
    )
