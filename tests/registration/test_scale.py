"""The scale of a cloud, and the options that follow from it."""

from dataclasses import replace

import pytest
import torch
from determinism import THREADS, same_bits, threads
from problems import plane_cloud, random_transform, room_pair
from refusals import refuses

import torchreg as tr
from torchreg.registration.spacing import MAX_POINTS, THINNED_POINTS


def lattice(side, step, dtype=torch.float64):
    axis = torch.arange(side, dtype=dtype) * step
    return tr.Clouds(points=torch.cartesian_prod(axis, axis, torch.zeros(1, dtype=dtype)))


def numbers(options):
    return options.normal_radius, options.feature_radius, options.color_radius, options.ransac.inlier_threshold


@pytest.mark.parametrize("step", [1e-3, 0.05, 1.0, 250.0])
def test_the_spacing_of_a_lattice_is_its_step(step):
    assert tr.spacing(lattice(20, step)).tolist() == pytest.approx([step])


def test_spacing_moves_with_the_unit_and_not_with_the_cloud():
    scan = room_pair(800, dtype=torch.float64).source
    moved = tr.transform(scan, random_transform(torch.Generator().manual_seed(1)))
    feet = tr.Clouds(points=3.25 * scan.points)
    order = torch.randperm(len(scan.points), generator=torch.Generator().manual_seed(2))
    expected = tr.spacing(scan)
    assert torch.allclose(tr.spacing(moved), expected, rtol=1e-9)
    assert torch.allclose(tr.spacing(feet), 3.25 * expected, rtol=1e-9)
    assert torch.allclose(tr.spacing(scan.rows(order, scan.offsets)), expected, rtol=1e-9)


@pytest.mark.parametrize("rows", [0, 1, 4])
def test_a_cloud_of_too_few_points_has_spacing_zero(rows):
    assert tr.spacing(tr.Clouds(points=torch.rand(rows, 3))).tolist() == [0]


def test_a_cloud_at_one_place_has_spacing_zero():
    assert tr.spacing(tr.Clouds(points=torch.ones(30, 3))).tolist() == [0]


def test_spacing_of_a_batch_is_that_of_its_clouds():
    made = [room_pair(count, seed=count).source for count in (300, 700)]
    bare = [tr.Clouds(points=one.points) for one in made]
    bare.insert(1, tr.Clouds(points=torch.zeros(0, 3)))
    together = tr.spacing(tr.Clouds.pack(bare))
    assert together.dtype == torch.float64
    assert same_bits(together, torch.cat([tr.spacing(one) for one in bare]))


def test_the_number_of_threads_changes_nothing():
    pair = room_pair(9000)
    found = []
    for number in THREADS:
        with threads(number):
            found.append((tr.spacing(pair.source), tr.derive_options(pair.source, pair.target)))
    assert all(same_bits(one[0], found[0][0]) and one[1] == found[0][1] for one in found)


@pytest.mark.parametrize(("voxel", "scale"), [(0.05, 0.35), (0.30, 2.1)])
def test_a_cloud_just_downsampled_gets_multiples_of_its_voxel(voxel, scale):
    pair = room_pair(60_000, scale=scale)
    source, target = (tr.voxel_downsample(side, voxel) for side in pair[:2])
    (options,) = tr.derive_options(source, target)
    assert options.normal_radius == pytest.approx(2 * voxel, rel=0.1)
    assert options.feature_radius == pytest.approx(5 * voxel, rel=0.1)
    assert options.ransac.inlier_threshold == pytest.approx(1.5 * voxel, rel=0.1)
    assert options.voxel_size is None


def test_a_scene_six_times_as_large_gets_six_times_the_lengths():
    small, large = (room_pair(2000, scale=scale, dtype=torch.float64) for scale in (1.0, 6.0))
    (of_small,) = tr.derive_options(small.source, small.target)
    (of_large,) = tr.derive_options(large.source, large.target)
    assert numbers(of_large) == pytest.approx([6 * number for number in numbers(of_small)], rel=1e-6)


def test_lengths_are_multiples_of_the_coarser_spacing():
    one, other = lattice(30, 0.1), lattice(30, 0.12)
    (options,) = tr.derive_options(one, other)
    assert numbers(options) == pytest.approx((0.24, 0.6, 0.6, 0.18))
    assert options.voxel_size is None
    assert numbers(tr.derive_options(other, one)[0]) == pytest.approx(numbers(options))


def test_uneven_clouds_are_brought_to_the_coarser_spacing():
    (options,) = tr.derive_options(lattice(30, 0.1), lattice(30, 0.2))
    assert options.voxel_size == pytest.approx(0.2)
    assert options.normal_radius == pytest.approx(0.4)


@pytest.mark.parametrize("seed", range(4))
def test_many_points_are_thinned_to_at_most_so_many(seed):
    flat = plane_cloud(MAX_POINTS + 10_000, 20.0, seed=seed)
    scan = room_pair(50_000, seed=seed).source
    scan = tr.Clouds(points=scan.points)
    assert len(scan.points) > MAX_POINTS
    for one, other in ((flat, flat), (scan, flat), (scan, plane_cloud(2000, 5.0))):
        (options,) = tr.derive_options(one, other)
        left = [len(tr.voxel_downsample(cloud, options.voxel_size).points) for cloud in (one, other)]
        assert max(left) <= THINNED_POINTS
        assert max(left) > 0.9 * THINNED_POINTS


def test_lengths_follow_from_the_thinned_cloud():
    flat = plane_cloud(MAX_POINTS + 1, 20.0)
    (options,) = tr.derive_options(flat, flat)
    thinned = tr.voxel_downsample(flat, options.voxel_size)
    assert options.normal_radius == pytest.approx(2 * float(tr.spacing(thinned)))
    assert options == replace(tr.derive_options(thinned, thinned)[0], voxel_size=options.voxel_size)


def test_colors_are_used_where_both_clouds_have_them():
    pair = room_pair(500)
    bare = tr.Clouds(points=pair.target.points)
    (colored,) = tr.derive_options(pair.source, pair.target)
    (plain,) = tr.derive_options(pair.source, bare)
    assert set(colored.color) == {"contrast", "pcfh"}
    assert len(colored.color_weights) == 2
    assert plain.color == ()
    assert numbers(plain) == numbers(colored)


@pytest.mark.parametrize("bad", [torch.zeros(0, 3), torch.full((9, 3), float("nan")), torch.ones(9, 3)])
def test_a_cloud_that_cannot_be_registered_has_options_all_the_same(bad):
    good = lattice(10, 0.1, torch.float32)
    for one, other in ((good, tr.Clouds(points=bad)), (tr.Clouds(points=bad), good)):
        (options,) = tr.derive_options(one, other)
        assert all(number > 0 for number in numbers(options))


def test_every_pair_of_a_batch_has_its_own_options():
    pairs = [room_pair(500, scale=scale, seed=b) for b, scale in enumerate((1.0, 4.0, 0.2))]
    source, target = (tr.Clouds.pack(side) for side in zip(*(pair[:2] for pair in pairs), strict=True))
    alone = tuple(tr.derive_options(*pair[:2])[0] for pair in pairs)
    assert tr.derive_options(source, target) == alone


def test_sides_of_different_numbers_are_refused():
    one = lattice(5, 0.1)
    with refuses("target", "1 clouds", "2"):
        tr.derive_options(one, tr.Clouds.pack([one, one]))
