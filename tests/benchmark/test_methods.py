"""Every method under the one contract: it finds an easy pair, wherever its clouds lie, and says when it cannot run."""

import importlib.util
from dataclasses import replace

import pytest
import torch
from made_up_methods import absent
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.benchmark.peers import METHODS, NOT_HERE, Task, chosen_methods
from torchreg.benchmark.peers.judge import judged
from torchreg.geometry.se3 import inverse, rigid

VOXEL = 0.12


@pytest.fixture(scope="module")
def room():
    pair = room_pair(12_000, seed=1)
    source, target = (tr.voxel_downsample(cloud, VOXEL) for cloud in (pair.source, pair.target))
    return source, target, pair.T_target_source[0]


def needs(name):
    module = METHODS[name].module
    absent = bool(module) and importlib.util.find_spec(module) is None
    return pytest.param(name, marks=pytest.mark.skipif(absent, reason=f"{METHODS[name].package} is not installed"))


QUICK = [name for name, method in METHODS.items() if not method.slow and name != "thorough"]


@pytest.mark.parametrize("name", [needs(name) for name in QUICK])
def test_finds_a_room_far_from_the_origin(room, name):
    source, target, T = room
    far = torch.tensor([[3e3, -2e3, 50.0]], dtype=torch.float64)
    there = rigid(torch.eye(3, dtype=torch.float64), far[0])
    moved = replace(source, origin=source.origin + far)
    answer = METHODS[name].run(Task(source=moved, target=target, voxel=VOXEL))
    assert answer.T_target_source.shape == (4, 4)
    assert answer.T_target_source.dtype == torch.float64
    assert answer.success
    near = answer.T_target_source @ there
    assert float(tr.metrics.rre(T, near)) < 6
    assert float(tr.metrics.rte(T, near)) < 2 * VOXEL
    if name == "open3d-fgr":
        assert answer.matches is None
        return
    found, other, matches = answer.matches
    ratio = tr.metrics.inlier_ratio(found, other, matches, (T @ inverse(there))[None], 2 * VOXEL)
    assert float(ratio) > 0.03  # by chance it would be some 0.001


@pytest.mark.parametrize("name", [needs(name) for name in ("open3d-100k", "kiss-matcher", "magsac", "fpfh")])
def test_next_to_nothing_to_match_is_a_pair_not_found(name):
    cloud = tr.Clouds(points=torch.rand(12, 3, generator=torch.Generator().manual_seed(0)))
    few = cloud.rows(torch.arange(5), torch.tensor([0, 5]))
    found = judged(METHODS[name], Task(source=cloud, target=few, voxel=0.1), torch.eye(4, dtype=torch.float64), 0.2)
    assert not found["success"]
    assert "Import" not in found["error"]


def test_a_missing_package_is_named():
    method = absent("peer")
    gap = method.gap()
    assert "no-such-package" in gap
    assert "torchreg-pointcloud[bench]" in gap
    assert method.version() == "unknown"
    assert METHODS["default"].gap() == ""


def test_every_method_says_how_it_is_run():
    for name, method in METHODS.items():
        assert method.name == name
        assert method.statement.endswith(".")
        drawn = any(word in method.statement for word in ("hypotheses", "graph"))
        assert drawn, name
    assert len({method.title for method in METHODS.values()}) == len(METHODS)
    assert all(why.endswith(".") for why in NOT_HERE.values())


def test_methods_by_name():
    assert [method.name for method in chosen_methods(["fast", "open3d-100k"])] == ["open3d-100k", "fast"]
    assert len(chosen_methods(None)) == len(METHODS)
    assert {method.name for method in chosen_methods(None, quick=True)} == {
        name for name, method in METHODS.items() if not method.slow
    }
    with refuses("methods", "kiss-matcher", "'best'"):
        chosen_methods(["best"])
    with refuses("methods", "at least one"):
        chosen_methods([])


def test_open3d_draws_as_many_hypotheses_as_it_says(room, monkeypatch):
    source, target, _ = room
    asked = []
    real = tr.reference.open3d.register

    def listening(one, other, options, **more):
        asked.append((options.ransac.hypotheses, options.ransac.confidence, options.ransac.inlier_threshold))
        return real(one, other, replace(options, ransac=replace(options.ransac, hypotheses=50)), **more)

    monkeypatch.setattr(tr.reference.open3d, "register", listening)
    for name in ("open3d-100k", "open3d-600k", "open3d-600k-all"):
        METHODS[name].run(Task(source=source, target=target, voxel=VOXEL))
    limit = pytest.approx(1.5 * VOXEL)
    assert asked == [(100_000, 0.999, limit), (600_000, 0.999, limit), (600_000, 1.0, limit)]
