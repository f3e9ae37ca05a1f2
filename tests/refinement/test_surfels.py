"""Surfels lie on the surface nearer than the points do, stand evenly, and belong to their cloud alone."""

import pytest
import torch
from determinism import THREADS, assert_batch_equals_loop, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import numbers, random_points, room_pair, seeded, turned, uniform
from refusals import refuses

import torchreg as tr
from torchreg.geometry.morton import morton_order
from torchreg.refinement.surfels import Surfels, cube_edge, surfels_of

NOISE = 0.01
COUNTS = (300, 1000)


def noisy_plane(count=20_000, seed=0, tilt=None):
    """Points (P, 3) float64 of a plane of 4 x 3 m through the origin, with noise across it, and its normal (3,)."""
    g = seeded(seed)
    points = (torch.rand(count, 3, generator=g, dtype=torch.float64) - 0.5) * torch.tensor([4.0, 3.0, 0.0])
    points[:, 2] = NOISE * torch.randn(count, generator=g, dtype=torch.float64)
    R = (turned(0.0) if tilt is None else turned(*tilt))[:3, :3]
    return points @ R.T, R[:, 2]


def tensors(surfels):
    return surfels.cloud.points, surfels.cloud.normals, surfels.variance


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("tilt", [None, (90.0, (1.0, 0.0, 0.0)), (35.0, (1.0, 2.0, 0.3))])
def test_on_a_noisy_plane_they_lie_on_it_and_face_as_it_does(count, tilt):
    points, normal = noisy_plane(tilt=tilt)
    made = surfels_of(tr.Clouds(points=points), count)
    away = made.cloud.points @ normal
    assert float(away.square().mean().sqrt()) < 0.3 * NOISE
    assert abs(float(away.mean())) < 0.05 * NOISE  # wherever the cubes of the grid cut the plane
    assert float((made.cloud.normals @ normal).abs().min()) > 0.95
    assert float(((made.cloud.normals @ normal).abs() > 0.99).double().mean()) > 0.9
    assert torch.allclose(made.cloud.normals.norm(dim=1), torch.ones((), dtype=torch.float64))


def test_the_variance_is_that_of_the_points_across_the_plane():
    points, _ = noisy_plane(600)
    made = surfels_of(tr.Clouds(points=points), 600)  # a surfel for each point
    assert float(made.variance.mean().sqrt()) == pytest.approx(NOISE, rel=0.15)


@pytest.mark.parametrize("count", COUNTS)
def test_their_number_is_near_the_budget_and_their_spacing_even(count):
    made = surfels_of(tr.Clouds(points=noisy_plane()[0]), count)
    assert 0.7 * count < len(made.cloud.points) < 2 * count  # a layer of cubes may end within the plane's noise
    assert made.spacing[0] == pytest.approx((12 / count) ** 0.5, rel=0.25)
    nearest = torch.cdist(noisy_plane()[0], made.cloud.points).amin(dim=1)
    assert float(nearest.max()) < 1.5 * made.spacing[0]


def test_edges_and_woods():
    ball = torch.nn.functional.normalize(numbers(4000, 3), dim=1)
    wood = 3 * torch.rand(4000, 3, generator=seeded(1), dtype=torch.float64)
    round_ones = surfels_of(tr.Clouds(points=ball), 4000)
    assert len(round_ones.cloud.points) > 3500  # 16 neighbors of a ball are flat enough
    few = surfels_of(tr.Clouds(points=wood), 4000)
    assert len(few.cloud.points) == pytest.approx(0.2 * 4000, abs=1)  # the flattest ones, where few are flat


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.sampled_from([100, 400, 5000]))
def test_the_order_of_points_does_not_matter(seed, count):
    cloud = room_pair(1500, seed=7, dtype=torch.float64).source
    order = torch.randperm(len(cloud.points), generator=seeded(seed))
    one, other = surfels_of(cloud, count), surfels_of(cloud.rows(order, cloud.offsets), count)
    assert one.spacing == pytest.approx(other.spacing, rel=1e-9)
    torch.testing.assert_close(one.cloud.points, other.cloud.points, atol=1e-9, rtol=0)
    torch.testing.assert_close(one.variance, other.variance, atol=1e-10, rtol=1e-6)
    assert float((one.cloud.normals * other.cloud.normals).sum(dim=1).abs().min()) > 1 - 1e-6


@pytest.mark.parametrize("count", [100, 5000])
def test_they_stand_along_a_z_curve(count):
    made = surfels_of(room_pair(1500).source, count)
    points = made.cloud.points
    along = points[morton_order(points, made.cloud.offsets)]
    assert float(points.diff(dim=0).norm(dim=1).mean()) < 1.3 * float(along.diff(dim=0).norm(dim=1).mean())


@pytest.mark.parametrize("count", [100, 400, 5000])
def test_a_batch_equals_the_loop(count):
    clouds = [room_pair(size, seed=size).source for size in (900, 300, 40)]
    assert_batch_equals_loop(lambda cloud: tensors(surfels_of(cloud, count)), clouds)
    for number in THREADS:
        with threads(number):
            assert same_bits(surfels_of(clouds[0], count), surfels_of(tr.Clouds.pack(clouds), count).unpack()[0])


@pytest.mark.parametrize("count", [1, 3, 100])
@pytest.mark.parametrize(
    "points",
    [
        torch.zeros(0, 3),
        torch.zeros(1, 3),
        random_points(5),
        torch.full((40, 3), 3.0),
        torch.full((400, 3), 3.0),
        torch.tensor([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]).repeat(300, 1),
        uniform(500, 1) * torch.tensor([[1.0, 2.0, 3.0]]),
        uniform(50, 1) * torch.tensor([[1.0, -2.0, 3.0]]) + 100,
    ],
    ids=["none", "one", "five", "coincident", "many coincident", "two places", "a line", "a line far off"],
)
def test_where_there_is_no_plane_there_are_none(points, count):
    made = surfels_of(tr.Clouds(points=points), count)
    assert len(made.cloud.points) == 0
    assert made.cloud.normals.shape == (0, 3)
    assert len(made.variance) == 0


def test_points_given_many_times_are_one():
    points = noisy_plane(900)[0]
    once = surfels_of(tr.Clouds(points=points), 1000)
    often = surfels_of(tr.Clouds(points=points.repeat(4, 1)), 1000)
    torch.testing.assert_close(often.cloud.points, once.cloud.points, atol=1e-4, rtol=0)
    assert often.spacing == pytest.approx(once.spacing, rel=1e-3)


def test_a_stray_point_far_away_does_no_harm():
    points = torch.cat([noisy_plane()[0], torch.tensor([[2e6, -3e5, 7.0]], dtype=torch.float64)])
    made = surfels_of(tr.Clouds(points=points), 1000)
    assert bool(torch.isfinite(made.cloud.points).all())
    near = made.cloud.points.norm(dim=1) < 10
    assert bool(near.any())
    assert float(made.cloud.points[near, 2].abs().max()) < 3 * NOISE


def test_far_coordinates_lose_nothing():
    points = noisy_plane(5000)[0]
    shift = torch.tensor([1_000_000.0, -2_000_000.0, 500.0], dtype=torch.float64)
    here, there = (surfels_of(tr.Clouds(points=each), 500) for each in (points, points + shift))
    torch.testing.assert_close(there.cloud.points - shift, here.cloud.points, atol=1e-7, rtol=0)
    torch.testing.assert_close(there.variance, here.variance, atol=1e-9, rtol=1e-5)
    origin = shift[None]
    moved = surfels_of(tr.Clouds(points=points, origin=origin), 500)
    assert same_bits(moved.cloud.points, here.cloud.points)
    assert torch.equal(moved.cloud.origin, origin)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_dtype_and_colors_are_the_clouds(dtype):
    cloud = room_pair(2000, dtype=dtype).source
    made = surfels_of(cloud, 300)
    assert {each.dtype for each in (*tensors(made), made.cloud.colors)} == {dtype}
    assert made.cloud.viewpoint is not None
    assert surfels_of(tr.Clouds(points=cloud.points), 300).cloud.colors is None


def test_colors_are_means():
    points = noisy_plane()[0]
    colors = (points / torch.tensor([4.0, 3.0, 1.0]) + 0.5).clamp(0, 1)
    colors[:, 2] = 0.25
    made = surfels_of(tr.Clouds(points=points, colors=colors), 500)
    expected = made.cloud.points / torch.tensor([4.0, 3.0, 1.0]) + 0.5  # which is linear: a mean has the mean's color
    torch.testing.assert_close(made.cloud.colors[:, :2], expected[:, :2], atol=1e-9, rtol=0)
    torch.testing.assert_close(made.cloud.colors[:, 2], torch.full_like(expected[:, 2], 0.25))


def test_normals_that_are_given_do_not_count():
    points = noisy_plane(800)[0]
    wrong = torch.nn.functional.normalize(numbers(800, 3), dim=1)
    assert same_bits(
        surfels_of(tr.Clouds(points=points, normals=wrong), 300), surfels_of(tr.Clouds(points=points), 300)
    )


def test_batches_come_apart_and_together():
    made = surfels_of(tr.Clouds.pack([room_pair(size, seed=size).source for size in (500, 3, 700)]), 300)
    parts = made.unpack()
    assert [len(part) for part in parts] == [1, 1, 1]
    assert same_bits(Surfels.pack(parts), made)
    assert same_bits(made.to("cpu"), made)
    left = made.without([True, False, False])
    assert left.cloud.lengths[0] == 0
    assert same_bits(tensors(left.unpack()[2]), tensors(parts[2]))
    assert same_bits(made.without([False] * 3), made)
    assert not made.cloud.points.requires_grad


def test_what_does_not_fit_is_refused():
    made = surfels_of(room_pair(500).source, 100)
    with refuses("cloud", "normals", "none"):
        Surfels(room_pair(500).source, made.variance, made.spacing)
    with refuses("variance", str(tuple(made.variance.shape))):
        Surfels(made.cloud, made.variance[1:], made.spacing)
    with refuses("spacing", "one per cloud (1)"):
        Surfels(made.cloud, made.variance, ())


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.sampled_from([10, 60, 250]), st.sampled_from([2, 3]))
def test_cubes_of_the_edge_hold_about_the_budget(seed, count, dimensions):
    points = torch.rand(3000, 3, generator=seeded(seed), dtype=torch.float64)
    points[:, dimensions:] = 0
    edge = cube_edge(points, count)
    filled = len(((points - points.amin(dim=0)) / edge).floor().long().unique(dim=0))
    assert count / 3 < filled < 3 * count


def test_no_more_points_than_the_budget_need_no_cubes():
    assert cube_edge(random_points(50), 50) is None
    assert cube_edge(random_points(51), 50) is not None
    assert cube_edge(torch.zeros(9, 3), 3) > 0
