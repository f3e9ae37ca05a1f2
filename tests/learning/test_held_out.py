"""Features judged by their mutual matches: perfect ones, blind ones, and means by group."""

import pytest
import torch
from problems import room_pair

import torchreg as tr
from torchreg.learning.held_out import MatchQuality, baselines, by_group, match_quality, network_features
from torchreg.learning.network_training import drawn_network
from torchreg.learning.posed_pairs import PosedPair
from torchreg.types import Features


@pytest.fixture(scope="module")
def pair():
    room = room_pair(4000, seed=1)
    scans = tr.datasets.ScanPair(room.source, room.target, room.T_target_source[0], "room")
    return PosedPair(scans, "rooms", 0.15)


def of_values(values, cloud):
    return Features(values, cloud.offsets, (("any", values.shape[1]),), torch.ones(len(values), dtype=torch.bool))


def test_the_true_place_is_a_perfect_feature_and_noise_is_none(pair):
    T = pair.pair.T_target_source.float()

    def place(side, voxel):
        """Coordinates in the frame of the target: its own, or the source's moved."""
        points = side.cloud.points
        mine = torch.equal(side.cloud.viewpoint, pair.pair.source.viewpoint)
        return of_values(points @ T[:3, :3].t() + T[:3, 3] if mine else points, side.cloud)

    def noise(side, voxel):
        count = len(side.cloud.points)
        return of_values(torch.rand(count, 8, generator=torch.Generator().manual_seed(count)), side.cloud)

    perfect, blind = match_quality({"place": place, "noise": noise}, [pair])
    assert perfect.inlier_ratio > 0.95
    assert perfect.matches > 100
    assert blind.inlier_ratio < 0.1
    for one in (perfect, blind):
        assert one.inliers == round(one.inlier_ratio * one.matches)
        assert (one.pair, one.group) == ("room", "rooms")


def test_what_ships_finds_right_matches_and_color_helps_on_a_colored_room(pair):
    ratio = {one.features: one.inlier_ratio for one in match_quality(baselines(), [pair])}
    assert list(ratio) == ["fpfh", "default", "LEARNED"]
    assert ratio["default"] > ratio["fpfh"] > 0.02


def test_the_default_beside_registers_what_it_says(pair):
    """The features judged here are those that registration compares."""
    from torchreg.learning.posed_pairs import whole_view

    view = whole_view(pair)
    options = tr.options_for(pair.voxel, colored=True, effort="plain")
    result = tr.register(view.source.cloud, view.target.cloud, options)
    quality = next(one for one in match_quality(baselines(), [pair]) if one.features == "default")
    assert len(result.correspondences.source) == quality.matches


def test_clouds_without_color_are_judged_by_geometry(pair):
    from dataclasses import replace

    bare = [replace(cloud, colors=None) for cloud in (pair.pair.source, pair.pair.target)]
    plain = replace(pair, pair=replace(pair.pair, source=bare[0], target=bare[1]))
    methods = {**baselines(), **network_features(drawn_network(0))}
    found = {one.features: one for one in match_quality(methods, [plain])}
    assert found["default"].matches == found["fpfh"].matches
    assert list(found) == ["fpfh", "default", "LEARNED", "network", "default + network"]


def test_means_by_group_and_over_all():
    rows = [
        MatchQuality("f", "1", "a", 100, 50, 0.5),
        MatchQuality("f", "2", "a", 100, 4, 0.04),
        MatchQuality("f", "3", "b", 0, 0, 0.0),
        MatchQuality("g", "3", "b", 10, 10, 1.0),
    ]
    found = {(row.group, row.features): row for row in by_group(rows)}
    assert list(found) == [("a", "f"), ("b", "f"), ("b", "g"), ("all", "f"), ("all", "g")]
    a = found["a", "f"]
    assert (a.pairs, a.inliers, a.feature_match_recall) == (2, 27.0, 0.5)
    assert a.inlier_ratio == pytest.approx(0.27)
    assert found["all", "f"].inlier_ratio == pytest.approx(0.18)
    assert found["all", "g"].feature_match_recall == 1.0
