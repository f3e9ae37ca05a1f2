"""All pictures of a run, by file name: the paper's Figures 3 to 6 on our scans, and a chart for each experiment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import torch

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Picture
from torchreg.benchmark.paper.charts import errors_chart, times_chart
from torchreg.benchmark.paper.clouds_figure import Shown, clouds_figure
from torchreg.benchmark.paper.differences_chart import differences_chart
from torchreg.benchmark.paper.measure import key_of, trial
from torchreg.benchmark.paper.methods import METHODS
from torchreg.benchmark.paper.places import GROUPS, Place
from torchreg.benchmark.paper.settings import RunSize, settings_of
from torchreg.benchmark.paper.summary import differences_of, errors_of, times_of
from torchreg.benchmark.paper.ways import MAIN_WAYS, OURS
from torchreg.report import save_figure

FIGURES = {1: 3, 2: 4, 3: 5, 5: 6}
"""The paper's figure with the clouds of each experiment."""


def draw(
    rows: Sequence[Row], folder: Path, places: Sequence[Place], experiments: Sequence[int], size: RunSize
) -> Iterator[Picture]:
    """Draw and write everything that the rows allow; yields each picture.

    Clouds are drawn of the first place of each group that was scanned as in the paper.
    """
    first = {place.group.name: place for place in reversed(places) if place.group.paper}
    for experiment in experiments:
        if experiment == 4:
            if times_of(rows):
                save_figure(times_chart(times_of(rows)), folder / "chart_experiment4.png")
                yield Picture(4, "chart_experiment4.png", "Times of ours and of the paper over the number of points.")
            continue
        outdoor = settings_of(experiment)[0].outdoor
        for place in first.values():
            if place.group.outdoor == outdoor:
                yield _clouds(folder, rows, place, experiment, size)
        measured = {row["group"] for row in errors_of(rows) if row["experiment"] == experiment}
        panels = [(group, way) for group in GROUPS if group.name in measured and group.paper for way in MAIN_WAYS]
        name = f"chart_experiment{experiment}.png"
        save_figure(errors_chart(experiment, panels, errors_of(rows)), folder / name)
        yield Picture(experiment, name, "Errors at every place, their median, and the paper's numbers.")
    differences = differences_of(rows)
    if differences:
        groups = [group for group in GROUPS if group.paper and any(key.group == group.name for key in differences)]
        save_figure(differences_chart(groups, MAIN_WAYS, differences), folder / "differences.png")
        yield Picture(
            "overview",
            "differences.png",
            "What color changes, with 95 % intervals over the places; hollow: fewer than six.",
        )


def _clouds(folder: Path, rows: Sequence[Row], place: Place, experiment: int, size: RunSize) -> Picture:
    by_key = {row["key"]: row for row in rows}
    clouds = place.clouds()
    settings = []
    for setting in settings_of(experiment):
        one = trial(clouds, setting, place, size, torch.device("cpu"))
        of_methods = {name: by_key[key] for name in METHODS if (key := key_of(setting, place, OURS, name)) in by_key}
        counts = " and ".join(f"{len(cloud.points):,}" for cloud in (one.source, one.target))
        pose = f"initial pose {setting.name}\n" if experiment == 1 else ""
        settings.append(Shown(f"{pose}{counts} points", *one, of_methods))
    number = FIGURES[experiment]
    name = f"figure{number}_{place.group.name.replace(' ', '_')}.png"
    title = (
        f"As in the paper's Figure {number}: {place.name}, {place.group.title}; left as given, then under the pose of "
        f"each method ({OURS.name}, the first run), seen along z of the source, rooms cut open halfway; meters"
    )
    save_figure(clouds_figure(settings, title), folder / name)
    return Picture(experiment, name, f"{place.name}: the initial pose, and the pose that each method returned.")
