"""SHOT, with colors and without: against plain loops and PCL, and what must not show in it."""

import math
from dataclasses import replace
from pathlib import Path

import plain_shot
import pytest
import torch
from closeness import close
from determinism import assert_batch_equals_loop, assert_nothing_shows, pieces, same_bits
from kornia.color import rgb_to_lab
from problems import garbage_in_invalid_slots, oriented_room, random_transform, room_pair, seeded, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.lab import lab
from torchreg.descriptors.shot_votes import places, votes
from torchreg.native import native_kernels

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "real"
SCANS = ("redkitchen/frag_06.ply", "sceaux_outdoor/frag_06.ply")
both = pytest.mark.parametrize("describe", [tr.shot, tr.cshot], ids=["shot", "cshot"])


def described(describe, cloud, radius=0.6, max_neighbors=200):
    return describe(cloud, tr.neighbors(cloud, radius, max_neighbors))


def plain_rows(cloud, frames, radius):
    """Rows of both histograms, divided by nothing."""
    colors = lab(cloud.colors)

    def cosine(p, k):
        return 5 * (1 + float((cloud.normals[k] @ frames[p, 2]).clamp(-1, 1)))

    def difference(p, k):
        lightness, a, b = (colors[p] - colors[k]).abs().tolist()
        return 30 * min(1.0, (lightness + (a + b) / 2) / 3)

    return tuple(
        plain_shot.shot(cloud.points, value, bins, frames, radius) for value, bins in ((cosine, 10), (difference, 30))
    )


@pytest.mark.parametrize("seed", range(2))
def test_values_are_those_of_plain_loops(seed):
    cloud = sphere_cloud(90, seed=seed)
    near = tr.neighbors(cloud, 0.7, 90)
    shape, color = plain_rows(cloud, tr.local_frames(cloud, near), 0.7)
    expected = torch.nn.functional.normalize(torch.cat([shape, color], dim=1), dim=1)
    assert close(tr.shot(cloud, near).values, torch.nn.functional.normalize(shape, dim=1), atol=1e-9)
    assert close(tr.cshot(cloud, near).values, expected, atol=1e-9)


def test_neighbors_on_borders_between_sectors_count_where_the_frame_turned_by_half_has_them():
    axes = torch.cartesian_prod(*(torch.tensor([-1.0, 0.0, 1.0]),) * 3).double()
    points = torch.cat([torch.zeros(1, 3, dtype=torch.float64), 0.2 * axes[axes[:, :2].any(dim=1)]])
    cloud = tr.Clouds(points=points, normals=torch.tensor([0.0, 0.6, 0.8]).double().expand_as(points))
    near, frames = tr.neighbors(cloud, 1.0, 25), torch.eye(3, dtype=torch.float64).expand(25, 3, 3)
    half = torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    found = tr.shot(cloud, near, frames=frames).values[0].view(8, 44)
    turned = tr.shot(cloud, near, frames=frames * half[:, None]).values[0].view(8, 44)
    assert close(turned, found.roll(4, 0), atol=1e-12)
    assert not close(turned, found.roll(3, 0), atol=1e-3)


@both
def test_a_row_has_length_one_or_is_not_valid(describe):
    cloud = oriented_room(400)[0]
    features = described(describe, cloud, 0.5)
    assert 0 < int(features.valid.sum()) < 400
    assert close(features.values.norm(dim=1), features.valid.float(), atol=1e-5)
    assert features.values.min() >= 0


@both
@pytest.mark.parametrize("seed", range(3))
def test_a_rigid_motion_changes_nothing(describe, seed):
    cloud = sphere_cloud(200, seed=seed)
    expected = described(describe, cloud).values
    moved = tr.transform(cloud, random_transform(seeded(seed)))
    assert close(described(describe, moved).values, expected, atol=1e-7)


@both
@pytest.mark.real
@pytest.mark.parametrize("name", SCANS)
def test_a_rigid_motion_of_a_real_scan_changes_next_to_nothing(describe, name):
    if not (DATA / name).exists():
        pytest.skip(f"no {name} beside the checkout")
    raw = tr.read_cloud(DATA / name, dtype=torch.float64)
    voxel = 3 * float(tr.spacing(raw))
    cloud = tr.voxel_downsample(raw, voxel)
    near = tr.neighbors(cloud, 5 * voxel, 300)
    cloud = tr.estimate_normals(cloud, near)
    moved = tr.transform(cloud, random_transform(seeded(2), reach=1.0))
    off = (describe(moved, near).values - describe(cloud, near).values).abs().amax(dim=1) > 1e-6
    assert off.double().mean() < 2e-3  # a neighbor on a border, or a frame that noise decides


@both
def test_a_change_of_unit_changes_nothing(describe):
    cloud = sphere_cloud(150)
    feet = replace(cloud, points=3.25 * cloud.points)
    assert close(described(describe, feet, 0.6 * 3.25).values, described(describe, cloud).values, atol=1e-9)


@both
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_order_of_points_does_not_show_in_a_bit(describe, dtype):
    cloud = sphere_cloud(150, dtype=dtype)
    order = torch.randperm(150, generator=seeded(3))
    frames = tr.local_frames(cloud, tr.neighbors(cloud, 0.6, 150))
    other = cloud.rows(order, cloud.offsets)
    expected = describe(cloud, tr.neighbors(cloud, 0.6, 150), frames=frames)
    found = describe(other, tr.neighbors(other, 0.6, 150), frames=frames[order])
    assert same_bits(found.values, expected.values[order])


@both
def test_garbage_in_invalid_slots_changes_nothing(describe):
    cloud, near = oriented_room()
    assert same_bits(describe(cloud, near), describe(cloud, garbage_in_invalid_slots(near)))


@both
def test_a_batch_equals_the_loop_over_its_clouds(describe):
    def run(clouds):
        features = described(describe, clouds, 0.8, 40)
        return features.values, features.valid

    assert_batch_equals_loop(run, [oriented_room(count, seed)[0] for seed, count in enumerate((300, 500, 40))])


@both
@pytest.mark.parametrize(("dtype", "compiled"), [(torch.float32, True), (torch.float64, True), (torch.float32, False)])
def test_neither_threads_nor_pieces_change_a_bit(describe, dtype, compiled):
    cloud, near = oriented_room(300, dtype=dtype)
    with native_kernels(compiled):
        assert_nothing_shows(lambda: describe(cloud, near))


@both
def test_one_row_at_a_time_gives_the_same_bits(describe):
    cloud, near = oriented_room(100)
    expected = describe(cloud, near)
    with pieces(1), native_kernels(False):
        assert same_bits(describe(cloud, near), expected)


@both
def test_float32_is_within_rounding_but_on_borders(describe):
    cloud = sphere_cloud(300)
    expected = described(describe, cloud).values
    found = described(describe, cloud.to(dtype=torch.float32)).values.double()
    off = (found - expected).abs().amax(dim=1) > 1e-5
    assert off.double().mean() < 0.02


@both
def test_the_sign_of_the_normals_shows_in_nothing_but_their_histograms(describe):
    cloud = sphere_cloud(200)
    record = tr.Shot(radius=0.6, max_neighbors=200) if describe is tr.shot else tr.Cshot(radius=0.6, max_neighbors=200)
    near = tr.neighbors(cloud, 0.6, 200)
    one, other = (
        torch.nn.functional.normalize(record.unsigned(record.describe(each, near).values), dim=1)
        for each in (cloud, replace(cloud, normals=-cloud.normals))
    )
    assert close(one, other, atol=1e-9)
    assert not close(record.describe(cloud, near).values[:, :352], one[:, :1].expand(-1, 352), atol=0.1)


@both
def test_one_point_few_points_and_points_in_one_place_are_not_valid(describe):
    for points in (torch.zeros(1, 3), torch.rand(5, 3, generator=seeded(1)), torch.ones(20, 3)):
        normals = torch.tensor([0.0, 0.0, 1.0]).expand_as(points)
        features = described(describe, tr.Clouds(points=points, normals=normals, colors=points * 0.5), 3.0)
        assert not features.valid.any()
        assert not features.values.any()
    assert described(describe, sphere_cloud(6), 9.0).valid.all()


@both
def test_points_on_an_axis_of_the_frame_have_finite_values_and_gradients(describe):
    points = torch.cat([torch.eye(3), -torch.eye(3), torch.zeros(2, 3), 0.5 * torch.ones(2, 3)]).double()
    normals, colors = torch.zeros_like(points), torch.full_like(points, 0.5)
    leaves = [each.clone().requires_grad_() for each in (points, normals, colors)]
    cloud = tr.Clouds(points=leaves[0], normals=leaves[1], colors=leaves[2])
    features = described(describe, cloud, 3.0)
    gradients = torch.autograd.grad(features.values[:, ::3].sum(), leaves, allow_unused=describe is tr.shot)
    assert torch.isfinite(features.values).all()
    assert all(torch.isfinite(each).all() for each in gradients if each is not None)


@pytest.mark.parametrize("elements", [1 << 17, 40])
def test_gradients_are_those_of_differences(elements):
    cloud = sphere_cloud(10, seed=4)
    near = tr.neighbors(cloud, 2.2, 10)
    weights = torch.rand(10, 1344, generator=seeded(5), dtype=torch.float64)

    def loss(points, normals, colors):
        with pieces(elements):
            given = replace(cloud, points=points, normals=normals, colors=colors)
            return (tr.cshot(given, near).values * weights).sum(), (
                tr.shot(given, near).values * weights[:, :352]
            ).sum()

    leaves = [each.clone().requires_grad_() for each in (cloud.points, cloud.normals, cloud.colors)]
    assert torch.autograd.gradcheck(loss, leaves, atol=1e-5, fast_mode=True)


def test_gradients_reach_frames_that_are_given():
    cloud = sphere_cloud(10, seed=4)
    near = tr.neighbors(cloud, 2.2, 10)
    frames = tr.local_frames(cloud, near).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda f: tr.shot(cloud, near, frames=f).values, (frames,), atol=1e-5, fast_mode=True
    )


@both
def test_values_have_the_same_bits_with_gradients(describe):
    cloud, near = oriented_room(300)
    with_gradients = replace(cloud, points=cloud.points.clone().requires_grad_())
    assert same_bits(describe(with_gradients, near).values.detach(), describe(cloud, near).values)


@both
def test_what_is_missing_is_named(describe):
    cloud, near = oriented_room(50)
    with refuses("near"):
        describe(cloud, replace(near, radius=None))
    with refuses("cloud"):
        describe(replace(cloud, normals=None), near)
    with refuses("frames"):
        describe(cloud, near, frames=torch.eye(3))


@both
@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize(
    ("dtype", "bad"), [(torch.float32, math.nan), (torch.float32, math.inf), (torch.float64, 1e300)]
)
def test_frames_and_normals_that_are_not_finite_in_the_dtype_of_points_are_refused(describe, compiled, dtype, bad):
    cloud, near = oriented_room(50)
    frames, normals = tr.local_frames(cloud, near).to(dtype), cloud.normals.to(dtype, copy=True)
    frames[7], normals[7] = bad, bad
    with native_kernels(compiled):
        with refuses("frames", "finite"):
            describe(cloud, near, frames=frames)
        if dtype == cloud.points.dtype:  # of clouds whose normals have another, there are none
            with refuses("normals", "finite"):
                describe(replace(cloud, normals=normals), near)
        with refuses("values", "finite"):
            tr.cshot(cloud, near, values=normals)


@both
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_points_of_half_precision_are_described_in_single(describe, dtype):
    cloud, near = oriented_room(50)
    coarse = cloud.to(dtype=dtype)
    rows = describe(coarse, near).values
    assert torch.equal(rows, describe(coarse.to(dtype=torch.float32), near).values)


def test_a_value_that_is_no_number_stays_in_its_histogram():
    offset = torch.full((1, 3), 0.3)
    place = places(*(offset,) * 3, torch.ones(1, 3, dtype=torch.bool), torch.ones(1, 1))
    index, _ = votes(place, torch.tensor([[math.nan, 12.0, -3.0]]), torch.ones(1, 3, dtype=torch.bool), 10)
    assert int(index.min()) >= 0
    assert int(index.max()) < 352


def test_colors_or_values_of_theirs_are_needed():
    cloud, near = oriented_room(50)
    bare = replace(cloud, colors=None)
    with refuses("cloud"):
        tr.cshot(bare, near)
    assert same_bits(tr.cshot(bare, near, values=lab(cloud.colors)), tr.cshot(cloud, near))


def test_lab_is_that_of_kornia():
    colors = torch.cat([torch.rand(200, 3, generator=seeded(1)), torch.eye(3), torch.zeros(1, 3), torch.ones(1, 3)])
    expected = rgb_to_lab(colors.double().t()[None, :, :, None])[0, :, :, 0].t()
    assert close(lab(colors.double()) * torch.tensor([100.0, 120, 120]), expected, atol=0.02)


def test_colors_have_the_same_lab_wherever_they_stand():
    colors = torch.rand(37, 3, generator=seeded(1))
    assert same_bits(lab(colors)[5:29], lab(colors[5:29]))
    assert close(lab(colors).double(), lab(colors.double()), atol=1e-6)


@pytest.mark.parametrize("records", [
    (tr.Shot,), (tr.Cshot,), (tr.Fpfh, tr.Shot), (tr.Fpfh, tr.Cshot, tr.Contrast),
])  # fmt: skip
def test_register_describes_by_it_alone_and_fused(records):
    pair = room_pair(1500)
    options = tr.options_for(0.15)
    chosen = tuple(record(radius=0.9, max_neighbors=150) for record in records)
    options = replace(options, descriptors=chosen, weights=(1.0,) * len(chosen))
    result = tr.register(pair.source, pair.target, options)
    assert result.success.all()
    assert close(result.T_target_source[0].double(), pair.T_target_source[0].double(), atol=0.1)
