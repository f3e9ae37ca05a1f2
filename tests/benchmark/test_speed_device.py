"""The study of a GPU, on the CPU: what does not fit is skipped and says so, peers that fail do not stop it."""

import json
from dataclasses import replace

import pytest
import torch
from problems import room_pair
from typer.testing import CliRunner

from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.speed import device as studies
from torchreg.benchmark.speed.device import Budget, DeviceRun, device_study
from torchreg.benchmark.speed.device_peers import PEERS
from torchreg.benchmark.speed.device_scene import filled
from torchreg.benchmark.speed.device_stages import OURS, STAGES, DeviceStage
from torchreg.cli.app import app

CPU = torch.device("cpu")
QUICK = DeviceRun(device=CPU, repeats=1, seconds=100.0, quick=True)


@pytest.fixture
def few(monkeypatch):
    """Two stages, no batches."""
    chosen = {name: STAGES[name] for name in ("downsample", "neighbor search")}
    monkeypatch.setattr(studies, "STAGES", chosen)
    monkeypatch.setattr(studies, "QUICK_PAIRS", ())
    monkeypatch.setattr(studies, "QUICK_POINTS", (100, 300))
    return chosen


def rows_of(folder):
    return {row["key"]: row for row in json.loads((folder / "speed_device.json").read_text())["rows"]}


def test_a_budget_refuses_what_would_take_too_long():
    budget = Budget(100.0)
    assert budget.refusal("stage", 10, 2.0) == ""
    budget.note("stage", 10, 0.1)
    assert budget.refusal("stage", 100, 1.0) == ""
    assert budget.refusal("stage", 1000, 2.0) == "would take about 1000 s"
    assert budget.refusal("another", 1000, 2.0) == ""
    budget.note("stage", 1000, float("inf"))
    assert budget.refusal("stage", 10_000, 1.0) == "a smaller size did not fit"
    assert Budget(0.0).refusal("stage", 10, 1.0) == "the time is over"


def test_every_stage_of_a_peer_is_one_of_ours():
    for peer in PEERS:
        assert set(peer.stages) <= set(STAGES)


@pytest.mark.slow
@pytest.mark.parametrize("name", STAGES)
def test_every_stage_and_its_peers_run(name):
    scene = studies.device_scene(300, CPU)
    STAGES[name].build(scene)()
    for peer in PEERS:
        if name in peer.stages and not peer.gap(CPU):
            peer.stages[name](scene)()


def test_the_study_writes_times_and_peers(few, tmp_path):
    run_study(device_study((), QUICK), tmp_path)
    rows = rows_of(tmp_path)
    assert list(rows) == [f"{name}, {points} points" for points in (100, 300) for name in few]
    assert all(set(row["seconds"]) == {OURS, "Open3D, tensor"} for row in rows.values())
    text = (tmp_path / "speed_device.md").read_text()
    assert "| neighbor search | 300 |" in text
    assert "Not measured" not in text


def test_what_does_not_fit_is_skipped_and_larger_sizes_too(few, tmp_path, monkeypatch):
    def full(scene):
        raise torch.OutOfMemoryError("out of memory: tried to allocate 1 TiB")

    monkeypatch.setitem(few, "neighbor search", DeviceStage(build=full))
    run_study(device_study((), QUICK), tmp_path)
    skipped = {key: row["skipped"] for key, row in rows_of(tmp_path).items() if "skipped" in row}
    assert skipped == {
        "neighbor search, 100 points": "does not fit the memory: out of memory: tried to allocate 1 TiB",
        "neighbor search, 300 points": "a smaller size did not fit",
    }
    assert "- neighbor search, 300 points: a smaller size did not fit" in (tmp_path / "speed_device.md").read_text()


def test_a_peer_that_fails_is_named_and_ours_measured(few, tmp_path, monkeypatch):
    def broken(scene):
        def run():
            raise RuntimeError("no kernel image")

        return run

    monkeypatch.setattr(studies, "PEERS", (replace(PEERS[0], name="another", stages={"downsample": broken}),))
    run_study(device_study((), QUICK), tmp_path)
    row = rows_of(tmp_path)["downsample, 300 points"]
    assert row["failed"] == {"another": "RuntimeError: no kernel image"}
    assert list(row["seconds"]) == [OURS]


def test_a_run_without_time_writes_its_tables(few, tmp_path):
    run_study(device_study((), replace(QUICK, seconds=0.0)), tmp_path)
    assert {row["skipped"] for row in rows_of(tmp_path).values()} == {"the time is over"}


def test_more_points_than_a_scan_has_lie_between_its_points():
    cloud = room_pair(400).source
    many = filled(cloud, 3000, 0)
    assert len(many.points) == 3000
    assert bool((many.points.amin(dim=0) >= cloud.points.amin(dim=0)).all())
    assert bool((many.points.amax(dim=0) <= cloud.points.amax(dim=0)).all())
    assert len(many.points.unique(dim=0)) > 2000
    assert len(filled(cloud, 100, 0).points) == 100


@pytest.mark.parametrize(("words", "named"), [(["--seconds", "5"], "--seconds"), (["--device", "cuda"], "--device")])
def test_what_only_a_gpu_takes_is_refused_without(tmp_path, monkeypatch, words, named):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    result = CliRunner().invoke(app, ["bench", "speed", "--out", str(tmp_path / "x"), *words])
    assert result.exit_code == 2
    assert named in result.output
