"""The cells of the study: which subject is timed at which size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from torchreg.benchmark.speed import subjects
from torchreg.benchmark.speed.scene import NEIGHBORS
from torchreg.benchmark.speed.subjects import Subject

POINTS = (1_000, 10_000, 100_000, 1_000_000)
SLOTS = (25, 50, 100, 200)
HYPOTHESES = (10_000, 60_000, 600_000)
_PAIR_POINTS = 10_000  # where matching and the whole pair end: their cost grows with the square

STAGES: dict[str, Subject] = {
    "neighbor search": subjects.search,
    "normals": subjects.normals,
    "FPFH": subjects.fpfh_alone,
    "FPFH + PCFH": subjects.fpfh_and_pcfh,
    "FPFH + PCFH with search": subjects.with_search,
}
MATCHING, WHOLE, RANSAC = "mutual matching", "whole pair", "RANSAC"
GROWTH_SUBJECT = "FPFH + PCFH"
"""What is timed over the number of neighbors."""


@dataclass(frozen=True, kw_only=True)
class TimedCell:
    """One subject at one size."""

    subject: str
    points: int  # of each cloud
    neighbors: int = NEIGHBORS  # slots of FPFH's support
    hypotheses: int = 0  # that RANSAC draws; 0 where it does not take part
    build: Subject  # makes what is timed out of a scene

    @property
    def key(self) -> str:
        """The name of the cell, different for every one."""
        drawn = f", {self.hypotheses:,} hypotheses" if self.hypotheses else ""
        return f"{self.subject}, {self.points:,} points, {self.neighbors} neighbors{drawn}"


def cells(points: tuple[int, ...] = POINTS, hypotheses: tuple[int, ...] = HYPOTHESES) -> Iterator[TimedCell]:
    """All cells, smaller clouds first; whole pairs draw the last number of hypotheses."""
    middle = min(points, key=lambda count: abs(count - _PAIR_POINTS))
    for count in sorted(points):
        for name, build in STAGES.items():
            yield TimedCell(subject=name, points=count, build=build)
        if count == middle:
            for slots in SLOTS:
                if slots != NEIGHBORS:
                    yield TimedCell(subject=GROWTH_SUBJECT, points=count, neighbors=slots, build=STAGES[GROWTH_SUBJECT])
        if count <= max(middle, _PAIR_POINTS):
            yield TimedCell(subject=MATCHING, points=count, build=subjects.matching)
        if count == middle:
            for number in hypotheses:
                yield TimedCell(subject=RANSAC, points=count, hypotheses=number, build=subjects.hypotheses(number))
        if count <= max(middle, _PAIR_POINTS):
            yield TimedCell(
                subject=WHOLE, points=count, hypotheses=hypotheses[-1], build=subjects.whole(hypotheses[-1])
            )
