"""The whole pipeline on rooms of known truth: found, said, refused, repeatable to the bit."""

from dataclasses import replace

import pytest
import torch
from determinism import assert_nothing_shows, same_bits
from problems import RoomPair, plane_cloud, random_transform, room_pair
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.color import color_values, joint_color_values
from torchreg.preprocess.downsample import in_morton_order

EYE = torch.eye(4, dtype=torch.float64)
ROOM = replace(  # the paper's steps at the scale of a room of some thousand points
    tr.PAPER,
    normal_radius=0.5,
    feature_radius=1.2,
    feature_max_neighbors=60,
    color_radius=0.8,
    ransac=tr.RansacOptions(inlier_threshold=0.2, hypotheses=100_000),
)
COUNTED = ("T_target_source", "inliers", "fitness", "inlier_rmse", "success")


def without_colors(cloud):
    return tr.Clouds(points=cloud.points, viewpoint=cloud.viewpoint, origin=cloud.origin)


def assert_found(result, pair, degrees=2.0, meters=0.2):
    assert result.reason == ("",)
    assert result.success.tolist() == [True]
    assert float(tr.metrics.rre(pair.T_target_source, result.T_target_source)) < degrees
    assert float(tr.metrics.rmse(pair.T_target_source, result.T_target_source, pair.source.points)) < meters


@pytest.mark.parametrize("seed", range(4))
def test_a_room_is_found_without_options(seed):
    pair = room_pair(3000, seed=seed)
    result = tr.register(pair.source, pair.target)
    assert_found(result, pair)
    assert result.notes == ((),)
    assert result.options == tr.derive_options(pair.source, pair.target)


@pytest.mark.parametrize("equalization", ["none", "cloud", "joint"])
def test_a_room_is_found_with_the_paper_steps(equalization):
    pair = room_pair(3000)
    options = replace(ROOM, equalization=equalization)
    result = tr.register(pair.source, pair.target, options)
    assert_found(result, pair)
    assert result.options == (options,)


def test_the_paper_options_reach_the_result():
    pair = room_pair(1500, scale=4.0)
    result = tr.register(pair.source, pair.target, tr.PAPER)
    assert result.options == (tr.PAPER,)
    assert int(result.hypotheses.drawn) <= 600_000


@pytest.mark.parametrize(
    "change",
    [
        {"color": ("contrast",), "color_weights": (0.7,)},
        {"color": ("contrast", "pcfh"), "color_weights": (0.7, 0.5)},
        {"color": (), "color_weights": ()},
        {"color_channels": ("hue", "saturation", "value")},
        {"saturation_weighting": True},
        {"color_bins": 5},
        {"ratio": 0.95},
        {"voxel_size": 0.15},
        {"feature_max_neighbors": 30, "normal_max_neighbors": 40},
    ],
)
def test_every_option_changes_the_matches_and_the_room_is_still_found(change):
    pair = room_pair(3000)
    plain, changed = (tr.register(pair.source, pair.target, replace(ROOM, **part)) for part in ({}, change))
    assert_found(changed, pair, 3.0, 0.3)
    assert not same_bits(changed.correspondences.score, plain.correspondences.score)


def test_register_is_its_steps_and_nothing_more():
    pair = room_pair(1500)
    sides = []
    for side in pair[:2]:
        cloud = tr.voxel_downsample(side, 0.1)
        near = tr.neighbors(cloud, 1.2, 60)
        cloud = tr.estimate_normals(cloud, near.restrict(0.5, 30))
        color = tr.pcfh(cloud, near.restrict(0.8), values=color_values(cloud, "cloud"))
        sides.append((cloud, tr.fuse(tr.fpfh(cloud, near), color)))
    (source, of_source), (target, of_target) = sides
    matches = tr.match_mutual(of_source, of_target)
    generator = torch.Generator().manual_seed(3)
    expected = tr.ransac(source, target, matches, ROOM.ransac, generator=generator)
    result = tr.register(pair.source, pair.target, replace(ROOM, voxel_size=0.1), seed=3)
    for name in (*COUNTED, "hypotheses", "correspondences", "reason"):
        assert same_bits(getattr(result, name), getattr(expected, name)), name


def test_register_hands_every_option_to_its_step():
    pair = room_pair(1500)
    options = replace(
        ROOM,
        normal_radius=0.45,
        normal_max_neighbors=12,
        feature_max_neighbors=50,
        color=("contrast", "pcfh"),
        color_weights=(0.7, 0.4),
        color_radius=0.9,
        color_bins=7,
        color_channels=("value", "hue"),
        equalization="joint",
        saturation_weighting=True,
        ratio=0.99,
    )
    source, target = (in_morton_order(side) for side in pair[:2])
    features = []
    for cloud, values in zip((source, target), joint_color_values(source, target), strict=True):
        near = tr.neighbors(cloud, 1.2, 50)
        geometry = tr.fpfh(tr.estimate_normals(cloud, near.restrict(0.45, 12)), near)
        contrast = tr.contrast(cloud, near.restrict(0.9), 0.9)
        color = tr.pcfh(
            cloud, near.restrict(0.9), bins=7, channels=("value", "hue"), saturation_weighting=True, values=values
        )
        features.append(tr.fuse(geometry, contrast, color, weights=(1.0, 0.7, 0.4)))
    expected = tr.match_mutual(*features, ratio=0.99)
    assert same_bits(tr.register(pair.source, pair.target, options).correspondences, expected)


@pytest.mark.parametrize("slots", [(40, 25), (25, 40)])
def test_normals_and_features_have_their_own_numbers_of_neighbors(slots):
    pair = room_pair(1500)
    for_normals, for_features = slots
    options = replace(
        ROOM, color=(), color_weights=(), normal_max_neighbors=for_normals, feature_max_neighbors=for_features
    )
    features = []
    for cloud in (in_morton_order(side) for side in pair[:2]):
        near = tr.neighbors(cloud, 1.2, 40)
        oriented = tr.estimate_normals(cloud, near.restrict(0.5, for_normals))
        features.append(tr.fuse(tr.fpfh(oriented, near.restrict(1.2, for_features))))
    expected = tr.match_mutual(*features)
    assert same_bits(tr.register(pair.source, pair.target, options).correspondences, expected)


def test_clouds_without_colors_are_found_and_the_notes_say_so():
    pair = room_pair(4000)
    result = tr.register(without_colors(pair.source), without_colors(pair.target))
    assert_found(result, pair, 3.0, 0.3)
    assert result.notes[0][0].startswith("no colors in source and target")
    half = tr.register(pair.source, without_colors(pair.target), ROOM)
    assert half.notes[0][0].startswith("no colors in target")
    assert len(half.reason) == 1


def test_clouds_without_a_viewpoint_say_so():
    pair = room_pair(1500)
    blind = tr.Clouds(points=pair.source.points, colors=pair.source.colors)
    (notes,) = tr.register(blind, pair.target, ROOM).notes
    assert [note.split(":")[0] for note in notes] == ["no viewpoint for the source"]


def test_the_stages_are_timed_in_order():
    pair = room_pair(400)
    names, seconds = zip(*tr.register(pair.source, pair.target, ROOM).seconds, strict=True)
    before = ("options", "downsample", "neighbors and normals", "descriptors", "matching")
    assert names == (*before, "hypotheses", "decision")
    assert all(second >= 0 for second in seconds)
    names, _ = zip(*tr.register(pair.source, pair.target, ROOM, refine="full").seconds, strict=True)
    assert names == (*before[:-1], "surfels", "matching", "hypotheses", "decision", "refinement")


def test_swapped_clouds_give_about_the_inverse():
    pair = room_pair(4000)
    forth = tr.register(pair.source, pair.target).T_target_source
    back = tr.register(pair.target, pair.source).T_target_source
    assert float(tr.metrics.rre(EYE[None], back @ forth)) < 2.0
    assert float(tr.metrics.rmse(EYE[None], back @ forth, pair.source.points)) < 0.2


def test_a_moved_source_moves_the_result():
    pair = room_pair(2500, dtype=torch.float64)
    T = random_transform(torch.Generator().manual_seed(8))
    moved = tr.transform(pair.source, T)
    result = tr.register(moved, pair.target, ROOM)
    composed = RoomPair(moved, pair.target, pair.T_target_source @ torch.linalg.inv(T))
    assert result.success.tolist() == [True]
    assert float(tr.metrics.rre(composed.T_target_source, result.T_target_source)) < 2.0


def test_the_order_of_points_does_not_matter():
    pair = room_pair(2500)
    order = torch.randperm(len(pair.source.points), generator=torch.Generator().manual_seed(0))
    shuffled = pair.source.rows(order, pair.source.offsets)
    assert same_bits(in_morton_order(shuffled).points, in_morton_order(pair.source).points)
    one, other = tr.register(pair.source, pair.target, ROOM), tr.register(shuffled, pair.target, ROOM)
    assert same_bits(one.T_target_source, other.T_target_source)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_origins_of_utm_size_lose_nothing(dtype):
    pair = room_pair(2000, dtype=dtype)
    at = torch.tensor([[4.5e5, 5.4e6, 300.0]], dtype=torch.float64)
    source, target = replace(pair.source, origin=at), replace(pair.target, origin=-at)
    near, far = (tr.register(*side, ROOM).T_target_source[0] for side in (pair[:2], (source, target)))
    points = pair.source.points.double()
    moved = (points + at) @ far[:3, :3].t() + far[:3, 3]
    assert (moved - (points @ near[:3, :3].t() + near[:3, 3] - at)).abs().max() < 1e-6


def test_nothing_given_is_written_to():
    pair = room_pair(800)
    before = [side.to(dtype=torch.float64).to(dtype=torch.float32) for side in pair[:2]]
    tr.register(pair.source, pair.target, ROOM)
    tr.register(pair.source, pair.target)
    assert all(same_bits(one, other) for one, other in zip(before, pair[:2], strict=True))


@pytest.mark.parametrize("seed", [1.5, "1", None, True])
def test_a_seed_that_is_no_integer_is_refused(seed):
    pair = room_pair(300)
    with refuses("seed", "an integer"):
        tr.register(pair.source, pair.target, ROOM, seed=seed)


def test_the_seed_decides_and_the_global_seed_does_not():
    pair = room_pair(1200)
    hard = replace(ROOM, ransac=tr.RansacOptions(hypotheses=300, inlier_threshold=0.1, local_optimization=0))
    before = torch.get_rng_state()
    one = tr.register(pair.source, pair.target, hard, seed=1)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(torch.initial_seed() + 1)
    assert same_bits(tr.register(pair.source, pair.target, hard, seed=1), one, ignore=("seconds",))
    torch.set_rng_state(before)
    assert not same_bits(tr.register(pair.source, pair.target, hard, seed=2), one, ignore=("seconds",))


@pytest.mark.parametrize("options", [None, ROOM], ids=["derived", "given"])
def test_neither_threads_nor_pieces_change_a_bit(options):
    pair = room_pair(1800)
    assert_nothing_shows(lambda: tr.register(pair.source, pair.target, options), ignore=("seconds",))


def bad_pairs():
    """Pairs that cannot be registered, each beside a good cloud, by name."""
    pair = room_pair(300, seed=5)

    def colored(points):
        return tr.Clouds(points=points, colors=torch.full_like(points, 0.5), viewpoint=torch.zeros(1, 3))

    spoiled = pair.source.points.clone()
    spoiled[7] = float("nan")
    endless = pair.source.points.clone()
    endless[9, 0] = float("inf")
    line = torch.linspace(0, 5, 60)[:, None] * torch.tensor([[0.6, 0.0, 0.8]])
    bad = {
        "empty": torch.zeros(0, 3),
        "one point": torch.ones(1, 3),
        "line": line,
        "one place": torch.full((50, 3), 1.5),
        "nan": spoiled,
        "infinite": endless,
    }
    as_source = [(f"{name} source", colored(points), pair.target) for name, points in bad.items()]
    as_target = [(f"{name} target", pair.source, colored(points)) for name, points in bad.items()]
    return as_source + as_target


@pytest.mark.parametrize("options", [None, ROOM], ids=["derived", "given"])
def test_a_pair_that_cannot_be_registered_is_refused_with_a_reason(options):
    for name, source, target in bad_pairs():
        result = tr.register(source, target, options)
        assert result.success.tolist() == [False], name
        assert result.reason[0].startswith(("too few points", "points that are not finite", "a degenerate cloud")), name
        assert torch.equal(result.T_target_source, EYE[None]), name
        assert len(result.correspondences.source) == 0, name


@pytest.mark.parametrize("options", [None, ROOM], ids=["derived", "given"])
def test_a_batch_equals_the_loop_over_its_pairs(options):
    good = [(f"room {count}", *room_pair(count, seed=count)[:2]) for count in (1200, 700, 1500)]
    bad = bad_pairs()
    batch = [bad[0], good[0], *bad[1:5], good[1], *bad[5:], good[2]]
    alone = {name: tr.register(source, target, options, seed=4) for name, source, target in batch}
    for chosen in (batch, batch[::-1], good[::-1]):
        source = tr.Clouds.pack([one for _, one, _ in chosen])
        target = tr.Clouds.pack([other for _, _, other in chosen])
        together = tr.register(source, target, options, seed=4)
        each = [alone[name] for name, _, _ in chosen]
        for field in COUNTED:
            assert same_bits(getattr(together, field), torch.cat([getattr(one, field) for one in each])), field
        for field in ("reason", "notes", "options"):
            assert getattr(together, field) == tuple(getattr(one, field)[0] for one in each), field
        for b, one in enumerate(each):
            begin, end = together.correspondences.offsets[b : b + 2].tolist()
            assert same_bits(together.correspondences.score[begin:end], one.correspondences.score)
            for row, count in zip(together.hypotheses, one.hypotheses, strict=True):
                assert same_bits(row[b : b + 1], count)
    assert any(bool(alone[name].success) for name, _, _ in good)


def test_pairs_of_one_batch_may_differ_in_lengths():
    pairs = [room_pair(900, scale=scale, seed=2) for scale in (1.0, 3.0)]
    options = [
        ROOM,
        replace(
            ROOM,
            normal_radius=1.5,
            feature_radius=3.6,
            color_radius=2.4,
            voxel_size=0.1,
            ransac=replace(ROOM.ransac, inlier_threshold=0.6),
        ),
    ]
    source, target = (tr.Clouds.pack(side) for side in zip(*(pair[:2] for pair in pairs), strict=True))
    together = tr.register(source, target, options)
    for b, pair in enumerate(pairs):
        alone = tr.register(pair.source, pair.target, options[b])
        assert same_bits(together.T_target_source[b : b + 1], alone.T_target_source)
    assert together.options == tuple(options)


@pytest.mark.parametrize("options", [None, ROOM], ids=["derived", "given"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -0.5, 200.0])
def test_colors_that_are_no_colors_leave_the_other_pairs_alone(bad, options):
    good, other = room_pair(900), room_pair(700, seed=1)
    other.source.colors[5, 1] = bad
    alone = tr.register(good.source, good.target, options)
    source = tr.Clouds.pack([good.source, other.source])
    target = tr.Clouds.pack([good.target, other.target])
    together = tr.register(source, target, options)
    assert same_bits(together.T_target_source[:1], alone.T_target_source)


def test_two_scenes_that_have_nothing_in_common_are_no_success():
    room = room_pair(1500)
    generator = torch.Generator().manual_seed(0)
    dust = tr.Clouds(
        points=3 * torch.rand(1500, 3, generator=generator),
        colors=torch.rand(1500, 3, generator=generator),
        viewpoint=torch.zeros(1, 3),
    )
    result = tr.register(room.source, dust)
    assert result.success.tolist() == [False]
    assert result.reason[0] != ""


def test_a_bare_plane_is_no_exception():
    flat = plane_cloud(800, 5.0)
    result = tr.register(flat, tr.Clouds(points=flat.points + 1))
    assert len(result.reason) == 1


def test_points_of_integers_times_a_step_are_no_exception():
    axis = torch.arange(8.0)
    cube = tr.Clouds(points=torch.cartesian_prod(axis, axis, axis))  # ties everywhere
    result = tr.register(cube, tr.transform(cube, random_transform(torch.Generator().manual_seed(1))))
    assert len(result.reason) == 1


def test_what_does_not_fit_is_refused():
    pair = room_pair(50)
    two = tr.Clouds.pack([pair.source, pair.source])
    none = tr.Clouds(points=torch.zeros(0, 3), offsets=torch.tensor([0]))
    with refuses("target", "1 clouds", "2"):
        tr.register(pair.source, two)
    with refuses("source", "at least one", "0"):
        tr.register(none, none)
    with refuses("options", "(2)", "1"):
        tr.register(two, two, [ROOM])
    with refuses("options", "lengths only"):
        tr.register(two, two, [ROOM, replace(ROOM, color_bins=5)])


def test_options_of_another_type_are_refused():
    pair = room_pair(50)
    with refuses("options"):
        tr.register(pair.source, pair.target, tr.RansacOptions())
