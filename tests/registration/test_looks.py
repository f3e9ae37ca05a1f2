"""A second look: it finds what the first does not, only where it is needed, and its matches are rows of the pair."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import room_pair, turned
from scenes import FURNISHED, OTHER_ROOM, SPACING, Box, boxes, moved_pair

import torchreg as tr
from torchreg.geometry.se3 import inverse
from torchreg.registration.describe import describe_clouds
from torchreg.registration.looks import second_look

BODY: tuple[Box, ...] = (
    ((0.0, 0.0, 0.0), (4.0, 2.0, 1.0)),
    ((1.2, 0.4, 1.0), (1.4, 1.0, 1.6)),
    ((-1.3, -0.9, 0.2), (1.0, 1.6, 0.7)),
    ((-0.9, 0.8, 0.9), (0.6, 0.7, 0.9)),
)
"""A closed body whose middle is the zero of its frame."""


def body_and_view() -> tuple[tr.Clouds, tr.Clouds, torch.Tensor]:
    """One view of a closed body, and all of it: zeros taken for scanners stand outside the one, inside the other."""
    g = torch.Generator().manual_seed(0)
    points = boxes(BODY, g, spacing=0.06)
    eye = torch.tensor([9.0, 7.0, 6.0])
    whole = tr.voxel_downsample(tr.Clouds(points=points), SPACING)
    near = tr.neighbors(whole, 0.3, 20)
    outwards = tr.estimate_normals(whole, near).normals  # towards the middle
    seen = ((eye - whole.points) * -outwards).sum(dim=1) > 0
    rows = seen.nonzero()[:, 0]
    view = whole.rows(rows, torch.tensor([0, len(rows)]))
    T = turned(50.0, translation=(6.0, 5.0, 4.0))
    guess = {"viewpoint": torch.zeros(1, 3), "viewpoint_assumed": torch.ones(1, dtype=torch.bool)}
    jitter = 0.01 * torch.randn(view.points.shape, generator=g)
    moved = tr.transform(tr.Clouds(points=view.points + jitter), inverse(T))
    source = tr.Clouds(points=moved.points, origin=moved.origin, **guess)
    return source, tr.Clouds(points=whole.points, **guess), T


def test_a_view_of_a_closed_body_is_found_though_both_zeros_mislead():
    source, target, T = body_and_view()
    result = tr.register(source, target)
    assert result.success.tolist() == [True], result.reason
    assert float(tr.metrics.rre(T[None], result.T_target_source)) < 3
    assert any("only assumed" in note for note in result.notes[0])


def test_each_sign_along_surfaces_is_tried_where_no_scanner_is_known():
    source, target, T = body_and_view()
    options = tr.derive_options(source, target)[0]
    seen = second_look(*(describe_clouds(cloud, options) for cloud in (source, target)), options, 0)
    found = {}
    for part in seen:
        R = part.poses[0].rotation
        found[part.origin] = bool((tr.metrics.rre(T, turns_alone(R)) < 10).any()) if len(R) > 0 else False
    assert any("signs along surfaces" in origin and right for origin, right in found.items())
    assert any("opposite signs" in origin for origin in found)
    known = [tr.Clouds(points=cloud.points, viewpoint=cloud.viewpoint) for cloud in (source, target)]
    seen = second_look(*(describe_clouds(cloud, options) for cloud in known), options, 0)
    assert not any("signs" in part.origin for part in seen)


def turns_alone(rotation):
    """(H, 4, 4) with these rotations (H, 3, 3) and no translation."""
    T = torch.eye(4, dtype=torch.float64).repeat(len(rotation), 1, 1)
    T[:, :3, :3] = rotation
    return T


def proposals(source, target, effort):
    result = tr.register(source, target, effort=effort)
    return [proposal.origin for proposal in result.stages[0].proposals]


def test_only_pairs_in_doubt_are_looked_at_again():
    source, target, _ = moved_pair(FURNISHED)
    assert len(proposals(source, target, "fast")) == 1
    assert len(proposals(source, target, "balanced")) == 2  # and the rivals
    strange = moved_pair(FURNISHED, OTHER_ROOM)[:2]
    assert len(proposals(*strange, "fast")) == 1
    assert len(proposals(*strange, "balanced")) > 5


@pytest.mark.slow
def test_thorough_always_looks_again():
    source, target, _ = moved_pair(FURNISHED)
    assert any("times as far apart" in origin for origin in proposals(source, target, "thorough"))


def test_matches_are_rows_of_the_clouds_that_were_described():
    source, target, _ = moved_pair(FURNISHED)
    options = tr.derive_options(source, target)[0]
    sides = [describe_clouds(cloud, options) for cloud in (source, target)]
    seen = second_look(*sides, options, 0)
    assert {part.coarser for part in seen} == {1.0, 2.0}
    for part in seen:
        for rows, side in ((part.matches.source, sides[0]), (part.matches.target, sides[1])):
            assert bool(((rows >= 0) & (rows < len(side.cloud.points))).all())
        inliers = part.poses[0].inliers[0]
        p = side_points(sides[0], part.matches.source[inliers])
        q = side_points(sides[1], part.matches.target[inliers])
        moved = p @ part.poses[0].rotation[0].T + part.poses[0].translation[0]
        # a coarse point's nearest fine one is less than a coarse spacing away
        assert float((moved - q).norm(dim=1).max()) < part.coarser * options.inlier_threshold + 4 * SPACING


def side_points(side, rows):
    return side.cloud.points[rows].double()


def test_pairs_in_doubt_do_not_see_each_other():
    pairs = [moved_pair(FURNISHED, OTHER_ROOM, seed) for seed in range(2)] + [moved_pair(FURNISHED)]
    source, target = (tr.Clouds.pack([pair[side] for pair in pairs]) for side in range(2))
    together = tr.register(source, target)
    for b, (one, other, _) in enumerate(pairs):
        alone = tr.register(one, other)
        assert same_bits(together.T_target_source[b], alone.T_target_source[0])
        assert same_bits(together.probability[b], alone.probability[0])
        assert together.stages[b] == alone.stages[0]


def test_descriptors_of_both_clouds_alone_leave_no_second_look():
    source, target, _ = moved_pair(FURNISHED, OTHER_ROOM)
    gray = [replace(cloud, colors=torch.full_like(cloud.points, 0.5)) for cloud in (source, target)]
    joint = tr.Pcfh(radius=0.5, equalization="joint")
    options = replace(tr.derive_options(*gray)[0], descriptors=(joint,), weights=(1.0,))
    result = tr.register(*gray, options)
    assert result.success.tolist() == [False]
    assert not any("times as" in proposal.origin for proposal in result.stages[0].proposals)


def test_what_was_proposed_before_is_not_proposed_again():
    source, target, _ = moved_pair(FURNISHED)
    options = tr.derive_options(source, target)[0]
    sides = [describe_clouds(cloud, options) for cloud in (source, target)]
    every = [part.origin for part in second_look(*sides, options, 0)]
    assert len(set(every)) == len(every)
    assert [part.origin for part in second_look(*sides, options, 0, every[1:])] == every[:1]
    assert second_look(*sides, options, 0, every) == []


def test_a_cloud_too_wide_for_voxels_is_not_looked_at_more_coarsely():
    pair = room_pair(900)
    options = tr.derive_options(pair.source, pair.target)[0]
    wide = replace(pair.source, points=torch.cat([pair.source.points[1:], torch.full((1, 3), 1e7)]))
    sides = [describe_clouds(cloud, options) for cloud in (wide, pair.target)]
    assert {part.coarser for part in second_look(*sides, options, 0)} == {1.0}
