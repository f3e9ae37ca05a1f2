"""Voxel means against a dictionary of voxels, and that neither batch nor threads show."""

import oracles
import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.geometry.morton import morton_order


def cloud(rows, seed=0, *, size=1.0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    points, colors, normals = torch.rand(3, rows, 3, dtype=torch.float64, generator=generator)
    normals = torch.nn.functional.normalize(normals - 0.5, dim=1)
    return tr.Clouds(points=(size * points).to(dtype), colors=colors.to(dtype), normals=normals.to(dtype))


def by_position(points, *more):
    rows = sorted(range(len(points)), key=lambda i: points[i].tolist())
    return [values[rows] for values in (points, *more)]


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(1, 60), st.floats(0.05, 3.0))
def test_means_are_those_of_a_dictionary_of_voxels(seed, rows, size):
    one = cloud(rows, seed)
    thinned = tr.voxel_downsample(one, size)
    means = list(oracles.voxel_means(one.points, size, one.colors, one.normals).values())
    expected = by_position(*(torch.stack([mean[which] for mean in means]) for which in range(3)))
    found = by_position(thinned.points, thinned.colors, thinned.normals)
    assert found[0].shape == expected[0].shape
    assert close(found[0], expected[0], atol=1e-14)
    assert close(found[1], expected[1], atol=1e-14)
    assert close(found[2], torch.nn.functional.normalize(expected[2], dim=1), atol=1e-12)


def test_points_come_in_morton_order():
    thinned = tr.voxel_downsample(tr.Clouds.pack([cloud(200, 0), cloud(300, 1)]), 0.1)
    order = morton_order(thinned.points, thinned.offsets)
    assert torch.equal(order, torch.arange(len(thinned.points)))


def test_a_tiny_voxel_keeps_every_point():
    one = cloud(50)
    thinned = tr.voxel_downsample(one, 1e-5)
    assert torch.equal(by_position(thinned.points)[0], by_position(one.points)[0])


def test_a_huge_voxel_leaves_the_mean():
    one = cloud(50)
    thinned = tr.voxel_downsample(one, 100.0)
    assert thinned.lengths == [1]
    assert close(thinned.points, one.points.mean(dim=0, keepdim=True), atol=1e-15)


def test_opposite_normals_in_one_voxel_stay_finite():
    one = tr.Clouds(points=torch.zeros(2, 3), normals=torch.tensor([[0.0, 0, 1], [0, 0, -1]]))
    assert torch.isfinite(tr.voxel_downsample(one, 1.0).normals).all()


def test_a_batch_equals_the_loop_over_its_clouds():
    sizes = (100, 0, 1, 250, 30)
    made = [cloud(rows, rows, dtype=torch.float32) for rows in sizes]
    alone = [tr.voxel_downsample(one, 0.2) for one in made]
    assert same_bits(tr.voxel_downsample(tr.Clouds.pack(made), 0.2), tr.Clouds.pack(alone))
    turned = tr.voxel_downsample(tr.Clouds.pack(made[::-1]), 0.2)
    assert same_bits(turned, tr.Clouds.pack(alone[::-1]))


def test_a_size_per_cloud():
    made = [cloud(100, seed) for seed in range(3)]
    sizes = torch.tensor([0.1, 0.3, 0.7], dtype=torch.float64)
    alone = [tr.voxel_downsample(one, size) for one, size in zip(made, sizes.tolist(), strict=True)]
    assert same_bits(tr.voxel_downsample(tr.Clouds.pack(made), sizes), tr.Clouds.pack(alone))


def test_the_number_of_threads_changes_nothing():
    scan = room_pair(60_000).source
    thinned = []
    for number in THREADS:
        with threads(number):
            thinned.append(tr.voxel_downsample(scan, 0.1))
    assert all(same_bits(one, thinned[0]) for one in thinned)
    assert same_bits(tr.voxel_downsample(scan, 0.1), thinned[0])


def test_a_shifted_origin_is_kept():
    origin = torch.tensor([[5e5, 4e6, 100.0]], dtype=torch.float64)
    one = tr.Clouds(points=torch.rand(20, 3), origin=origin, viewpoint=torch.ones(1, 3))
    thinned = tr.voxel_downsample(one, 0.5)
    assert same_bits(thinned.origin, origin)
    assert same_bits(thinned.viewpoint, one.viewpoint)


@pytest.mark.parametrize("size", [0, -1.0, float("nan"), float("inf"), torch.tensor([0.0])])
def test_a_size_that_is_none_is_refused(size):
    with refuses("voxel_size", "above 0"):
        tr.voxel_downsample(cloud(5), size)


def test_more_voxels_than_numbers_are_refused():
    with refuses("voxel_size", "2^62"):
        tr.voxel_downsample(cloud(5), 1e-9)
    with refuses("voxel_size", "(1,)", "(2,)"):
        tr.voxel_downsample(cloud(5), torch.ones(2))


def test_points_that_are_not_finite_are_refused():
    points = torch.rand(5, 3)
    points[2, 1] = float("nan")
    with refuses("voxel_size", "finite points"):
        tr.voxel_downsample(tr.Clouds(points=points), 0.1)


def test_an_empty_batch_stays_empty():
    empty = tr.Clouds(points=torch.zeros(0, 3), offsets=torch.tensor([0]))
    assert len(tr.voxel_downsample(empty, 0.1)) == 0
