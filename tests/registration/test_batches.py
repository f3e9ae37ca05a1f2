"""Batches: every distinct cloud described once, slices of any budget, halves that are the whole; all to the bit."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.registration import describe, describe_clouds, register_described
from torchreg.registration.described import DescribedClouds
from torchreg.registration.plan import pair_bytes
from torchreg.registration.same_clouds import same_clouds

ROOM = replace(
    tr.PAPER,
    normal_radius=0.5,
    feature_radius=1.2,
    feature_max_neighbors=40,
    color_radius=0.8,
    ransac=tr.RansacOptions(inlier_threshold=0.2, hypotheses=20_000),
)
PER_PAIR = (
    *("T_target_source", "fitness", "inlier_rmse", "success"),
    *("probability", "overlap", "information", "strength", "runner_up", "margin"),
)
LISTED = ("failure", "options", "notes", "candidates", "stages")
SIZES = (900, 300, 1400, 200, 700)


def mixed_batch():
    pairs = [room_pair(size, seed=size) for size in SIZES]
    return tr.Clouds.pack([pair.source for pair in pairs]), tr.Clouds.pack([pair.target for pair in pairs])


@pytest.fixture
def described_points(monkeypatch):
    """How many points each call of the describing step was given."""
    seen = []
    oriented = describe.oriented

    def counting(cloud, options):
        seen.append(cloud.lengths)
        return oriented(cloud, options)

    monkeypatch.setattr(describe, "oriented", counting)
    return seen


@pytest.mark.parametrize(
    "options", [None, ROOM, replace(ROOM, equalization="joint")], ids=["derived", "given", "joint"]
)
def test_a_budget_of_any_size_gives_the_same_bits(options):
    source, target = mixed_batch()
    whole = tr.register(source, target, options, max_bytes=1 << 40)
    for max_bytes in (1, 6_000_000):
        sliced = tr.register(source, target, options, max_bytes=max_bytes)
        assert same_bits(sliced, whole, ignore=("seconds",)), max_bytes
    rows = whole.correspondences
    for b, (begin, end) in enumerate(zip(rows.offsets[:-1].tolist(), rows.offsets[1:].tolist(), strict=True)):
        alone = tr.register(source.select(b), target.select(b), options)
        for name in PER_PAIR:
            value = getattr(alone, name)
            assert value is None or same_bits(value[0], getattr(whole, name)[b]), name
        for name in LISTED:
            assert same_bits(getattr(alone, name), getattr(whole, name)[b : b + 1]), name
        assert same_bits(alone.inliers, whole.inliers[begin:end])
        assert same_bits(alone.correspondences.score, rows.score[begin:end])
        first = whole.source.offsets[b], whole.target.offsets[b]
        assert same_bits(alone.source, whole.source.select(b))
        assert torch.equal(alone.correspondences.source + first[0], rows.source[begin:end])
        assert torch.equal(alone.correspondences.target + first[1], rows.target[begin:end])
        for counts, own in zip(whole.hypotheses, alone.hypotheses, strict=True):
            assert torch.equal(counts[b : b + 1], own)


@pytest.mark.parametrize("options", [None, ROOM], ids=["derived", "given"])
def test_all_pairs_of_some_clouds_describe_each_of_them_once(options, described_points):
    clouds = [room_pair(size, seed=7).source for size in (500, 520, 540)]
    if options is None:  # lengths derived pair by pair differ, and so do descriptions
        options = tr.derive_options(clouds[0], clouds[1])[0]
    pairs = [(i, k) for i in range(3) for k in range(3) if i != k]
    source, target = (tr.Clouds.pack([clouds[pair[side]] for pair in pairs]) for side in range(2))
    together = tr.register(source, target, options)
    sizes = sorted(len(cloud.points) for cloud in clouds)
    assert sorted(length for call in described_points for length in call) == sizes
    sliced = tr.register(source, target, options, max_bytes=1)
    assert sorted(length for call in described_points for length in call) == sorted(2 * sizes)
    assert same_bits(sliced, together, ignore=("seconds",))
    for b, (i, k) in enumerate(pairs):
        assert same_bits(tr.register(clouds[i], clouds[k], options).T_target_source[0], together.T_target_source[b])


def test_the_two_halves_are_the_whole():
    source, target = mixed_batch()
    parts = [DescribedClouds.pack([describe_clouds(one, ROOM) for one in side.unpack()]) for side in (source, target)]
    halves = register_described(*parts, [ROOM] * len(source), seed=3)
    assert same_bits(halves, tr.register(source, target, ROOM, seed=3), ignore=("seconds",))


def test_described_clouds_survive_packing_and_unpacking():
    source, _ = mixed_batch()
    described = describe_clouds(source, ROOM)
    again = DescribedClouds.pack(described.unpack())
    assert same_bits(again.cloud, described.cloud)
    assert same_bits(again.features, described.features)
    assert (again.descriptions, again.spacing, again.facts) == (
        described.descriptions,
        described.spacing,
        described.facts,
    )
    with refuses("parts", "at least one"):
        DescribedClouds.pack([])
    with refuses("parts", "the same descriptors"):
        DescribedClouds.pack([described, describe_clouds(source, replace(ROOM, color=(), color_weights=()))])


def test_a_clone_has_the_same_bits_in_memory_of_its_own():
    described = describe_clouds(mixed_batch()[0], ROOM).unpack()[0]
    copy = described.clone()
    assert same_bits(copy.cloud, described.cloud)
    assert same_bits(copy.features, described.features)
    pairs = [(copy.cloud.points, described.cloud.points), (copy.cloud.normals, described.cloud.normals)]
    pairs += [(one.values, other.values) for one, other in zip(copy.features, described.features, strict=True)]
    for one, other in pairs:
        assert one.untyped_storage().data_ptr() != other.untyped_storage().data_ptr()


def test_a_pair_that_is_refused_leaves_its_clouds_to_other_pairs():
    good, bad = room_pair(600, seed=1), tr.Clouds(points=torch.zeros(2, 3), colors=torch.zeros(2, 3))
    bad = replace(bad, viewpoint=torch.zeros(1, 3))
    source = tr.Clouds.pack([good.source, bad, good.source])
    target = tr.Clouds.pack([bad, good.target, good.target])
    result = tr.register(source, target, ROOM)
    assert [reason.split(":")[0] for reason in result.reason[:2]] == ["too few points"] * 2
    assert [stage.points for stage in result.stages[:2]] == [(0, 0)] * 2
    alone = tr.register(good.source, good.target, ROOM)
    assert same_bits(result.T_target_source[2:], alone.T_target_source)


def test_the_second_half_says_what_it_lacks():
    pair = room_pair(200)
    bare = replace(ROOM, color=(), color_weights=())
    source, target = (describe_clouds(cloud, bare) for cloud in pair[:2])
    with refuses("source", "Pcfh"):
        register_described(source, target, [ROOM])
    for change in ({"voxel_size": 0.2}, {"normal_radius": 0.3}):
        with refuses("source", "normal_radius"):
            register_described(source, target, [replace(bare, **change)])
    two = DescribedClouds.pack([source, source])
    with refuses("options", "lengths only"):
        register_described(two, two, [bare, replace(bare, match_neighbors=2)])
    with refuses("options", "one per pair"):
        register_described(source, target, [])


def test_hue_equalized_jointly_cannot_be_described_alone():
    pair = room_pair(200)
    with refuses("options.descriptors", "each cloud by itself"):
        describe_clouds(pair.source, replace(ROOM, equalization="joint"))


def test_equal_clouds_are_known_by_their_bits():
    one, other = room_pair(60, seed=1)[:2]
    shifted = replace(one, origin=one.origin + 1)
    bare = replace(one, colors=None)
    negative = tr.Clouds(points=torch.tensor([[0.0, 0.0, 0.0]]))
    positive = tr.Clouds(points=-negative.points)
    copy = replace(one, points=one.points.clone())
    assert same_clouds([tr.Clouds.pack([one, other, copy]), tr.Clouds.pack([other, shifted])]) == [[0, 1, 0], [1, 4]]
    assert same_clouds([one, bare]) == [[0], [1]]
    guessed = replace(one, viewpoint_assumed=torch.tensor([True]))
    assert same_clouds([one, guessed, replace(guessed, viewpoint_assumed=None)]) == [[0], [1], [0]]
    assert same_clouds([negative, positive, negative]) == [[0], [1], [0]]


def test_a_larger_pair_is_held_to_need_more_memory():
    assert pair_bytes(1000, ROOM) > pair_bytes(100, ROOM)


@pytest.mark.parametrize("bad", [0, -1, 1.5, "1GB"])
def test_a_budget_that_is_none_is_refused(bad):
    pair = room_pair(50)
    with refuses("max_bytes"):
        tr.register(pair.source, pair.target, ROOM, max_bytes=bad)
