"""What ``torchreg bench field`` counts, by hand; missing peers named; cut-off runs that go on."""

import csv
import json
from pathlib import Path

import pytest
import torch
from made_up_methods import absent, install, posing, raising
from real_folders import project
from refusals import refuses

import torchreg as tr
from torchreg.benchmark.core.real_pairs import read_real_pairs
from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.field.document import csv_text, tables
from torchreg.benchmark.field.study import field_study
from torchreg.benchmark.field.summary import difference, groups, summarize
from torchreg.benchmark.peers.comparison import ComparisonOptions, MethodComparison
from torchreg.geometry.se3 import rigid

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"


def row(pair, method="a", **more):
    """A row found by both criteria, unless told otherwise; v = 5 cm."""
    usual = {"scene": "s", "overlap": 0.7, "voxel_m": 0.05, "rre_deg": 1.0, "rte_m": 0.1, "rmse_m": 0.1}
    usual |= {"inlier_ratio": 0.3, "seconds": 1.0, "success": True, "error": ""}
    return {"pair": pair, "method": method, **usual, **more}


ROWS = [
    row("1"),
    row("2", rte_m=0.31, overlap=0.5, scene="t"),  # lost by its translation, not by RMSE
    row("3", rre_deg=15.1, rmse_m=0.21, inlier_ratio=0.04, success=False, overlap=0.34, scene="t"),
    row("4", rmse_m=None, rre_deg=3.0, success=False, inlier_ratio=None, error="x", seconds=9.0, scene="t"),
]


def test_counts_are_those_by_hand():
    cell = summarize(ROWS)
    assert (cell.pairs, cell.recall.value, cell.recall_rmse.value) == (4, 0.5, 0.5)
    assert cell.match_recall.value == pytest.approx(2 / 3)
    assert cell.inlier_ratio.value == pytest.approx((0.3 + 0.3 + 0.04) / 3)
    assert (cell.rre_deg.value, cell.rte_m.value, cell.seconds.value) == (2.0, 0.1, 1.0)
    assert (cell.wrong_called_right, cell.right_refused, cell.errors) == (1, 1, 1)
    assert cell.recall.low < 0.5 < cell.recall.high


def test_bounds_follow_the_voxels():
    far = summarize([row("1", voxel_m=0.3, rte_m=1.7, rmse_m=1.1)])
    assert (far.recall.value, far.recall_rmse.value) == (1, 1)
    assert summarize([row("1", voxel_m=0.05, rte_m=1.7, rmse_m=1.1)]).recall.value == 0


def test_pairs_by_scene_and_by_overlap():
    sizes = {name: sum(map(belongs, ROWS)) for name, belongs in groups(ROWS)}
    overlaps = {"overlap 0.6 and more": 2, "overlap 0.35 to 0.6": 1, "overlap below 0.35": 1}
    assert sizes == {"all pairs": 4, "s": 1, "t": 3, **overlaps}


def test_differences_are_taken_pair_by_pair():
    other = [row(pair, "b", rte_m=0.1 if pair != "1" else 9.0) for pair in "1234"]
    found = difference(ROWS, other)
    assert found.value == pytest.approx((1 - 1 - 1 + 0) / 4)
    assert difference(ROWS, [row("9")]) is None


@pytest.fixture
def data(tmp_path):
    (tmp_path / "data").mkdir()
    return project(tmp_path / "data")


def knowing(name, data, seen, meters=0.0, fails=()):
    """A method that knows the truth of a list's pairs by the number of their points, and notes what it was asked."""
    truths = {}
    for pair in read_real_pairs(data):
        clouds = [tr.voxel_downsample(tr.read_cloud(file), pair.voxel) for file in (pair.source, pair.target)]
        truths[tuple(len(cloud.points) for cloud in clouds)] = pair

    def pose(task):
        pair = truths.get((len(task.source.points), len(task.target.points)))
        if pair is None:  # the warm-up
            return torch.eye(4, dtype=torch.float64)
        seen.append((name, pair.name))
        if pair.name in fails:
            raise KeyboardInterrupt
        shift = torch.tensor([meters, 0.0, 0.0], dtype=torch.float64)
        return pair.T_target_source @ rigid(torch.eye(3, dtype=torch.float64), shift)

    return posing(name, pose)


def test_the_whole_run(tmp_path, data, monkeypatch):
    seen = []
    install(monkeypatch, knowing("right", data, seen), knowing("near", data, seen, 1.0), raising("bad"), absent("gone"))
    reported = []
    study = field_study(data)
    rows = run_study(study, tmp_path / "out", reported.append)
    assert len(seen) == 6
    assert len(rows) == 9
    assert any("the gone is left out" in line and "no-such-package" in line for line in reported)
    overall = {cells[0]: cells[1:] for cells in study.shown(rows)[0].rows}
    assert overall["the right"][:3] == ["3", "1.00", "1.00"]
    assert overall["the near"][:3] == ["3", "1.00", "0.00"]  # 5 v: within 6 v by errors, beyond 4 v by RMSE
    assert overall["the bad"][-1] == "3"
    assert overall["the gone"][:2] == ["not installed", "-"]
    text = (tmp_path / "out" / "field.md").read_text()
    assert "- the gone: no-such-package cannot be imported" in text
    assert "TEASER++" in text
    assert "Made up: near." in text
    whole = json.loads((tmp_path / "out" / "field.json").read_text())
    assert whole["gaps"].keys() == {"gone"}
    assert whole["run"]["seed"] == 0
    lines = list(csv.DictReader((tmp_path / "out" / "field.csv").read_text().splitlines()))
    (recall,) = [
        line for line in lines if (line["group"], line["method"], line["measure"]) == ("hall", "right", "recall")
    ]
    assert (float(recall["value"]), recall["pairs"]) == (1.0, "2")


def test_a_cut_off_run_goes_on_where_it_stopped(tmp_path, data, monkeypatch):
    seen = []
    install(monkeypatch, knowing("a", data, seen), knowing("b", data, seen, fails=("pair_1",)))
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        run_study(field_study(data), out)
    with (out / "rows.jsonl").open("a") as file:
        file.write('{"key": "half a li')  # what a killed process leaves
    before, seen[:] = list(seen), []
    install(monkeypatch, knowing("a", data, seen), knowing("b", data, seen))
    assert len(run_study(field_study(data), out)) == 6
    assert before[:-1] == [("a", "pair_0"), ("b", "pair_0"), ("a", "pair_1")]
    assert seen == [("b", "pair_1"), ("a", "pair_2"), ("b", "pair_2")]
    seen.clear()
    again = run_study(field_study(data, ComparisonOptions(methods=("a",))), out)
    assert (seen, len(again)) == ([], 3)
    with refuses("--out", "seed 1"):
        run_study(field_study(data, ComparisonOptions(seed=1)), out)


def test_scenes_and_quick_runs(data):
    def names(scenes=None, quick=False):
        study = field_study(data, ComparisonOptions(methods=("fast",), scenes=scenes, quick=quick))
        return [cell.key.removesuffix("/fast") for cell in study.cells]

    assert names() == ["pair_0", "pair_1", "pair_2"]
    assert names(quick=True) == ["pair_0", "pair_2"]
    assert names(("yard",)) == ["pair_2"]
    with refuses("scenes", "hall, yard", "'attic'"):
        names(("attic",))
    with refuses("scenes", "at least one"):
        names(())


def test_the_same_rows_the_same_tables():
    methods = (posing("a", lambda _: torch.eye(4)),)
    one, other = (MethodComparison(ROWS, methods, {}, seed=seed) for seed in (0, 0))
    assert tables(one) == tables(other)
    assert csv_text(one) == csv_text(other)


@pytest.mark.real
def test_a_pair_of_real_scans(tmp_path):
    if not REAL.is_dir():
        pytest.skip(f"the real pairs are not there: {REAL}")
    names = ("open3d-100k", "fast")
    study = field_study(REAL, ComparisonOptions(scenes=("redkitchen",), methods=names, quick=True))
    rows = run_study(study, tmp_path / "out")
    assert {(row["method"], row["pair"]) for row in rows} == {(name, "redkitchen_19_05") for name in names}
    assert [cells[2:4] for cells in study.shown(rows)[0].rows] == [["1.00", "1.00"]] * 2
    assert all(row["inlier_ratio"] > 0.4 for row in rows)
