"""The study of the paper's five experiments."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Study
from torchreg.benchmark.core.tables import Table
from torchreg.benchmark.paper.document import csv_files, markdown, overview
from torchreg.benchmark.paper.measure import error_cells
from torchreg.benchmark.paper.pictures import draw
from torchreg.benchmark.paper.places import MALL, Place, real_places, simulated_places
from torchreg.benchmark.paper.settings import EXPERIMENTS, FULL, QUICK, RUNS, settings_of
from torchreg.benchmark.paper.summary import errors_of, times_of
from torchreg.benchmark.paper.tables import added_in_words
from torchreg.benchmark.paper.times import time_cells
from torchreg.errors import expect


def paper_study(
    experiments: Sequence[int] = EXPERIMENTS,
    *,
    seeds: int = 60,
    seed: int = 0,
    real: Path | None = None,
    quick: bool = False,
    device: str = "cpu",
) -> Study:
    """The study of the paper's experiments on simulated and on real scans.

    Args:
        experiments: of 1 to 5, at least one.
        seeds: simulated halls and roads, a count.
        seed: of the first of them.
        real: a list of real pairs or the folder of one, or ``None`` for the simulated scans alone.
        quick: small sizes, one real pair of each kind.
        device: where to compute, as PyTorch names it.

    Raises:
        ValueError: another experiment, or none.
        CloudFileError: the list cannot be read.
    """
    expect(len(experiments) > 0, "experiments", "at least one", experiments)
    for number in experiments:
        expect(number in EXPERIMENTS, "experiments", "numbers from 1 to 5", number)
    size = QUICK if quick else FULL
    places = chosen_places(experiments, seeds=seeds, seed=seed, real=real, quick=quick)
    settings = [setting for number in experiments for setting in settings_of(number)]
    cells = error_cells(places, settings, size, torch.device(device))
    if 4 in experiments:
        timed = next(place for place in places if place.group is MALL)
        cells += time_cells(timed, size, torch.device(device))
    return Study(
        name="paper",
        cells=cells,
        settings={"seed": seed, "quick": quick, "device": device, "runs": RUNS},
        run={"experiments": experiments, "seeds": seeds},
        document=partial(markdown, quick=quick),
        content=lambda rows: {"errors": errors_of(rows), "times": times_of(rows)},
        csv=csv_files,
        draw=partial(draw, places=places, experiments=experiments, size=size),
        shown=_shown,
        device=device,
    )


def chosen_places(
    experiments: Sequence[int], *, seeds: int, seed: int, real: Path | None, quick: bool
) -> tuple[Place, ...]:
    """Every pair of scans that the experiments need, the simulated ones first."""
    size = QUICK if quick else FULL
    simulated = simulated_places(seed, seeds, angular_step=size.angular_step, beyond=size.beyond)
    scanned = () if real is None else real_places(real, seed)
    if quick:
        scanned = tuple({place.group.name: place for place in reversed(scanned)}.values())
    kinds = {setting.outdoor for number in experiments for setting in settings_of(number)}
    kinds |= {False} if 4 in experiments else set()
    return tuple(place for place in (*simulated, *scanned) if place.group.outdoor in kinds)


def _shown(rows: list[Row]) -> list[Table | str]:
    """The overview, what color changes, and what PCFH adds to the times."""
    tables = overview(rows) if errors_of(rows) else []
    return [*tables, *([added_in_words(times_of(rows))] if times_of(rows) else [])]
