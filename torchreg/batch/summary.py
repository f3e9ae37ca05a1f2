"""The summary of a batch: how many pairs are registered, how many of those with a truth are right, and the worst."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

from torchreg.batch.rows import BROKEN, REFUSED, REGISTERED, UNREADABLE

_WORST = 10


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Counts of pairs unless stated."""

    pairs: int  # all
    clouds: int  # different files among their sources and targets
    registered: int  # with a pose that is trusted
    refused: int  # without one, each for its reason
    unreadable: int  # a cloud could not be read
    broken: int  # failed by a defect of ours
    with_truth: int  # whose transform is known
    recalled: int  # of those, registered and right
    wrong_registered: int  # of those, registered and wrong
    right_refused: int  # of those, refused though the best pose was right
    rre_degrees: float | None  # median over the recalled pairs; ``None`` without any
    rte_meters: float | None  # likewise
    seconds: dict[str, float]  # by stage, over all pairs, summed over workers
    # (name, what is wrong) of the pairs to check first, the worst first: registered but wrong, failed, refused, then
    # registered ones of the least probability
    worst: tuple[tuple[str, str], ...]

    @property
    def recall(self) -> float | None:
        """Share of the pairs with a truth that are registered and right."""
        return self.recalled / self.with_truth if self.with_truth else None

    def plain(self) -> dict[str, Any]:
        """All fields, ready for JSON."""
        return {**asdict(self), "recall": self.recall}


def summarize(
    lines: Sequence[Mapping[str, Any]], seconds: Sequence[Mapping[str, float]], work: Mapping[str, float]
) -> Summary:
    """Summarize the lines of a table, the seconds of their stages, and those of work of no single pair."""
    states = [line["state"] for line in lines]
    known = [line for line in lines if line["found"] is not None]
    right = [line for line in known if line["found"] and line["success"]]
    total = dict(work)
    for one in seconds:
        for stage, spent in one.items():
            total[stage] = total.get(stage, 0.0) + spent
    worst = sorted(lines, key=_badness)[:_WORST]
    return Summary(
        pairs=len(lines),
        clouds=len({line[side] for line in lines for side in ("source", "target")}),
        registered=states.count(REGISTERED),
        refused=states.count(REFUSED),
        unreadable=states.count(UNREADABLE),
        broken=states.count(BROKEN),
        with_truth=len(known),
        recalled=len(right),
        wrong_registered=sum(line["success"] and not line["found"] for line in known),
        right_refused=sum(line["found"] and not line["success"] for line in known),
        rre_degrees=median(line["rre_degrees"] for line in right) if right else None,
        rte_meters=median(line["rte_meters"] for line in right) if right else None,
        seconds=total,
        worst=tuple((line["name"], _trouble(line)) for line in worst),
    )


def _badness(line: Mapping[str, Any]) -> tuple[int, float]:
    """A key that sorts the worst pairs first."""
    certainty = line["probability"] if line["probability"] is not None else (line["fitness"] or 0.0)
    if line["success"] and line["found"] is False:
        return 0, -(math.inf if line["rte_meters"] is None else line["rte_meters"])
    return [BROKEN, UNREADABLE, REFUSED, REGISTERED].index(line["state"]) + 1, certainty


def _trouble(line: Mapping[str, Any]) -> str:
    if line["success"] and line["found"] is False:
        if line["rre_degrees"] is None or line["rte_meters"] is None:
            return "registered, but wrong beyond measure"
        return f"registered, but wrong by {line['rre_degrees']:.3g} degrees and {line['rte_meters']:.3g} m"
    if not line["success"]:
        right = " (its best pose is right)" if line["found"] else ""
        return f"{line['state']}: {line['reason']}{right}"
    if line["probability"] is not None:
        return f"registered, probability {line['probability']:.3f}"
    return f"registered, fitness {line['fitness']:.3f}"
