"""The study of the whole family on real pairs of known truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell, Study
from torchreg.benchmark.core.tables import Table
from torchreg.benchmark.family.document import csv_text, document, tables
from torchreg.benchmark.family.fusions import Fusion, chosen_fusions
from torchreg.benchmark.family.measure import EFFORTS, Measurement
from torchreg.benchmark.family.pairs import chosen_pairs
from torchreg.benchmark.field.study import list_digest
from torchreg.errors import at_least, expect, one_of

_QUICK_POINTS = 800


@dataclass(frozen=True, kw_only=True)
class FamilyOptions:
    """Which fusions are measured on which pairs, and how."""

    real: Path | None = None  # a list of pairs, or the folder that holds it: those that the library was made on
    hard: Path | None = None  # likewise, of other scenes
    fusions: Sequence[str] | None = None  # their names; ``None`` takes all
    scenes: Sequence[str] | None = None  # whose pairs are taken; ``None`` takes all
    every: int = 1  # of every list, the first pair and every so many-th after it
    effort: str = "balanced"  # or "plain": poses by matches alone, a fraction of the time
    points: int | None = None  # the most of a cloud; clouds of more are averaged over wider voxels
    quick: bool = False  # the pair of either list that overlaps most, of few points
    seed: int = 0  # of every random draw and of the intervals


def family_study(options: FamilyOptions) -> Study:
    """The study of fusions over pairs.

    Raises:
        CloudFileError: a list cannot be read.
        ValueError: no list, or a name that no fusion or no scene has.
    """
    at_least(options.every, "every", 1)
    one_of(options.effort, "effort", EFFORTS)
    expect(options.scenes is None or len(options.scenes) > 0, "scenes", "at least one", options.scenes)
    lists = (("real", options.real), ("hard", options.hard))
    pairs = chosen_pairs(lists, every=options.every, scenes=options.scenes, quick=options.quick)
    fusions = chosen_fusions(options.fusions)
    points = _QUICK_POINTS if options.quick else options.points
    measured = Measurement(pairs, points=points, effort=options.effort, seed=options.seed)
    return Study(
        name="family",
        cells=[
            Cell(f"{pair.key}/{fusion.name}", f"{pair.key}, {fusion.name}", partial(measured.row, number, fusion))
            for number, pair in enumerate(pairs)
            for fusion in fusions
            if fusion.fits(colored=pair.pair.colored)
        ],
        settings={
            **{name: None if path is None else list_digest(path) for name, path in lists},
            **{"points": points, "effort": options.effort, "seed": options.seed},
        },
        run={"fusions": [fusion.name for fusion in fusions], "every": options.every, "quick": options.quick},
        document=lambda rows, _, machine: document(rows, fusions, machine, options.seed),
        csv=lambda rows: {"family.csv": csv_text(rows)},
        shown=partial(_shown, fusions=fusions, seed=options.seed),
    )


def _shown(rows: Sequence[Row], *, fusions: Sequence[Fusion], seed: int) -> list[Table | str]:
    """The shares, and what ended with an error, which else hides among the numbers."""
    made: list[Table | str] = [one for one in tables(rows, fusions, seed) if one.heading.endswith(" scenes")]
    for fusion in fusions:
        ended = [row["error"] for row in rows if row["fusion"] == fusion.name and row["error"]]
        if ended:
            made.append(f"{fusion.name} ended with an error on {len(ended)} pairs, first: {ended[0]}")
    return made
