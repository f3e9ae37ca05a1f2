"""Crops and changes of density: the share that stays, which rows those are, and what they look like."""

import pytest
import torch
from determinism import same_bits
from refusals import refuses

import torchreg as tr
from torchreg.augment import Jitter, RandomCrop, RandomThin, RandomVoxels

SHAPES = ("plane", "box", "sphere")


def cube(count: int, seed: int = 0) -> tr.Clouds:
    draw = torch.Generator().manual_seed(seed)
    return tr.Clouds(
        2 * torch.rand(count, 3, generator=draw) - 1,
        colors=torch.arange(count)[:, None].expand(count, 3) / count,
        viewpoint=torch.zeros(1, 3),
    )


def rows_of(changed: tr.Clouds, cloud: tr.Clouds) -> torch.Tensor:
    """Which rows stayed, told by the color that is a row's number."""
    return (changed.colors[:, 0] * len(cloud.points)).round().long()


@pytest.mark.parametrize("share", [0.0, 0.333, 0.5, 1.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_crop_keeps_its_share_in_order(shape, share):
    cloud = cube(100)
    changed = RandomCrop(keep=(share, share), shape=shape)(cloud)
    assert changed.lengths == [max(1, {0.333: 34}.get(share, round(100 * share)))]
    rows = rows_of(changed, cloud)
    assert (rows.diff() > 0).all()
    assert torch.equal(changed.points, cloud.points[rows])


def test_what_a_plane_cuts_off_lies_on_its_other_side():
    """Two clouds that a plane parts: the means tell its direction, a linear classifier would tell the rest."""
    cloud = cube(2000)
    changed = RandomCrop(keep=(0.5, 0.5))(cloud)
    rows = rows_of(changed, cloud)
    away = torch.ones(2000, dtype=torch.bool)
    away[rows] = False
    kept, gone = cloud.points[rows], cloud.points[away]
    way = torch.nn.functional.normalize(gone.mean(dim=0) - kept.mean(dim=0), dim=0)
    assert (kept @ way).max() - (gone @ way).min() < 0.3  # but for the error of the direction


def test_a_sphere_is_one():
    cloud = cube(3000)
    kept = RandomCrop(keep=(0.1, 0.1), shape="sphere", generator=torch.Generator().manual_seed(4))(cloud).points
    distance = torch.cdist(kept, cloud.points)
    middle = distance.amax(dim=0).argmin()  # of all points, the one whose farthest kept point is nearest
    radius = (kept - cloud.points[middle]).norm(dim=1).max()
    inside = ((cloud.points - cloud.points[middle]).norm(dim=1) <= radius).sum()
    assert inside == 300


def test_crops_differ_in_place():
    crop, cloud = RandomCrop(keep=(0.3, 0.3), shape="box"), cube(400)
    middles = torch.stack([crop(cloud).points.mean(dim=0) for _ in range(20)])
    assert middles.std(dim=0).min() > 0.1


def test_thinning_keeps_its_share_and_prefers_the_near():
    cloud = cube(4000)
    reach = cloud.points.norm(dim=1)
    even = RandomThin(keep=(0.25, 0.25), falloff=(0.0, 0.0))(cloud)
    steep = RandomThin(keep=(0.25, 0.25), falloff=(3.0, 3.0))(cloud)
    assert even.lengths == steep.lengths == [1000]
    assert even.points.norm(dim=1).mean() == pytest.approx(reach.mean().item(), rel=0.03)
    assert steep.points.norm(dim=1).mean() < 0.85 * reach.mean()
    assert (rows_of(even, cloud).diff() > 0).all()


def test_thinning_is_a_draw_in_proportion_to_the_weights():
    """One point of two stays, at distances 1 and 2 with falloff 2: four times in five the near one."""
    two = tr.Clouds(torch.tensor([[1.0, 0, 0], [0, 2, 0]]), viewpoint=torch.zeros(1, 3))
    many = tr.Clouds.pack([two] * 1000)
    kept = RandomThin(keep=(0.5, 0.5), falloff=(2.0, 2.0))(many).points
    assert (kept[:, 0] > 0).double().mean() == pytest.approx(0.8, abs=0.04)


def test_distance_counts_from_the_viewpoint_or_from_zero():
    cloud = cube(500)
    thin = [RandomThin(falloff=(2.0, 2.0)) for _ in range(3)]
    unknown = tr.Clouds(cloud.points, colors=cloud.colors, viewpoint=torch.full((1, 3), float("nan")))
    bare = tr.Clouds(cloud.points, colors=cloud.colors)
    assert same_bits(thin[0](cloud).points, thin[1](unknown).points)
    assert same_bits(thin[0](cloud).points, thin[2](cloud).points) is False  # the first went on in its stream
    assert same_bits(RandomThin(falloff=(2.0, 2.0))(bare).points, RandomThin(falloff=(2.0, 2.0))(cloud).points)


def test_voxels_hold_one_point_each_on_a_grid_that_moves():
    cloud, size = cube(3000), 0.25
    voxels = RandomVoxels(voxel_size=(size, size))
    first, second = voxels(cloud), voxels(cloud)
    for kept in (first, second):
        assert 8**3 <= kept.lengths[0] <= 9**3
        assert torch.equal(kept.points, cloud.points[rows_of(kept, cloud)])
        # one point a cube: no point of the cloud is farther from the next that stayed than a cube's diagonal
        assert torch.cdist(cloud.points, kept.points).amin(dim=1).max() <= size * 3**0.5
    assert not same_bits(first.points, second.points)


def test_coarser_voxels_keep_fewer():
    cloud = cube(2000)
    counts = [RandomVoxels(voxel_size=(size, size))(cloud).lengths[0] for size in (0.1, 0.3, 0.9, 9.0)]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] <= 8


def test_jitter_is_normal_and_cut_off():
    cloud = cube(5000)
    noise = Jitter(sigma=0.02, clip=1.5)(cloud).points - cloud.points
    assert noise.abs().max() <= 0.02 * 1.5 + 1e-6
    assert (noise.abs() > 0.02 * 1.4999).double().mean() == pytest.approx(0.134, abs=0.015)  # what lay beyond
    assert noise.mean().abs() < 1e-3
    assert torch.equal(Jitter(sigma=0.02)(cloud).colors, cloud.colors)


def test_refusals():
    with refuses("keep", "(low, high) within [0, 1]", "(0.5, 1.2)"):
        RandomCrop(keep=(0.5, 1.2))
    with refuses("keep", "(a number, a number)", "0.5"):
        RandomThin(keep=0.5)
    with refuses("shape", "'sphere'"):
        RandomCrop(shape="cone")
    with refuses("falloff", "within [0, 4]"):
        RandomThin(falloff=(2.0, 1.0))
    with refuses("voxel_size", "above 0"):
        RandomVoxels(voxel_size=(0.0, 1.0))
    with refuses("voxel_size", "at most 1048576 cubes"):
        RandomVoxels(voxel_size=(1e-9, 1e-9))(cube(10))
    with refuses("sigma", "meters of at least 0"):
        Jitter(sigma=-0.1)
    with refuses("clip", "standard deviations"):
        Jitter(clip=float("nan"))
