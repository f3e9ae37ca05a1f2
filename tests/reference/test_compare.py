"""The comparison says what is there: agreement, differences, errors against the truth, and failures."""

import json
import math
from dataclasses import replace
from importlib import import_module

import pytest
import torch
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.native import native_kernels
from torchreg.reference import compare
from torchreg.reference.comparison import shared
from torchreg.registration import options_for

PAIR = room_pair(3000, seed=1)
OPTIONS = replace(options_for(0.2), solver="ransac", effort="plain")


@pytest.fixture(scope="module")
def comparison():
    return compare(PAIR.source, PAIR.target, OPTIONS, truth=PAIR.T_target_source[0])


def test_both_register_the_pair(comparison):
    for side in (comparison.torchreg, comparison.open3d):
        assert side.success
        assert side.truth.rre_degrees < 5
        assert side.truth.rte_meters < 0.4
        assert side.truth.rmse_meters < 0.4
        assert 0.5 < side.fitness <= 1
        assert 0 < side.inlier_rmse < OPTIONS.ransac.inlier_threshold
        stages = ["neighbors and normals", "descriptors", "matching", "hypotheses"]
        assert [name for name in side.seconds if name != "decision"] == stages
        assert side.total_seconds == pytest.approx(sum(side.seconds.values()))


def test_numbers_are_those_of_the_runs(comparison):
    clouds = PAIR.source, PAIR.target
    ours = tr.register(*clouds, replace(OPTIONS, refine="none"))
    assert torch.equal(comparison.torchreg.T_target_source, ours.T_target_source[0])
    assert comparison.torchreg.matches == len(ours.correspondences.source)
    assert comparison.torchreg.inliers == int(ours.inliers.sum())
    assert comparison.torchreg.fitness == pytest.approx(float(ours.fitness[0]), abs=1e-3)
    rmse = tr.metrics.rmse(PAIR.T_target_source[0], ours.T_target_source[0], PAIR.source.points)
    assert comparison.torchreg.truth.rmse_meters == pytest.approx(float(rmse))


def test_the_same_features_give_the_same_matches(comparison):
    assert comparison.shared_matches == comparison.torchreg.matches == comparison.open3d.matches


def test_descriptors_agree(comparison):
    assert [(one.cloud, one.dtype) for one in comparison.descriptors] == [
        ("source", "float64"),
        ("source", "float32"),
        ("target", "float64"),
        ("target", "float32"),
    ]
    assert comparison.descriptors_agree
    assert all(one.share_off < 0.01 and one.largest < 20 for one in comparison.descriptors)
    assert [one.rows for one in comparison.descriptors[::2]] == list(comparison.points)


def test_each_with_its_own_fpfh(comparison):
    found = compare(PAIR.source, PAIR.target, OPTIONS, features="fpfh")
    assert found.options.color == ()
    assert found.torchreg.truth is None
    # Open3D matches rows that sum to 600, torchreg rows of unit length
    assert 0.5 * found.torchreg.matches < found.shared_matches < found.torchreg.matches


def test_plain_numbers_survive_json(comparison):
    found = json.loads(json.dumps(comparison.to_dict(), allow_nan=False))
    assert found["descriptors_agree"] is True
    assert found["matches"]["shared"] == comparison.shared_matches
    assert torch.tensor(found["open3d"]["T_target_source"]).shape == (4, 4)
    assert found["torchreg"]["truth"]["rre_degrees"] == comparison.torchreg.truth.rre_degrees
    assert found["options"]["solver"]["inlier_threshold"] == OPTIONS.inlier_threshold
    strange = replace(comparison, torchreg=replace(comparison.torchreg, fitness=math.nan))
    assert strange.to_dict()["torchreg"]["fitness"] is None


def test_wrong_descriptors_do_not_agree(monkeypatch):
    module = import_module("torchreg.descriptors.fpfh")
    right = module.unit_bins
    monkeypatch.setattr(module, "unit_bins", lambda value: right(value + 1e-3))
    with native_kernels(False):  # which use no bins of torch
        found = compare(PAIR.source, PAIR.target, OPTIONS)
    assert not found.descriptors_agree
    assert all(one.off_without_tie > 0 and not one.agree and one.share_off > 0.1 for one in found.descriptors)


def test_descriptors_that_are_not_numbers_do_not_agree(monkeypatch):
    module = import_module("torchreg.reference.descriptors")
    right = module.fpfh

    def broken(cloud, near):
        features = right(cloud, near)
        return replace(features, values=torch.full_like(features.values, math.nan))

    monkeypatch.setattr(module, "fpfh", broken)
    found = compare(PAIR.source, PAIR.target, OPTIONS)
    assert not found.descriptors_agree
    assert found.descriptors[0].off_without_tie == found.points[0]
    assert found.to_dict()["descriptors"][0]["largest"] is None


def test_voxels_are_those_of_torchreg():
    options = replace(OPTIONS, voxel_size=0.25)
    found = compare(PAIR.source, PAIR.target, options)
    thinned = [len(tr.voxel_downsample(cloud, 0.25).points) for cloud in (PAIR.source, PAIR.target)]
    assert list(found.points) == thinned
    assert found.options == replace(options, refine="none")  # the plain procedure
    assert found.shared_matches == found.torchreg.matches


@pytest.mark.parametrize("voxel_size", [None, 1e4])
def test_a_cloud_that_cannot_be_described_is_a_failure(voxel_size):
    few = tr.Clouds(points=torch.rand(3 if voxel_size is None else 300, 3), viewpoint=torch.zeros(1, 3))
    target = tr.Clouds(points=PAIR.target.points, viewpoint=PAIR.target.viewpoint)
    options = replace(OPTIONS, voxel_size=voxel_size)
    found = compare(few, target, options, truth=PAIR.T_target_source[0])
    assert found.descriptors == ()
    assert not found.descriptors_agree
    for side in (found.torchreg, found.open3d):
        assert not side.success
        assert "too few points" in side.reason
        assert (side.fitness, side.inlier_rmse, side.truth) == (None, None, None)
    json.dumps(found.to_dict(), allow_nan=False)


def test_shared_matches_are_counted_by_both_rows():
    def matches(*pairs):
        source, target = torch.tensor(pairs).t()
        return tr.Correspondences(source, target, torch.tensor([0, len(pairs)]), torch.zeros(len(pairs)))

    assert shared(matches((0, 1), (1, 2), (2, 3)), matches((0, 1), (1, 3), (2, 2), (2, 3))) == 2


def test_what_does_not_fit_is_refused():
    both = tr.Clouds.pack([PAIR.source, PAIR.source])
    with refuses("source", "one cloud", "2 clouds"):
        compare(both, PAIR.target)
    with refuses("target", "one cloud", "2 clouds"):
        compare(PAIR.source, both)
    with refuses("features", "'fused'", "'color'"):
        compare(PAIR.source, PAIR.target, features="color")
    with refuses("truth", "(4, 4)", "(1, 4, 4)"):
        compare(PAIR.source, PAIR.target, truth=PAIR.T_target_source)
