"""Rivals: a second consensus is proposed, from matches that the first pose does not explain."""

from __future__ import annotations

from scenes import FURNISHED, SYMMETRIC, moved_pair

import torchreg as tr
from torchreg.geometry.se3 import apply_rotation
from torchreg.registration.describe import describe_clouds
from torchreg.registration.recipes import fused, recipes_of
from torchreg.registration.rivals import nearest_matches, rivals
from torchreg.solvers.batch import poses_of_pairs
from torchreg.verification import ProposedPoses


def first_and_rivals(shapes):
    """Described sides, the first proposal and its rivals, of one pair."""
    source, target, _ = moved_pair(shapes)
    options = tr.derive_options(source, target)[0]
    sides = [describe_clouds(cloud, options) for cloud in (source, target)]
    recipe = recipes_of(options, colored=False)[0]
    features = tuple(fused(side, recipe, options) for side in sides)
    matches = tr.match_mutual(*features)
    poses = poses_of_pairs(sides[0].cloud, sides[1].cloud, matches, [options.solver])
    first = ProposedPoses("first", matches, poses)
    near = nearest_matches(features, colored=False)
    return sides, first, rivals(sides[0].cloud, sides[1].cloud, near, first, [options], 0), options


def test_the_other_pose_of_a_symmetric_room_is_a_rival():
    _, first, others, _ = first_and_rivals(SYMMETRIC)
    R = others.poses[0].rotation[0] @ first.poses[0].rotation[0].T
    assert abs(float(R.trace()) + 1) < 0.01  # a half turn apart
    assert int(others.poses[0].support[0]) > 100


def test_rivals_rest_on_matches_that_the_first_pose_leaves():
    for shapes in (SYMMETRIC, FURNISHED):
        sides, first, others, options = first_and_rivals(shapes)
        pose = first.poses[0]
        p = sides[0].cloud.points[others.matches.source].double()
        q = sides[1].cloud.points[others.matches.target].double()
        apart = (apply_rotation(pose.rotation[0], p) + pose.translation[0] - q).norm(dim=1)
        assert float(apart.min()) > 2.9 * options.inlier_threshold


def test_a_room_like_no_other_has_no_rival_of_weight():
    _, first, others, _ = first_and_rivals(FURNISHED)
    shares = [int(part.poses[0].support[0]) / len(part.matches.source) for part in (first, others)]
    assert shares[1] < 0.2 * shares[0]
