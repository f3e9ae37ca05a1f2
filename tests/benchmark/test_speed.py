"""The speed benchmark: what it times is what it says, growth by known laws, resumed and refused as it should."""

import json
import time

import psutil
import pytest
from real_folders import project
from refusals import refuses
from typer.testing import CliRunner

from torchreg.benchmark.core.timing import interleaved
from torchreg.benchmark.speed import batches, busy, large
from torchreg.benchmark.speed import study as studies
from torchreg.benchmark.speed.document import growth_table, series, slope, times_table
from torchreg.benchmark.speed.grid import HYPOTHESES, SLOTS, STAGES, cells
from torchreg.benchmark.speed.scene import Scenes
from torchreg.benchmark.speed.side_by_side import of_part, table_of_part
from torchreg.benchmark.speed.subjects import CLASSIC, COMPILED, METHODS, OURS, TENSOR
from torchreg.cli.app import app


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0, 0.5])
def test_the_slope_of_a_power_law_is_its_exponent(power):
    sizes = [10, 100, 1000, 5000]
    assert slope(sizes, [3 * size**power for size in sizes]) == pytest.approx(power)


def test_a_slope_needs_two_sizes():
    with refuses("sizes", "two different"):
        slope([10, 10], [1, 2])


def test_every_function_runs_once_to_warm_up_and_then_in_turn():
    calls = []
    found = interleaved({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 3)
    assert calls == ["a", "b"] + ["a", "b"] * 3
    assert [len(seconds) for seconds in found.values()] == [3, 3]


def test_what_takes_longer_than_the_patience_is_timed_once():
    calls = []
    found = interleaved({"slow": lambda: calls.append(1)}, 5, patience=0.0)
    assert len(calls) == len(found["slow"]) == 1


def test_the_grid_holds_every_stage_at_every_size_and_keys_are_unique():
    listed = list(cells((1000, 10_000)))
    assert len({cell.key for cell in listed}) == len(listed)
    for name in STAGES:
        assert {cell.points for cell in listed if cell.subject == name} == {1000, 10_000}
    assert {cell.neighbors for cell in listed if cell.subject == "FPFH + PCFH"} == set(SLOTS)
    assert {cell.hypotheses for cell in listed if cell.subject == "RANSAC"} == set(HYPOTHESES)


@pytest.fixture(scope="module")
def scenes():
    return Scenes()


@pytest.mark.parametrize("name", list(STAGES))
def test_every_method_of_a_stage_runs(scenes, name):
    runs = STAGES[name](scenes.scene(300, 20))
    assert set(runs) <= set(METHODS)
    assert OURS in runs
    assert {CLASSIC, TENSOR} & set(runs)
    for method, run in runs.items():
        if method != COMPILED:
            run()


def row(subject, points, seconds, **sizes):
    return {"key": f"{subject} {points} {sizes}", "subject": subject, "points": points, "neighbors": 100,
            "hypotheses": 0, "seconds": seconds, **sizes}  # fmt: skip


def test_tables_tell_ratios_and_growth():
    rows = [
        row("FPFH", points, {OURS: [points * 1e-6], COMPILED: [points * 5e-7], CLASSIC: [points * 4e-6]})
        for points in (1000, 10_000, 100_000)
    ]
    assert "4.0 / 8.0" in times_table(rows)
    (line,) = [line for line in growth_table(rows).splitlines() if line.startswith("| FPFH")]
    assert line.count("1.00") == 4  # three exponents, and a flat cost per point
    assert series(rows)[0][:2] == ("FPFH", "points")


def test_the_command_writes_its_folder_and_goes_on(tmp_path, monkeypatch):
    asked = list(cells((300,)))[:2]
    monkeypatch.setattr(studies.batches, "cells", lambda *_, **__: [])
    monkeypatch.setattr(studies.large, "cells", lambda *_, **__: [])
    monkeypatch.setattr(studies, "cells", lambda *_: iter(asked))
    out = tmp_path / "speed"
    words = ["bench", "speed", "--quick", "--out", str(out)]
    first = CliRunner().invoke(app, words)
    assert first.exit_code == 0, first.output
    content = json.loads((out / "speed.json").read_text())
    assert [one["subject"] for one in content["rows"]] == [cell.subject for cell in asked]
    assert (out / "speed.png").stat().st_size > 5000
    text = (out / "speed.md").read_text()
    assert "neighbor search" in text
    assert "](speed.png)" in text
    monkeypatch.setattr(studies, "interleaved", lambda *_, **__: pytest.fail("measured again"))
    assert CliRunner().invoke(app, words).exit_code == 0


@pytest.mark.parametrize("points", ["ten", "1000,,2000", "5"])
def test_points_that_are_no_counts_are_refused(tmp_path, points):
    result = CliRunner().invoke(app, ["bench", "speed", "--out", str(tmp_path / "x"), "--points", points])
    assert result.exit_code == 2
    assert "--points" in result.output


def test_a_table_compares_with_the_first_way():
    rows = [{"key": "a", "part": "batches", "case": "4 pairs", "seconds": {"loop": [4.0], "one call": [1.0]}}]
    (*_, last) = table_of_part(rows, "batches").splitlines()
    assert last.startswith("| 4 pairs | one call |")
    assert "| 4.0 |" in last
    assert table_of_part(rows, "large") == ""


def test_rows_without_a_part_are_those_of_stages():
    rows = [row("FPFH", 10, {OURS: [1.0]}), {"key": "b", "part": "large", "case": "x", "seconds": {"a": [1.0]}}]
    assert of_part(rows, "stages") == rows[:1]
    assert of_part(rows, "large") == rows[1:]


def test_one_core_is_busy_within_the_context_alone():
    me = psutil.Process()
    before = me.children()
    with busy.busy_core():
        (child,) = set(me.children()) - set(before)
        time.sleep(0.2)
        assert child.cpu_times().user > 0
    assert not child.is_running()


def test_the_core_is_free_again_after_an_error():
    before = psutil.Process().children()
    with pytest.raises(KeyError), busy.busy_core():
        raise KeyError
    assert set(psutil.Process().children()) <= set(before)


def test_quiet_and_busy_are_compared_pair_by_pair():
    seconds = {"quiet": {"default": [1.0], "open3d-600k": [4.0]}, "busy": {"default": [3.0], "open3d-600k": [6.0]}}
    rows = [{"key": name, "part": "busy", "case": name, "seconds": seconds} for name in "ab"]
    line = next(line for line in busy.table(rows).splitlines() if "default" in line)
    assert [cell.strip() for cell in line.split("|")[-4:-1]] == ["3.00", "4.00", "2.00"]
    assert busy.table([]) == ""


@pytest.mark.slow
def test_batches_and_large_things_are_measured():
    for cell in (*batches.cells(1, quick=True), *large.cells(1, quick=True)):
        found = cell.measure()
        assert all(min(seconds) > 0 for seconds in found["seconds"].values()), cell.key


def test_real_pairs_are_measured_quiet_and_busy(tmp_path, monkeypatch):
    monkeypatch.setattr(busy, "_COMPARED", ("fast",))
    (cell,) = busy.cells(project(tmp_path), 1, quick=True)
    assert {state: list(found) for state, found in cell.measure()["seconds"].items()} == {
        "quiet": ["fast"],
        "busy": ["fast"],
    }
