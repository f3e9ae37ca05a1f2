"""The protocol of 3DMatch on a made-up folder in its layout: what counts, where the bound lies, means over scenes."""

import csv
import json

import pytest
import torch
from folders import block
from made_up_methods import absent, install, posing, raising
from problems import random_transform
from refusals import refuses

import torchreg as tr
from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.peers.comparison import ComparisonOptions
from torchreg.benchmark.threedmatch.protocol import counts, mean_score, pooled_recall, recalled, score
from torchreg.benchmark.threedmatch.study import fragments_study
from torchreg.geometry.se3 import inverse, rigid
from torchreg.metrics import information_of_matches

SPACING = 0.06


def world(seed):
    """Points of two walls and a floor, 3 m wide."""
    g = torch.Generator().manual_seed(seed)
    points = 3 * torch.rand(1500, 3, generator=g, dtype=torch.float64)
    rows = torch.arange(1500)
    points[rows, rows % 3] = 0
    return points


def write_scene(scene, pairs, *, seed=0, name="cloud_bin_{}.ply", info=True, logs=None):
    """Fragments that all see the same points, each in a frame of its own, so that every point has a true partner."""
    scene.mkdir(parents=True)
    logs = scene if logs is None else logs
    logs.mkdir(parents=True, exist_ok=True)
    count = 1 + max(max(pair) for pair in pairs)
    g = torch.Generator().manual_seed(seed + 1)
    poses = [random_transform(g) for _ in range(count)]
    clouds = [tr.transform(tr.Clouds(points=world(seed)), pose) for pose in poses]
    for k, cloud in enumerate(clouds):
        tr.write_cloud(scene / name.format(k), cloud)
    truths = {(i, j): poses[i] @ inverse(poses[j]) for i, j in pairs}
    (logs / "gt.log").write_text("".join(block(i, j, count, T) for (i, j), T in truths.items()))
    if info:
        text = [block(i, j, count, information_of_matches(clouds[j].points)) for i, j in pairs]
        (logs / "gt.info").write_text("".join(text))
    return truths


def knowing(name, folder, error, log=None):
    """A method that answers the truth of a pair, off by what ``error(scene, i, j)`` says in meters."""
    dataset = tr.datasets.Fragments(folder, log=log)
    answers = []
    for k in range(len(dataset)):
        pair, (i, j) = dataset[k], dataset.numbers[k]
        source = tr.voxel_downsample(pair.source, SPACING)
        off = torch.tensor([0.0, error(dataset.scenes[k], i, j), 0.0], dtype=torch.float64)
        shift = rigid(torch.eye(3, dtype=torch.float64), off)
        answers.append((source.points, source.origin, pair.target, pair.T_target_source @ shift))

    def pose(task):
        for points, origin, target, T in answers:
            known = torch.equal(points, task.source.points) and torch.equal(origin, task.source.origin)
            if known and torch.equal(tr.voxel_downsample(target, SPACING).points, task.target.points):
                return T
        return torch.eye(4, dtype=torch.float64)  # the warm-up

    return posing(name, pose)


def result(folder, out, **more):
    """The rows, and the first table (registration recall)."""
    study = fragments_study(folder, voxel=SPACING, **more)
    rows = run_study(study, out)
    return rows, study.shown(rows)[0]


def scores(table, method):
    """Cells of one method's row by the head of a table."""
    (cells,) = [row for row in table.rows if row[0] == f"the {method}"]
    return dict(zip(table.head, cells, strict=True))


PAIRS = ((0, 1), (0, 2), (0, 3), (1, 3), (1, 2))  # three that count, two that follow one another


@pytest.fixture
def folder(tmp_path):
    data = tmp_path / "data"
    write_scene(data / "7-scenes-redkitchen", PAIRS, logs=data / "7-scenes-redkitchen-evaluation")
    write_scene(data / "other", ((0, 2),), seed=5)
    return data


def test_the_truth_is_recalled_exactly(tmp_path, folder, monkeypatch):
    install(monkeypatch, knowing("truth", folder, lambda *_: 0.0), absent("gone"), raising("bad"))
    rows, table = result(folder, tmp_path / "out")
    found = scores(table, "truth")
    assert found == {
        "method": "the truth",
        "Kitchen (3)": "1.000",
        "other (1)": "1.000",
        "mean": "1.000",
        "all pairs alike": "1.000 [1.000, 1.000]",
    }
    rows = [row for row in rows if row["method"] == "truth"]
    assert all(row["information_rmse_m"] < 1e-6 and row["rmse_m"] < 1e-6 for row in rows)
    assert scores(table, "bad")["mean"] == "0.000"
    assert scores(table, "gone")["Kitchen (3)"] == "not installed"
    assert "- the gone: no-such-package" in (tmp_path / "out" / "3dmatch.md").read_text()


@pytest.mark.parametrize(("meters", "recall"), [(0.199, "1.000"), (0.201, "0.000")])
def test_the_bound_is_twenty_centimeters(tmp_path, folder, monkeypatch, meters, recall):
    install(monkeypatch, knowing("off", folder, lambda *_: meters))
    rows, table = result(folder, tmp_path / "out")
    assert scores(table, "off")["mean"] == recall
    assert all(row["information_rmse_m"] == pytest.approx(meters, abs=1e-6) for row in rows)
    assert all(row["rmse_m"] == pytest.approx(meters, abs=1e-6) for row in rows)


def test_fragments_that_follow_one_another_do_not_count(tmp_path, folder, monkeypatch):
    install(monkeypatch, knowing("a", folder, lambda _, i, j: 9.0 if j == i + 1 else 0.0))
    assert scores(result(folder, tmp_path / "out")[1], "a")["mean"] == "1.000"


def test_scenes_count_alike_in_the_mean_and_pairs_alike_beside_it(tmp_path, folder, monkeypatch):
    install(monkeypatch, knowing("a", folder, lambda scene, i, j: 9.0 if (scene, i, j) == ("other", 0, 2) else 0.0))
    found = scores(result(folder, tmp_path / "out")[1], "a")
    assert (found["Kitchen (3)"], found["other (1)"], found["mean"]) == ("1.000", "0.000", "0.500")
    assert found["all pairs alike"].startswith("0.750 [")
    lines = csv.DictReader((tmp_path / "out" / "3dmatch.csv").read_text().splitlines())
    assert {line["scene"]: float(line["value"]) for line in lines if line["measure"] == "recall"} == {
        "7-scenes-redkitchen": 1.0,
        "other": 0.0,
        "mean": 0.5,
    }


def test_another_log_and_scenes_of_the_eth(tmp_path, monkeypatch):
    data, logs = tmp_path / "data", tmp_path / "low"
    write_scene(data / "gazebo_summer", ((0, 2), (1, 3)), name="Hokuyo_{}.ply", info=False, logs=logs / "gazebo_summer")
    install(monkeypatch, knowing("a", data, lambda _, i, j: 0.1 + 0.2 * i, logs))
    rows, table = result(data, tmp_path / "out", log=logs)
    assert scores(table, "a")["gazebo_summer (2)"] == "0.500"
    assert all(row["information_rmse_m"] is None for row in rows)
    assert "no information matrix" in (tmp_path / "out" / "3dmatch.md").read_text()


def test_a_second_run_measures_nothing_again(tmp_path, folder, monkeypatch):
    install(monkeypatch, knowing("a", folder, lambda *_: 0.0))
    result(folder, tmp_path / "out")
    first = json.loads((tmp_path / "out" / "3dmatch.json").read_text())["rows"]
    install(monkeypatch, raising("a"))
    assert result(folder, tmp_path / "out")[0] == first
    with refuses("--out", "voxel 0.1"):
        run_study(fragments_study(folder, voxel=0.1), tmp_path / "out")


def test_scenes_and_quick_runs(folder):
    def names(scenes=None, quick=False):
        study = fragments_study(folder, ComparisonOptions(methods=("fast",), scenes=scenes, quick=quick))
        return [cell.key.removesuffix("/fast") for cell in study.cells]

    assert len(names()) == 6
    assert names(quick=True) == ["7-scenes-redkitchen__cloud_bin_2__cloud_bin_0", "other__cloud_bin_2__cloud_bin_0"]
    assert names(("other",)) == ["other__cloud_bin_2__cloud_bin_0"]
    with refuses("scenes", "'attic'"):
        names(("attic",))
    with refuses("scenes", "at least one"):
        names(())


def test_counts_by_hand():
    usual = {"i": 0, "j": 2, "rmse_m": 9.0, "information_rmse_m": 0.2, "rre_deg": 2.0, "rte_m": 0.1, "seconds": 1.0}
    usual["inlier_ratio"] = 0.06
    rows = [
        usual,
        {**usual, "information_rmse_m": 0.21, "rre_deg": 90.0, "inlier_ratio": 0.05},
        {**usual, "j": 1, "information_rmse_m": 0.0, "rre_deg": 0.0, "inlier_ratio": None, "seconds": 4.0},
    ]
    assert [counts(row) for row in rows] == [True, True, False]
    assert [recalled(row) for row in rows] == [True, False, True]
    assert recalled({**usual, "information_rmse_m": None}) is False
    assert recalled({**usual, "information_rmse_m": None, "rmse_m": None}) is False
    found = score(rows)
    assert (found.recall, found.match_recall, found.rre_deg, found.seconds) == (0.5, 0.5, 2.0, 2.0)
    assert found.inlier_ratio == pytest.approx(0.055)
    alone = score(rows[2:])
    assert (alone.recall, alone.inlier_ratio, alone.rre_deg) == (None, None, None)
    mean = mean_score([found, alone])
    assert (mean.recall, mean.seconds) == (0.5, 3.0)
    assert pooled_recall(rows).value == 0.5
    assert pooled_recall(rows[2:]) is None
