"""Features and matches from elsewhere: poses are judged as ``register`` judges, and rows stay those given."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import room_pair, seeded
from refusals import refuses
from scenes import FURNISHED, OTHER_ROOM, moved_pair

import torchreg as tr
from torchreg.registration.describe import describe_clouds
from torchreg.registration.recipes import fused, recipes_of

TIMES = ("seconds",)


def options_of(pair, effort="balanced"):
    spacing = float(tr.spacing(pair.source)[0])
    return replace(tr.options_for(spacing, effort=effort), voxel_size=None)


def described(cloud, options):
    """A cloud as ``register`` takes it, in Z order and without normals, and the features that it is matched by."""
    side = describe_clouds(cloud, options)
    return replace(side.cloud, normals=None), fused(side, recipes_of(options, colored=True)[0], options)


@pytest.fixture(scope="module")
def room():
    """A room: the pair, its options, both clouds in Z order and their features."""
    pair = room_pair(1800, seed=3)
    options = options_of(pair)
    return pair, options, *(described(cloud, options) for cloud in pair[:2])


def errors(pair, result):
    rre = float(tr.metrics.rre(pair.T_target_source[0], result.T_target_source[0]))
    return rre, float(tr.metrics.rte(pair.T_target_source[0], result.T_target_source[0]))


def assert_right(pair, result):
    assert result.success.tolist() == [True], result.reason
    rre, rte = errors(pair, result)
    assert rre < 2
    assert rte < 0.1


@pytest.mark.parametrize("effort", ["plain", "fast", "balanced"])
def test_with_the_librarys_own_features_the_result_is_that_of_register(room, effort):
    pair, _, (source, f), (target, g) = room
    options = options_of(pair, effort) if effort != "fast" else replace(room[1], effort="fast")
    result = tr.register_features(source, target, f, g, options)
    expected = tr.register(source, target, options)
    assert bool(expected.success[0])
    assert same_bits(result, expected, ignore=TIMES)


def test_a_batch_equals_the_loop_over_its_pairs():
    pairs = [room_pair(count, seed=seed) for count, seed in ((700, 3), (500, 5), (600, 8))]
    every = [options_of(pair) for pair in pairs]
    sides = [[described(pair[side], options) for pair, options in zip(pairs, every, strict=True)] for side in (0, 1)]
    alone = [
        tr.register_features(source, target, f.values, g.values, options)
        for (source, f), (target, g), options in zip(*sides, every, strict=True)
    ]
    source, target = (tr.Clouds.pack([cloud for cloud, _ in side]) for side in sides)
    f, g = (torch.cat([features.values for _, features in side]) for side in sides)
    for max_bytes in (None, 1):  # at once, and pair by pair
        together = tr.register_features(source, target, f, g, every, max_bytes=max_bytes)
        for b, one in enumerate(alone):
            assert same_bits(together.T_target_source[b : b + 1], one.T_target_source)
            assert same_bits(together.probability[b : b + 1], one.probability)
            assert together.reason[b] == one.reason[0]
        expected = torch.cat([one.correspondences.score for one in alone])
        assert same_bits(together.correspondences.score, expected)
        apart = source.points[together.correspondences.source]
        assert same_bits(apart, torch.cat([one.source.points[one.correspondences.source] for one in alone]))


def test_features_permuted_with_their_points_give_the_same(room):
    _, options, (source, f), (target, g) = room
    order = torch.randperm(len(source.points), generator=seeded(1))
    mixed = source.rows(order, source.offsets)
    expected = tr.register_features(source, target, f.values, g.values, options)
    result = tr.register_features(mixed, target, f.values[order], g.values, options)
    assert same_bits(result.T_target_source, expected.T_target_source)
    assert same_bits(result.probability, expected.probability)
    assert same_bits(result.source.points, mixed.points)  # in the order given
    assert same_bits(order[result.correspondences.source], expected.correspondences.source)
    assert same_bits(result.inliers, expected.inliers)


def test_an_orthogonal_change_of_features_changes_no_match(room):
    _, options, (source, f), (target, g) = room
    flip = torch.randperm(f.values.shape[1], generator=seeded(2))
    expected = tr.register_features(source, target, f, g, options)
    result = tr.register_features(source, target, -f.values[:, flip], -g.values[:, flip], options)
    assert torch.equal(result.correspondences.source, expected.correspondences.source)
    assert same_bits(result.T_target_source, expected.T_target_source)


def random_features(clouds, seed=0):
    return [torch.randn(len(cloud.points), 32, generator=seeded(100 * seed + k)) for k, cloud in enumerate(clouds)]


def assert_refused_or_right(pair, result):
    """The judge tries poses beside those proposed: in a room that is seen whole it may come to the right one."""
    rre, rte = errors(pair, result)
    assert not bool(result.success[0]) or (rre < 10 and rte < 0.5)
    assert bool(result.success[0]) == (result.reason[0] == "")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("effort", ["fast", "balanced", "thorough"])
def test_random_features_bring_no_wrong_success(effort, seed):
    pair = room_pair(500, seed=seed)
    result = tr.register_features(*pair[:2], *random_features(pair[:2], seed), effort=effort)
    assert_refused_or_right(pair, result)
    assert float(result.candidates[0][0].surprise) < 3  # hardly a match speaks for it
    plain = tr.register_features(*pair[:2], *random_features(pair[:2], seed), effort="plain")
    assert plain.failure[0].kind == "no consensus"


@pytest.mark.parametrize("effort", ["plain", "balanced", "thorough"])
def test_random_features_between_different_rooms_are_refused(effort):
    source, target, _ = moved_pair(FURNISHED, OTHER_ROOM)
    result = tr.register_features(source, target, *random_features((source, target)), effort=effort)
    assert result.success.tolist() == [False]
    assert result.reason[0] != ""


@pytest.mark.parametrize("effort", ["plain", "fast", "balanced"])
def test_features_of_other_points_bring_no_wrong_success(room, effort):
    pair, options, (source, f), (target, g) = room
    shifted = g.values.roll(len(g.values) // 2, dims=0)
    result = tr.register_features(source, target, f.values, shifted, options, effort=effort)
    assert_refused_or_right(pair, result)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_counts_as_the_same_numbers_in_float32(room, dtype):
    pair, options, (source, f), (target, g) = room
    half = [features.values.to(dtype) for features in (f, g)]
    result = tr.register_features(source, target, *half, options)
    wide = tr.register_features(source, target, *(each.float() for each in half), options)
    assert same_bits(result, wide, ignore=TIMES)
    assert_right(pair, result)


def test_float64_features_are_matched_in_float64(room):
    pair, options, (source, f), (target, g) = room
    # 1e9 + a difference of one part in a billion: float32 knows none
    fine = [1e9 + features.values.double() for features in (f, g)]
    result = tr.register_features(source, target, *fine, options)
    assert result.correspondences.score.dtype == torch.float64
    assert_right(pair, result)
    mixed = tr.register_features(source, target, f.values, g.values.double(), options)
    assert same_bits(mixed.T_target_source, tr.register_features(source, target, f, g, options).T_target_source)


def test_keypoints_are_matched_alone_on_the_whole_clouds(room):
    pair, options, (source, f), (target, g) = room
    rows = [torch.randperm(len(side.points), generator=seeded(k))[:900] for k, side in enumerate((source, target))]
    given = [tr.KeypointFeatures(chosen, side.values[chosen]) for chosen, side in zip(rows, (f, g), strict=True)]
    result = tr.register_features(source, target, *given, options)
    assert_right(pair, result)
    assert result.stages[0].described == (900, 900)
    assert len(result.source.points) == len(source.points)
    assert set(result.correspondences.source.tolist()) <= set(rows[0].tolist())
    masked = [
        replace(side, valid=torch.zeros_like(side.valid).index_fill(0, chosen, True) & side.valid)
        for chosen, side in zip(rows, (f, g), strict=True)
    ]
    same = tr.register_features(source, target, *masked, options)
    assert same_bits(same.T_target_source, result.T_target_source)


def test_rows_of_zeros_in_a_tensor_are_never_matched(room):
    pair, options, (source, f), (target, g) = room
    holes = f.values.clone()
    holes[::2] = 0
    result = tr.register_features(source, target, holes, g.values, options)
    assert bool((result.correspondences.source % 2 == 1).all())
    assert_right(pair, result)


def test_voxels_that_are_asked_for_choose_points_and_average_none(room):
    pair, options, (source, f), (target, g) = room
    asked = replace(options, voxel_size=1.5 * options.normal_radius / 2)
    result = tr.register_features(source, target, f, g, asked)
    assert_right(pair, result)
    assert 100 < len(result.source.points) < 0.9 * len(source.points)
    given = {tuple(point) for point in source.points.tolist()}
    assert {tuple(point) for point in result.source.points.tolist()} <= given
    assert result.options == (asked,)
    assert result.stages[0].given == (len(source.points), len(target.points))
    without = tr.register_features(source, target, f, g, options)
    assert len(without.source.points) == len(source.points)
    order = torch.randperm(len(source.points), generator=seeded(4))
    mixed = tr.register_features(source.rows(order, source.offsets), target, f.values[order], g, asked)
    assert same_bits(mixed.T_target_source, tr.register_features(source, target, f.values, g, asked).T_target_source)


def test_derived_options_keep_every_point():
    pair = room_pair(700, seed=3)
    f, g = (torch.randn(len(cloud.points), 8, generator=seeded(5)) for cloud in pair[:2])
    for effort in ("fast", "balanced"):
        result = tr.register_features(pair.source, pair.target, f, g, effort=effort)
        assert result.options[0].voxel_size is None
        assert result.options[0].effort == effort
        assert len(result.source.points) == len(pair.source.points)


def test_a_pair_that_cannot_be_registered_does_not_affect_the_others(room):
    _, options, (source, f), (target, g) = room
    broken = source.points.clone()
    broken[0] = float("nan")
    sources = tr.Clouds.pack([replace(source, points=broken), source])
    targets = tr.Clouds.pack([target, target])
    result = tr.register_features(
        sources, targets, torch.cat([f.values] * 2), torch.cat([g.values] * 2), options, effort="balanced"
    )
    alone = tr.register_features(source, target, f.values, g.values, options)
    assert result.failure[0].kind == "not finite"
    assert same_bits(result.T_target_source[1:], alone.T_target_source)
    assert same_bits(result.probability[1:], alone.probability)


def test_the_result_explains_itself_by_what_was_matched(room):
    _, options, (source, f), (target, g) = room
    result = tr.register_features(source, target, f.values, g.values, options)
    assert result.stages[0].proposals[0].origin == "features, compatibility"
    assert "features" in result.explain()


def wrong_features(f):
    return {
        "a row too few": (f[:-1], "f", "expected a row for each of", "points of source", str(tuple(f[:-1].shape))),
        "one number per point": (f[:, 0], "f", "expected (P, D)"),
        "no columns": (f[:, :0], "f", "at least one column"),
        "whole numbers": (f.long(), "f", "floating-point", "int64"),
        "not a number": (torch.where(torch.arange(len(f))[:, None] == 3, torch.nan, f), "f", "finite", "1 of"),
        "another width": (f[:, :5], "g", "width 5, as f"),
        "rows beyond": (tr.KeypointFeatures(torch.tensor([0, len(f)]), f[:2]), "f.rows", f"rows 0 to {len(f) - 1}"),
        "a row twice": (tr.KeypointFeatures(torch.tensor([1, 1]), f[:2]), "f.rows", "at most once"),
        "keypoints too many": (tr.KeypointFeatures(torch.tensor([1]), f[:2]), "f.values", "each of 1 keypoints"),
        "offsets of another batch": (
            tr.Features(f[:9], torch.tensor([0, 9]), (("x", f.shape[1]),), torch.ones(9, dtype=torch.bool)),
            "f",
            "offsets of source",
        ),
    }


@pytest.mark.parametrize("which", list(wrong_features(torch.rand(9, 8))))
def test_features_that_do_not_fit_are_refused_by_name(room, which):
    _, options, (source, f), (target, g) = room
    wrong, *parts = wrong_features(f.values)[which]
    with refuses(*parts):
        tr.register_features(source, target, wrong, g.values, options)


def test_arguments_of_another_type_are_refused_by_name(room):
    _, options, (source, f), (target, g) = room
    with pytest.raises(TypeError, match=r"source: expected Clouds, such as .* got a tensor"):
        tr.register_features(source.points, target, f, g, options)
    with pytest.raises(TypeError, match=r"^g: expected .+ got "):
        tr.register_features(source, target, f, g.values.tolist(), options)
    with refuses("target", "1 clouds"):
        tr.register_features(source, tr.Clouds.pack([target, target]), f, g, options)


def mutual(room):
    _, _, (_, f), (_, g) = room
    matches = tr.match_mutual(f, g)
    return matches, torch.stack([matches.source, matches.target], dim=1)


def test_matches_give_what_their_features_give_at_the_plain_effort(room):
    _, options, (source, f), (target, g) = room
    matches, pairs = mutual(room)
    plain = replace(options, effort="plain")
    expected = tr.register_features(source, target, f, g, plain)
    result = tr.register_matches(source, target, matches, plain)
    assert same_bits(result.T_target_source, expected.T_target_source)
    assert same_bits(result.inliers, expected.inliers)
    bare = tr.register_matches(source, target, pairs, plain)
    assert same_bits(bare.T_target_source, expected.T_target_source)


@pytest.mark.parametrize("effort", ["fast", "balanced", "thorough"])
def test_matches_in_any_form_find_the_room(room, effort):
    pair, options, (source, _), (target, _) = room
    matches, pairs = mutual(room)
    result = tr.register_matches(source, target, pairs, options, effort=effort)
    assert_right(pair, result)
    for form in ([pairs], pairs.int(), replace(matches, score=torch.zeros(len(pairs)))):
        assert same_bits(tr.register_matches(source, target, form, options, effort=effort), result, ignore=TIMES)
    if effort == "fast":  # one proposal: its matches are those given, row by row
        assert torch.equal(result.correspondences.source, pairs[:, 0])
        assert torch.equal(result.correspondences.target, pairs[:, 1])


def test_matches_follow_points_in_any_order(room):
    pair, options, (source, _), (target, _) = room
    _, pairs = mutual(room)
    order = torch.randperm(len(source.points), generator=seeded(1))
    place = torch.empty_like(order).index_put((order,), torch.arange(len(order)))
    moved = torch.stack([place[pairs[:, 0]], pairs[:, 1]], dim=1)
    expected = tr.register_matches(source, target, pairs, options)
    result = tr.register_matches(source.rows(order, source.offsets), target, moved, options)
    assert same_bits(result.T_target_source, expected.T_target_source)
    assert same_bits(order[result.correspondences.source], expected.correspondences.source)
    thinned = tr.register_matches(source, target, pairs, replace(options, voxel_size=options.normal_radius))
    assert_right(pair, thinned)
    assert thinned.stages[0].proposals[0].matches == len(pairs)  # matched points stay
    assert len(thinned.source.points) < len(source.points)


def test_swapped_sides_give_the_inverse(room):
    _, options, (source, _), (target, _) = room
    _, pairs = mutual(room)
    forth = tr.register_matches(source, target, pairs, options)
    back = tr.register_matches(target, source, pairs.flip(1), options)
    product = back.T_target_source[0] @ forth.T_target_source[0]
    assert torch.allclose(product, torch.eye(4, dtype=torch.float64), atol=0.02)


def test_without_matches_a_pair_fails_and_the_others_do_not(room):
    _, options, (source, _), (target, _) = room
    _, pairs = mutual(room)
    sources, targets = tr.Clouds.pack([source] * 3), tr.Clouds.pack([target] * 3)
    for effort in ("plain", "balanced"):
        result = tr.register_matches(sources, targets, [pairs[:0], pairs, pairs[:2]], options, effort=effort)
        assert result.success.tolist() == [False, True, False]
        assert [failure and failure.kind for failure in result.failure] == ["too few matches", None, "too few matches"]
        assert result.reason[0].startswith("too few matches: 0")
        alone = tr.register_matches(source, target, pairs, options, effort=effort)
        assert same_bits(result.T_target_source[1:2], alone.T_target_source)


@pytest.mark.parametrize("effort", ["plain", "balanced", "thorough"])
def test_random_matches_bring_no_wrong_success(room, effort):
    pair, options, (source, _), (target, _) = room
    rows = [torch.randint(len(side.points), (800,), generator=seeded(k)) for k, side in enumerate((source, target))]
    result = tr.register_matches(source, target, torch.stack(rows, dim=1), options, effort=effort)
    assert_refused_or_right(pair, result)
    assert not bool(result.success[0]) or effort != "plain"


def test_matches_that_do_not_fit_are_refused_by_name(room):
    _, options, (source, _), (target, _) = room
    _, pairs = mutual(room)
    count = len(source.points)
    for wrong, *parts in (
        (pairs[:, :1], "matches", "expected (M, 2)"),
        (pairs.float(), "matches", "whole numbers", "float32"),
        (pairs + count, "matches", f"rows 0 to {count - 1} of the {count} points of source 0"),
        (pairs - count, "matches", "points of source 0"),
        ([pairs, pairs], "matches", "each of 1 pairs", "got 2"),
    ):
        with refuses(*parts):
            tr.register_matches(source, target, wrong, options)
    with pytest.raises(TypeError, match=r"^matches: expected a tensor or Correspondences or .+, got 3"):
        tr.register_matches(source, target, 3, options)
    with pytest.raises(TypeError, match=r"target: expected Clouds, such as .* got None"):
        tr.register_matches(source, None, pairs, options)


def test_a_scan_without_keypoints_is_a_failed_pair(room):
    _, options, (source, f), (target, g) = room
    nothing = tr.KeypointFeatures(torch.zeros(0, dtype=torch.int64), f.values[:0])
    result = tr.register_features(source, target, nothing, g.values, options)
    assert not result.success[0]
    assert result.reason[0]
