"""Evidence of the clouds: perfect for the right pose, the same from both sides, blind to the light."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import room_pair
from scenes import FURNISHED, moved_pair

import torchreg as tr
from torchreg.geometry.se3 import inverse
from torchreg.verification.evidence import evidence
from torchreg.verification.scans import prepared_scans

THRESHOLD, SPACING = 0.15, 0.1


def prepared(cloud):
    return tr.estimate_normals(cloud, tr.neighbors(cloud, 0.3, 30))


def weigh(source, target, *poses, features=((None, None), (None, None))):
    T = torch.stack(poses)
    limit = torch.tensor([THRESHOLD], dtype=torch.float64)
    one, other = (
        prepared_scans([cloud], [SPACING], limit, 1500, [rows])
        for cloud, rows in zip((source, target), features, strict=True)
    )
    return evidence(one, other, torch.zeros(len(T), dtype=torch.int64), T[:, :3, :3], T[:, :3, 3], limit)


@pytest.fixture(scope="module")
def room():
    source, target, T = moved_pair(FURNISHED)
    return source, target, T


def between_points(source, target, T):
    R = T[:3, :3]
    out = T.clone()
    out[:3, 3] = T[:3, 3] + R @ source.origin[0] - target.origin[0]
    return out


def test_the_right_pose_has_everything_for_it(room):
    source, target, T = room
    seen = weigh(prepared(source), prepared(target), between_points(source, target, T))
    assert float(seen.overlap) > 0.95
    assert float(seen.closeness) > 0.8
    assert float(seen.normals) > 0.9
    assert float(seen.conflict) < 0.01
    assert float(seen.misses) < 0.1
    assert bool(torch.isnan(seen.colors))
    assert bool(torch.isnan(seen.features))
    assert bool(torch.isnan(seen.color_features))


def test_a_wrong_pose_has_less(room):
    source, target, T = room
    right = between_points(source, target, T)
    wrong = right.clone()
    wrong[:3, 3] += torch.tensor([1.0, 0.6, 0.0], dtype=torch.float64)
    good, bad = (weigh(prepared(source), prepared(target), pose) for pose in (right, wrong))
    assert float(bad.overlap) < float(good.overlap) - 0.2
    assert float(bad.conflict) > float(good.conflict) + 0.05
    assert float(bad.misses) > float(good.misses) + 0.2


def test_both_sides_see_the_same():
    pair = room_pair(2500, seed=3)
    source, target = prepared(pair.source), prepared(pair.target)
    T = pair.T_target_source if pair.T_target_source.ndim == 2 else pair.T_target_source[0]
    one, other = weigh(source, target, T), weigh(target, source, inverse(T))
    for here, there in zip(one, other, strict=True):
        assert torch.allclose(here, there, atol=1e-5, equal_nan=True)


def test_brightness_and_contrast_of_a_channel_change_nothing():
    pair = room_pair(2500, seed=4)
    T = pair.T_target_source if pair.T_target_source.ndim == 2 else pair.T_target_source[0]
    source, target = prepared(pair.source), prepared(pair.target)
    light = torch.tensor([0.5, 0.8, 0.3]), torch.tensor([0.2, 0.05, 0.4])
    lit = replace(target, colors=target.colors * light[0] + light[1])
    bare, shone = weigh(source, target, T), weigh(source, lit, T)
    assert float(bare.colors) > 0.3
    assert float(shone.colors) == pytest.approx(float(bare.colors), abs=0.03)
    # and colors that have nothing to do with the place do not agree
    g = torch.Generator().manual_seed(0)
    mixed = replace(target, colors=target.colors[torch.randperm(len(target.colors), generator=g)])
    assert abs(float(weigh(source, mixed, T).colors)) < 0.15


def test_the_side_of_a_surface_counts_only_where_the_scanners_are_known():
    source, target, T = moved_pair(FURNISHED)
    T = between_points(source, target, T)
    one, other = prepared(source), prepared(target)
    turned = replace(other, normals=-other.normals)
    assert float(weigh(one, turned, T).normals) < -0.9
    unknown = replace(turned, viewpoint=None)
    assert float(weigh(one, unknown, T).normals) > 0.9


@pytest.mark.parametrize("sides", [(True, False), (False, True), (True, True)])
def test_an_assumed_viewpoint_is_no_more_evidence_than_none(sides):
    source, target, T = moved_pair(FURNISHED)
    T = between_points(source, target, T)
    T = torch.stack([T, T])
    T[1, 0, 3] += 0.8  # into free space that the scanners saw
    clouds = prepared(source), prepared(target)
    guess = torch.tensor([True])
    guessed = [replace(one, viewpoint_assumed=guess) if side else one for one, side in zip(clouds, sides, strict=True)]
    blind = [replace(one, viewpoint=None) if side else one for one, side in zip(clouds, sides, strict=True)]
    assert same_bits(weigh(*guessed, *T), weigh(*blind, *T))
    assert not same_bits(weigh(*guessed, *T), weigh(*clouds, *T))


def test_clouds_far_apart_have_nothing_in_common():
    source, target, _ = moved_pair(FURNISHED)
    one = prepared(source)
    away = torch.eye(4, dtype=torch.float64)
    away[:3, 3] = 1000.0
    seen = weigh(one, prepared(replace(target, viewpoint=None)), away)
    assert float(seen.overlap) == 0.0
    assert bool(torch.isnan(seen.normals))


def test_many_poses_are_weighed_as_each_alone(room):
    source, target, T = room
    T = between_points(source, target, T)
    poses = T.repeat(4, 1, 1)
    poses[:, 0, 3] += torch.linspace(0, 1, 4, dtype=torch.float64)
    one, other = prepared(source), prepared(target)
    together = weigh(one, other, *poses)
    for h in range(4):
        alone = weigh(one, other, poses[h])
        for joint, single in zip(together, alone, strict=True):
            assert torch.equal(joint[h : h + 1].nan_to_num(), single.nan_to_num())


def test_features_agree_where_partners_have_the_same():
    pair = room_pair(2500, seed=6)
    T = pair.T_target_source if pair.T_target_source.ndim == 2 else pair.T_target_source[0]
    source, target = prepared(pair.source), prepared(pair.target)
    moved = (source.points.double() @ T[:3, :3].T + T[:3, 3]).float()
    rows = [
        torch.sin(4 * places @ torch.randn(3, 6, generator=torch.Generator().manual_seed(2)))
        for places in (moved, target.points)
    ]
    strange = rows[1][torch.randperm(len(rows[1]), generator=torch.Generator().manual_seed(3))]
    same = weigh(source, target, T, features=((rows[0], rows[0][:, :2]), (rows[1], rows[1][:, :2])))
    other = weigh(source, target, T, features=((rows[0], None), (strange, None)))
    assert float(same.features) > 0.8
    assert float(same.color_features) > 0.8
    assert abs(float(other.features)) < 0.15
    assert bool(torch.isnan(other.color_features))


def test_features_that_are_all_alike_say_nothing():
    pair = room_pair(1500, seed=7)
    T = pair.T_target_source if pair.T_target_source.ndim == 2 else pair.T_target_source[0]
    flat = [(torch.ones(len(cloud.points), 5), None) for cloud in (pair.source, pair.target)]
    assert float(weigh(prepared(pair.source), prepared(pair.target), T, features=flat).features) == 0.0
