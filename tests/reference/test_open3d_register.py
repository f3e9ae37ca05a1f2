"""The pipeline by Open3D: right on easy pairs, origins included, and its failures are data."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from problems import room_pair, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.open3d_loader import load_open3d
from torchreg.reference import open3d
from torchreg.reference.pair import PairOutcome, _match
from torchreg.registration import options_for

PAIR = room_pair(4000, seed=1)
OPTIONS = options_for(0.17)


@pytest.mark.parametrize("features", ["fpfh", "fused"])
def test_a_room_is_registered(features):
    result = open3d.register(PAIR.source, PAIR.target, OPTIONS, features=features)
    assert result.success.tolist() == [True]
    assert tr.metrics.rre(PAIR.T_target_source, result.T_target_source) < 5
    assert tr.metrics.rte(PAIR.T_target_source, result.T_target_source) < 0.4
    assert result.options == (OPTIONS,)
    assert [name for name, _ in result.seconds] == [
        *("downsample", "neighbors and normals", "descriptors", "matching", "hypotheses")
    ]
    assert all(seconds >= 0 for _, seconds in result.seconds)
    fit = open3d.evaluate(PAIR.source, PAIR.target, result.T_target_source, OPTIONS.ransac.inlier_threshold)
    assert torch.allclose(result.fitness, fit.fitness)
    assert torch.allclose(result.inlier_rmse, fit.inlier_rmse)
    assert 10 < int(result.inliers.sum()) <= len(result.correspondences.source)
    assert "by Open3D" in result.notes[0][0]


def test_fused_features_give_the_matches_of_torchreg():
    clouds = [tr.voxel_downsample(cloud, 0.15) for cloud in (PAIR.source, PAIR.target)]
    ours = tr.register(*clouds, OPTIONS).correspondences
    theirs = open3d.register(*clouds, OPTIONS, features="fused").correspondences
    assert torch.equal(ours.source, theirs.source)
    assert torch.equal(ours.target, theirs.target)
    assert torch.allclose(ours.score.double(), theirs.score, atol=1e-5)


def test_fpfh_has_its_own_support_whatever_other_descriptors_have():
    alone = replace(OPTIONS, descriptors=(tr.Fpfh(radius=0.8, max_neighbors=30),), weights=(1.0,))
    others = (tr.Contrast(radius=1.5, max_neighbors=100), *alone.descriptors)
    results = [
        open3d.register(PAIR.source, PAIR.target, options)
        for options in (alone, replace(alone, descriptors=others, weights=(1.0, 1.0)))
    ]
    assert torch.equal(results[0].correspondences.score, results[1].correspondences.score)


def test_options_are_derived_as_torchreg_derives_them():
    result = open3d.register(PAIR.source, PAIR.target)
    assert result.options == tr.derive_options(PAIR.source, PAIR.target)


def test_voxels_and_unknown_viewpoints_are_noted():
    source = tr.Clouds(points=PAIR.source.points, colors=PAIR.source.colors)
    result = open3d.register(source, PAIR.target, replace(OPTIONS, voxel_size=0.2))
    said = " / ".join(result.notes[0])
    assert "voxels of 0.2 m" in said
    assert "no viewpoint for the source" in said
    assert int(result.correspondences.source.max()) < len(tr.voxel_downsample(source, 0.2).points)


def test_origins_are_part_of_the_transform():
    origin = torch.tensor([[512345.0, 5234567.0, 431.0]], dtype=torch.float64)
    near = open3d.register(PAIR.source, PAIR.target, OPTIONS, features="fused")
    far_source, far_target = replace(PAIR.source, origin=origin), replace(PAIR.target, origin=-origin)
    far = open3d.register(far_source, far_target, OPTIONS, features="fused")
    truth = PAIR.T_target_source.clone()
    truth[:, :3, 3] += -origin[0] - truth[0, :3, :3] @ origin[0]
    points = far_source.points.double() + origin
    assert tr.metrics.rmse(truth, far.T_target_source, points) < 0.3
    assert torch.allclose(near.fitness, far.fitness, atol=0.1)


def test_a_batch_holds_each_pair_and_the_failed_one_its_reason():
    lonely = tr.Clouds(points=torch.rand(3, 3), colors=torch.rand(3, 3), viewpoint=torch.zeros(1, 3))
    other = room_pair(3000, seed=5)
    source = tr.Clouds.pack([PAIR.source, lonely, other.source])
    target = tr.Clouds.pack([PAIR.target, PAIR.target, other.target])
    result = open3d.register(source, target, OPTIONS, features="fused")
    assert result.success.tolist() == [True, False, True]
    assert "too few points" in result.reason[1]
    assert torch.equal(result.T_target_source[1], torch.eye(4, dtype=torch.float64))
    assert result.fitness[1] == 0
    matches = result.correspondences
    begin, end = matches.offsets.tolist()[2:]
    assert matches.offsets[1] == matches.offsets[2]
    assert int(matches.source[begin:end].min()) >= int(source.offsets[2])
    assert int(matches.target[begin:end].min()) >= int(target.offsets[2])
    R, t = result.T_target_source[2, :3, :3], result.T_target_source[2, :3, 3]
    apart = source.points[matches.source[begin:end]].double() @ R.t() + t - target.points[matches.target[begin:end]]
    inside = apart.norm(dim=1) < OPTIONS.ransac.inlier_threshold
    assert torch.equal(inside, result.inliers[begin:end])


def test_no_hypothesis_is_a_reason():
    hopeless = replace(OPTIONS, solver=tr.RansacOptions(inlier_threshold=1e-9, hypotheses=500))
    result = open3d.register(PAIR.source, PAIR.target, hopeless)
    assert not result.success[0]
    assert "no hypothesis left" in result.reason[0]
    assert torch.equal(result.T_target_source[0], torch.eye(4, dtype=torch.float64))


def test_too_few_matches_are_a_reason():
    greedy = replace(OPTIONS, solver=tr.RansacOptions(inlier_threshold=OPTIONS.inlier_threshold, sample_size=5000))
    result = open3d.register(PAIR.source, PAIR.target, greedy)
    assert not result.success[0]
    assert "too few matches" in result.reason[0]


def features_of(values, valid=None):
    valid = torch.ones(len(values), dtype=torch.bool) if valid is None else valid
    return tr.Features(values, torch.tensor([0, len(values)]), (("f", values.shape[1]),), valid)


def matched(source, target, *, everything):
    cloud = tr.Clouds(points=torch.zeros(0, 3))
    outcome = PairOutcome(cloud, cloud)
    _match(outcome, source, target, everything=everything)
    return outcome


@pytest.mark.parametrize("mutual", [3, 9, 10, 30])
def test_few_mutual_matches_fall_back_to_one_way_as_in_open3d(mutual):
    # 100 source points, of which all but a few have one and the same nearest target
    line = torch.arange(100, dtype=torch.float64)
    source = features_of(torch.where(line < mutual, 10 * line, 1000 + line)[:, None])
    target = features_of(torch.cat([10 * line[: mutual - 1], torch.tensor([10 * (mutual - 1.0)])])[:, None])
    outcome = matched(source, target, everything=True)
    pairs = outcome.matches
    o3d = load_open3d()
    made = []
    for features in (source, target):
        made.append(o3d.pipelines.registration.Feature())
        made[-1].data = features.values.t().numpy()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        expected = np.asarray(o3d.pipelines.registration.correspondences_from_features(*made, mutual_filter=True))
    np.testing.assert_array_equal(pairs.numpy(), expected)
    assert (len(pairs) == 100) == (mutual < 10) == bool(outcome.notes)


def test_rows_that_are_not_valid_are_left_out_of_fused_features():
    values = torch.tensor([[0.0], [1.0], [2.0], [3.0]])
    valid = torch.tensor([False, True, True, True])
    chosen = matched(features_of(values, valid), features_of(values, ~valid.flip(0) | valid), everything=False)
    assert chosen.matches.tolist() == [[1, 1], [2, 2], [3, 3]]
    assert len(matched(features_of(values, valid), features_of(values, valid), everything=True).matches) == 4
    nothing = matched(features_of(values, ~valid & valid), features_of(values), everything=False)
    assert nothing.matches.shape == (0, 2)


def test_what_does_not_fit_is_refused():
    cloud = sphere_cloud(50)
    with refuses("target", "1 clouds", "2"):
        open3d.register(cloud, tr.Clouds.pack([cloud, cloud]))
    with refuses("features", "'fpfh', 'fused'", "'shot'"):
        open3d.register(cloud, cloud, features="shot")
    with refuses("options", "1", "2"):
        open3d.register(cloud, cloud, [OPTIONS, OPTIONS])


def test_open3d_is_imported_when_it_is_called():
    code = "import sys, torchreg; torchreg.reference.open3d.register; sys.exit('open3d' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
