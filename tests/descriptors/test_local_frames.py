"""Local reference frames: against plain steps, and that they turn with the cloud."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from closeness import close
from determinism import assert_batch_equals_loop, assert_nothing_shows, pieces, same_bits
from problems import garbage_in_invalid_slots, oriented_room, random_transform, seeded, sphere_cloud
from refusals import refuses

import torchreg as tr

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "real"
SCANS = ("redkitchen/frag_06.ply", "sceaux_outdoor/frag_06.ply", "eth_facade_tls_nocolour/scan_6.ply")


def plain_frame(points, p, radius):
    """The frame of one point among points (N, 3), by the steps of the paper; None where there is none."""
    offsets = points - points[p]
    distance = offsets.norm(dim=1)
    order = [k for k in distance.argsort(stable=True).tolist() if 0 < distance[k] < radius]
    if len(order) < 5:
        return None
    d, weight = offsets[order], radius - distance[order]
    covariance = sum(w * torch.outer(v, v) for w, v in zip(weight, d, strict=True)) / weight.sum()
    _, vectors = torch.linalg.eigh(covariance)
    axes = []
    for axis in (vectors[:, 2], vectors[:, 0]):
        ahead = int((d @ axis >= 0).sum())
        if 2 * ahead == len(d):
            middle = d[len(d) // 2 - 2 : len(d) // 2 + 3]
            ahead = len(d) if int((middle @ axis > 0).sum()) >= 3 else 0
        axes.append(axis if 2 * ahead >= len(d) else -axis)
    x, z = axes
    return torch.stack([x, torch.linalg.cross(z, x), z])


def frames_of(cloud, radius=0.6, max_neighbors=200):
    return tr.local_frames(cloud, tr.neighbors(cloud, radius, max_neighbors))


@pytest.mark.parametrize("seed", range(3))
def test_frames_are_those_of_plain_steps(seed):
    cloud = sphere_cloud(120, seed=seed)
    expected = [plain_frame(cloud.points, p, 0.6) for p in range(120)]
    assert sum(frame is None for frame in expected) < 20
    expected = torch.stack([torch.zeros(3, 3).double() if frame is None else frame for frame in expected])
    assert close(frames_of(cloud), expected, atol=1e-9)


@pytest.mark.parametrize("signs", [(1, 1, -1, 1, -1, -1), (-1, 1, -1, 1, -1, 1), (-1, -1, 1, -1, 1, 1)])
def test_where_as_many_lie_on_both_sides_those_of_middle_distance_decide(signs):
    neighbors = [(s * (0.1 + 0.01 * k), 0.02 * (-1) ** k, 0.001 * k * k) for k, s in enumerate(signs)]
    cloud = tr.Clouds(points=torch.tensor([(0.0, 0.0, 0.0), *neighbors], dtype=torch.float64))
    frame = frames_of(cloud, 1.0)[0]
    assert close(frame, plain_frame(cloud.points, 0, 1.0), atol=1e-9)
    assert frame[0, 0] * sum(signs[1:]) > 0  # of six, the last five are in the middle


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_axes_are_orthonormal_and_right_handed(dtype):
    frames = frames_of(sphere_cloud(300, dtype=dtype))
    eye = torch.eye(3, dtype=dtype).expand_as(frames)
    assert close(frames @ frames.transpose(1, 2), eye, atol=1e-6)
    assert close(torch.linalg.det(frames), torch.ones(300, dtype=dtype), atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_frames_turn_with_the_cloud_signs_included(seed):
    cloud = sphere_cloud(300, seed=seed)
    T = random_transform(seeded(seed))
    moved = frames_of(tr.transform(cloud, T))
    assert close(moved, frames_of(cloud) @ T[:3, :3].T, atol=1e-7)


@pytest.mark.real
@pytest.mark.parametrize("name", SCANS)
def test_frames_turn_with_a_real_scan(name):
    if not (DATA / name).exists():
        pytest.skip(f"no {name} beside the checkout")
    raw = tr.read_cloud(DATA / name, dtype=torch.float64)
    voxel = float(tr.spacing(raw)) * 3
    cloud = tr.voxel_downsample(raw, voxel)
    T = random_transform(seeded(1), reach=1.0)
    near = tr.neighbors(cloud, 5 * voxel, 300)
    moved = tr.local_frames(tr.transform(cloud, T), near)
    expected = tr.local_frames(cloud, near) @ T[:3, :3].T
    off = (moved - expected).abs().flatten(1).amax(dim=1) > 1e-5
    assert off.double().mean() < 1e-3  # where two eigenvalues are equal, or a neighbor lies between the sides


def test_a_change_of_unit_changes_nothing():
    cloud = sphere_cloud(150)
    feet = replace(cloud, points=3.25 * cloud.points)
    assert close(frames_of(feet, 0.6 * 3.25), frames_of(cloud), atol=1e-9)


def test_a_permutation_of_points_permutes_the_frames():
    cloud = sphere_cloud(150)
    order = torch.randperm(150, generator=seeded(3))
    assert close(frames_of(cloud.rows(order, cloud.offsets)), frames_of(cloud)[order], atol=1e-9)


def test_garbage_in_invalid_slots_changes_nothing():
    cloud, near = oriented_room()
    assert same_bits(tr.local_frames(cloud, near), tr.local_frames(cloud, garbage_in_invalid_slots(near)))


def test_a_batch_equals_the_loop_over_its_clouds():
    clouds = [oriented_room(count, seed)[0] for seed, count in enumerate((300, 500, 40))]
    assert_batch_equals_loop(lambda cloud: (frames_of(cloud, 0.8, 40),), clouds)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_neither_threads_nor_pieces_change_a_bit(dtype):
    cloud, near = oriented_room(600, dtype=dtype)
    assert_nothing_shows(lambda: tr.local_frames(cloud, near))
    with pieces(1):
        small, around = oriented_room(60, dtype=dtype)
        one_by_one = tr.local_frames(small, around)
    assert same_bits(one_by_one, tr.local_frames(small, around))


def test_a_radius_for_every_point_is_as_one_for_all():
    cloud = sphere_cloud(150)
    near = tr.neighbors(cloud, 0.6, 150)
    each = replace(near, radius=torch.full((150,), 0.6, dtype=torch.float64))
    assert same_bits(tr.local_frames(cloud, each), tr.local_frames(cloud, near))


@pytest.mark.parametrize("neighbors", [0, 1, 4, 5])
def test_fewer_than_five_neighbors_give_no_frame(neighbors):
    points = torch.cat([torch.zeros(3, 3), torch.rand(neighbors, 3, generator=seeded(2))])  # two in the same place
    frames = frames_of(tr.Clouds(points=points), 3.0)
    assert frames.shape == (3 + neighbors, 3, 3)
    assert bool((frames[0] == 0).all()) == (neighbors < 5)


def test_points_in_one_place_have_no_frame():
    assert torch.equal(frames_of(tr.Clouds(points=torch.ones(20, 3))), torch.zeros(20, 3, 3))


def test_points_on_a_line_and_in_a_plane_have_finite_frames():
    line = torch.linspace(0, 1, 30)[:, None] * torch.tensor([[1.0, 0, 0]])
    grid = torch.cartesian_prod(torch.arange(6.0), torch.arange(6.0)) * 0.2
    for points in (line, torch.cat([grid, torch.zeros(36, 1)], dim=1)):
        cloud = tr.Clouds(points=points.double().requires_grad_())
        frames = frames_of(cloud)
        assert torch.isfinite(frames).all()
        (gradient,) = torch.autograd.grad(frames.square().mul(torch.arange(9.0).view(3, 3)).sum(), cloud.points)
        assert torch.isfinite(gradient).all()


def test_neighborhoods_without_a_radius_are_refused():
    cloud, near = oriented_room(50)
    with refuses("near"):
        tr.local_frames(cloud, replace(near, radius=None))


@pytest.mark.parametrize("elements", [1 << 17, 40])
def test_gradients_are_those_of_differences(elements):
    cloud = sphere_cloud(12, seed=4)
    near = tr.neighbors(cloud, 2.0, 12)

    def frames(points):
        with pieces(elements):
            return tr.local_frames(replace(cloud, points=points), near)

    points = cloud.points.clone().requires_grad_()
    assert torch.autograd.gradcheck(frames, (points,), atol=1e-6, fast_mode=elements == 40)
    assert same_bits(frames(points).detach(), frames(cloud.points))
