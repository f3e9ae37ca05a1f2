"""Features and transforms from elsewhere on the real pairs: found as often, and judged as honestly, as promised."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from problems import turned

import torchreg as tr
from torchreg.benchmark.core.real_pairs import read_real_pairs
from torchreg.geometry.se3 import compose

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"

pytestmark = [
    pytest.mark.real,
    pytest.mark.slow,
    pytest.mark.skipif(not REAL.exists(), reason="the real pairs are not there: shared/data/real"),
]


def pairs():
    """Every real pair, its clouds averaged over its voxels, and the options of the benchmarks."""
    for pair in read_real_pairs(REAL):
        source, target = (tr.voxel_downsample(tr.read_cloud(file), pair.voxel) for file in (pair.source, pair.target))
        colored = source.colors is not None and target.colors is not None
        yield pair, source, target, tr.options_for(pair.voxel, colored=colored)


def fpfh(cloud, voxel):
    near = tr.neighbors(cloud, 5 * voxel, 100)
    return tr.fpfh(tr.estimate_normals(cloud, near.restrict(2 * voxel, 30)), near).values


def right(pair, T):
    rre, rte = tr.metrics.rre(pair.T_target_source, T), tr.metrics.rte(pair.T_target_source, T)
    return bool(rre < 15) and bool(rte < 6 * pair.voxel)


def test_fpfh_as_plain_tensors_finds_most_pairs_and_is_no_less_honest_than_register():
    found, wrong = 0, {"features": 0, "register": 0}
    for pair, source, target, options in pairs():
        f, g = fpfh(source, pair.voxel), fpfh(target, pair.voxel)
        results = {
            "features": tr.register_features(source, target, f, g, options),
            "register": tr.register(source, target, options),
        }
        found += right(pair, results["features"].T_target_source[0])
        for name, result in results.items():
            wrong[name] += bool(result.success[0]) and not right(pair, result.T_target_source[0])
    assert found >= 31
    assert wrong["features"] <= wrong["register"]


def test_true_transforms_are_accepted_and_those_far_off_are_refused():
    accepted = {"true": 0, "turned": 0, "shifted": 0}
    stated = {name: [] for name in accepted}
    generator = torch.Generator().manual_seed(0)
    for pair, source, target, options in pairs():
        axis, way = torch.nn.functional.normalize(torch.randn(2, 3, dtype=torch.float64, generator=generator), dim=1)
        middle = target.points.double().mean(dim=0) + target.origin[0]
        turn = turned(20.0, axis.tolist())
        turn[:3, 3] = middle - turn[:3, :3] @ middle
        shift = turned(0.0, translation=(10 * pair.voxel * way).tolist())
        for name, move in (("true", torch.eye(4, dtype=torch.float64)), ("turned", turn), ("shifted", shift)):
            result = tr.verify(source, target, compose(move, pair.T_target_source), options)
            accepted[name] += bool(result.success[0])
            stated[name].append(float(result.probability[0]))
    assert accepted["true"] >= 33
    assert accepted["turned"] == accepted["shifted"] == 0
    assert sum(stated["true"]) / len(stated["true"]) > 0.8
    assert max(stated["turned"] + stated["shifted"]) < 0.1
