"""``torchreg bench features``: someone's adapters on pairs of known truth, beside FPFH; what counts, by hand."""

import json

import pytest
import torch
from folders import block
from problems import random_transform, room_pair
from refusals import refuses

import torchreg as tr
from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.features.adapter import adapter_methods, loaded
from torchreg.benchmark.features.document import csv_text, tables
from torchreg.benchmark.features.protocol import Protocol, score
from torchreg.benchmark.features.study import features_study
from torchreg.benchmark.peers import METHODS
from torchreg.benchmark.peers.comparison import ComparisonOptions, MethodComparison
from torchreg.geometry.se3 import inverse

ADAPTERS = """
import torch
from torch import nn
import torchreg as tr


class Net(nn.Module):
    def forward(self, cloud):
        assert not torch.is_grad_enabled()
        near = tr.neighbors(cloud, 0.75, 100)
        return tr.fpfh(tr.estimate_normals(cloud, near.restrict(0.3, 30)), near).values.half()


def both(source, target):
    net = Net()
    return net(source), tr.KeypointFeatures(torch.arange(len(target.points)), net(target))


def matches(source, target, few=0):
    found = tr.match_mutual(*(
        tr.Features(f.float(), c.offsets, (("x", 33),), torch.ones(len(f), dtype=torch.bool))
        for f, c in zip((Net()(source), Net()(target)), (source, target))
    ))
    return torch.stack([found.source, found.target], dim=1)


def broken(cloud):
    raise RuntimeError("no weights")


def three(source, target, more):
    return None


number = 3
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The working directory, with adapters in a module of a name of its own."""
    monkeypatch.chdir(tmp_path)
    name = f"adapters_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(ADAPTERS)
    return name


@pytest.fixture
def data(tmp_path):
    """A list of one pair of rooms, averaged over 15 cm."""
    folder = tmp_path / "data"
    folder.mkdir()
    pair = room_pair(6000, seed=3)
    for name in ("source", "target"):
        tr.write_cloud(folder / f"{name}.ply", getattr(pair, name))
    entry = {"name": "room", "scene": "rooms", "source": "source.ply", "target": "target.ply", "voxel_m": 0.15}
    entry |= {"T": pair.T_target_source[0].tolist(), "overlap": 0.9}
    (folder / "pairs.json").write_text(json.dumps({"pairs": [entry]}))
    return folder


def test_adapters_of_every_kind_are_measured_beside_fpfh(here, data, tmp_path):
    names = [f"{here}:{name}" for name in ("Net", "both", "matches", "broken")]
    study = features_study(names, data, ComparisonOptions(methods=("fpfh",)))
    rows = {row["method"]: row for row in run_study(study, tmp_path / "out")}
    assert list(rows) == [
        *(f"{name}{words}" for name in names for words in ("/matches-alone", "")),
        "fpfh-features/matches-alone",
        "fpfh-features",
        "fpfh",
    ]
    for name in names[:3]:
        for words in ("/matches-alone", ""):
            row = rows[f"{name}{words}"]
            assert row["error"] == ""
            assert row["success"]
            assert row["rmse_m"] < 0.1
            assert row["matches"] == rows[names[0]]["matches"]
            assert row["inlier_ratio"] == pytest.approx(rows["fpfh-features"]["inlier_ratio"], abs=0.03)
    assert "no weights" in rows[names[3]]["error"]
    shown = study.shown(list(rows.values()))
    assert shown[-1] == f"{names[3]} ended with an error on 1 pairs, first: RuntimeError: no weights"
    document = (tmp_path / "out" / "features.md").read_text()
    assert "4 v" in document
    assert f"`{here}:both`, for both clouds of a pair" in document
    assert (tmp_path / "out" / "features.csv").read_text().startswith("group,method,measure,pairs,value,low,high")


def test_fragments_are_scored_by_the_protocol_of_3dmatch(here, tmp_path):
    scene = tmp_path / "scenes" / "room"
    scene.mkdir(parents=True)
    pair, generator = room_pair(5000, seed=3), torch.Generator().manual_seed(0)
    poses = [random_transform(generator) for _ in range(3)]
    for number, pose in enumerate(poses):
        R, t = pose[:3, :3], pose[:3, 3]
        points = pair.source.points.double() @ R.T + t
        tr.write_cloud(scene / f"cloud_bin_{number}.ply", tr.Clouds(points=points.float()))
    (scene / "gt.log").write_text(block(0, 2, 3, poses[0] @ inverse(poses[2])))
    study = features_study([f"{here}:Net"], scene, ComparisonOptions(methods=("fpfh",)), voxel=0.15)
    rows = run_study(study, tmp_path / "out")
    assert [row["method"] for row in rows][:2] == [f"{here}:Net/matches-alone", f"{here}:Net"]
    assert all(row["rmse_m"] < 0.2 for row in rows)
    assert "Registration recall" in (tmp_path / "out" / "features.md").read_text()


def row(pair, method="a", **more):
    usual = {"scene": "s", "overlap": 0.7, "voxel_m": 0.025, "rmse_m": 0.05, "inlier_ratio": 0.3, "matches": 100}
    usual |= {"seconds": 1.0, "success": True, "error": ""}
    return {"pair": pair, "method": method, **usual, **more}


ROWS = [
    row("1"),
    row("2", rmse_m=0.15, matches=300),  # recalled in meters, not by voxels of 2.5 cm
    row("3", rmse_m=0.25, inlier_ratio=0.05, success=False),
    row("4", rmse_m=None, inlier_ratio=None, matches=None, success=False, error="x"),
    row("5", success=False, inlier_ratio=0.06, matches=200),
]


def test_counts_are_those_by_hand():
    meters, voxels = score(ROWS, Protocol(in_meters=True)), score(ROWS, Protocol(in_meters=False))
    assert (meters.recall.value, voxels.recall.value) == (0.6, 0.4)
    assert meters.match_recall.value == 0.75  # 0.05 is not above 5 %
    assert meters.inlier_ratio.value == pytest.approx((0.3 + 0.3 + 0.05 + 0.06) / 4)
    assert meters.matches == 150
    assert (meters.successes, meters.wrong_called_right, meters.right_refused, meters.errors) == (2, 0, 1, 1)
    assert (voxels.wrong_called_right, voxels.right_refused) == (1, 1)
    assert (Protocol(in_meters=True).near(0.025), Protocol(in_meters=False).near(0.025)) == (0.1, 0.05)


def test_the_bound_in_meters_is_that_of_3dmatch():
    protocol = Protocol(in_meters=True)
    assert [protocol.recalled(row("1", rmse_m=error)) for error in (0.19, 0.2, 0.21)] == [True, False, False]


def test_tables_have_every_group_and_an_empty_row_for_what_did_not_run():
    method, other = METHODS["fpfh"], METHODS["default"]
    comparison = MethodComparison([row("1", "fpfh"), row("2", "fpfh", overlap=0.4)], [method, other], {})
    made = tables(comparison, Protocol(in_meters=False))
    assert [table.heading for table in made] == [
        "All pairs",
        "Registration recall",
        "Feature-match recall",
        "Inlier ratio",
    ]
    assert made[0].rows[1][1] == "not run"
    assert made[1].head[1:] == ["all pairs (2)", "s (2)", "overlap 0.6 and more (1)", "overlap 0.35 to 0.6 (1)"]
    lines = csv_text(comparison, Protocol(in_meters=False)).splitlines()
    assert "all pairs,fpfh,recall,2,1.0,1.0,1.0" in lines


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("no_colon", ("adapter", "module:callable")),
        ("no_such_module_anywhere:f", ("adapter", "no_such_module_anywhere")),
        ("{here}:nothing", ("adapter", "nothing")),
        ("{here}:number", ("adapter", "callable", "int")),
        ("{here}:three", ("adapter", "one cloud", "of 3")),
    ],
)
def test_adapters_that_do_not_fit_are_refused_by_name(here, name, parts):
    with refuses(*parts):
        adapter_methods(name.format(here=here))


def test_the_same_adapter_twice_and_a_log_beside_a_list_are_refused(here, data, tmp_path):
    with refuses("adapter", "at most once"):
        features_study([f"{here}:Net", f"{here}:Net"], data, ComparisonOptions())
    with refuses("--log", "list of pairs"):
        features_study([], data, ComparisonOptions(), log=tmp_path)
    assert isinstance(loaded(f"{here}:Net"), torch.nn.Module)
