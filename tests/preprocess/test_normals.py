"""Normals: right on known surfaces, turned to the scanner, moving with the cloud, the same bits always."""

from dataclasses import replace

import pytest
import torch
from closeness import close
from determinism import assert_batch_equals_loop, assert_nothing_shows, pieces, same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import garbage_in_invalid_slots, plane_cloud, random_rotation, random_transform, room_pair, sphere_cloud
from refusals import refuses

import torchreg as tr

ABOVE = torch.tensor([[0.0, 0.0, 10.0]])


@given(st.integers(0, 2**31))
@settings(max_examples=20)
def test_a_plane_has_one_normal_on_the_side_of_the_viewpoint(seed):
    flat = plane_cloud(80, 2.0, seed=seed)
    T = random_transform(torch.Generator().manual_seed(seed))
    for height in (3.0, -3.0):
        seen = tr.Clouds(points=flat.points.double(), viewpoint=torch.tensor([[1.0, 1.0, height]]).double())
        moved = tr.transform(seen, T)
        found = tr.estimate_normals(moved, tr.neighbors(moved, 1.0, 20)).normals
        expected = (T[:3, 2] * (1 if height > 0 else -1)).expand(80, 3)
        assert close(found, expected, atol=1e-7)


def test_a_sphere_has_its_radius_as_normal():
    direction = torch.nn.functional.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    ball = tr.Clouds(points=direction, viewpoint=torch.zeros(1, 3))
    found = tr.estimate_normals(ball, tr.neighbors(ball, 0.3, 30)).normals
    assert ((found * -direction).sum(dim=1) > 0.97).all()


def test_normals_are_unit_vectors_that_face_the_viewpoint():
    scan = room_pair(3000).source
    found = tr.estimate_normals(scan, tr.neighbors(scan, 0.5, 30)).normals
    length = torch.linalg.vector_norm(found, dim=1)
    assert close(length, torch.ones(()), atol=1e-6)
    assert ((found * (scan.viewpoint - scan.points)).sum(dim=1) >= -1e-5).all()


def test_normals_are_the_least_eigenvectors_of_the_covariance():
    scan = room_pair(1500, dtype=torch.float64).source
    near = tr.neighbors(scan, 0.6, 20)
    found = tr.estimate_normals(scan, near).normals
    for row in range(0, len(scan.points), 37):
        around = scan.points[near.index[row][near.valid[row]]]
        if len(around) < 3:
            continue
        values, vectors = torch.linalg.eigh(torch.cov(around.t()))
        if values[1] - values[0] > 1e-6:
            assert abs(float(vectors[:, 0] @ found[row])) > 1 - 1e-9


def test_the_viewpoint_argument_wins_over_that_of_the_cloud():
    flat = plane_cloud(50, 1.0)
    near = tr.neighbors(flat, 1.0, 10)
    seen = tr.Clouds(points=flat.points, viewpoint=-ABOVE)
    assert (tr.estimate_normals(seen, near).normals[:, 2] < 0).all()
    assert (tr.estimate_normals(seen, near, viewpoint=ABOVE[0]).normals[:, 2] > 0).all()
    assert (tr.estimate_normals(seen, near, viewpoint=ABOVE).normals[:, 2] > 0).all()
    guessed = replace(seen, viewpoint_assumed=torch.tensor([True]))
    assert same_bits(tr.estimate_normals(guessed, near).normals, tr.estimate_normals(seen, near).normals)
    assert tr.estimate_normals(guessed, near).viewpoint_assumed.tolist() == [True]


def test_without_a_viewpoint_normals_face_the_mean_point():
    direction = torch.nn.functional.normalize(torch.randn(500, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    for viewpoint in (None, torch.full((1, 3), float("nan"))):
        ball = tr.Clouds(points=direction + 5, viewpoint=viewpoint)
        found = tr.estimate_normals(ball, tr.neighbors(ball, 0.8, 20)).normals
        assert ((found * direction).sum(dim=1) < 0).all()


@given(st.integers(0, 2**31))
@settings(max_examples=20)
def test_normals_turn_with_the_cloud(seed):
    scan = room_pair(400, seed=1, dtype=torch.float64).source
    near = tr.neighbors(scan, 1.0, 30)
    R = random_rotation(torch.Generator().manual_seed(seed))
    turned = tr.Clouds(points=scan.points @ R.t(), viewpoint=scan.viewpoint @ R.t())
    expected = tr.estimate_normals(scan, near).normals @ R.t()
    found = tr.estimate_normals(turned, near).normals
    clear = near.counts() >= 4  # with three neighbors a thin triangle may have no clear normal
    assert close(found[clear], expected[clear], atol=1e-6)


def test_the_order_of_points_does_not_matter():
    scan = room_pair(800, dtype=torch.float64).source
    order = torch.randperm(len(scan.points), generator=torch.Generator().manual_seed(0))
    shuffled = scan.rows(order, scan.offsets)
    found = tr.estimate_normals(shuffled, tr.neighbors(shuffled, 0.6, 30)).normals
    expected = tr.estimate_normals(scan, tr.neighbors(scan, 0.6, 30)).normals
    assert close(found, expected[order], atol=1e-9)


@pytest.mark.parametrize(
    "points",
    [
        [[1.0, 0, 0]],
        [[1.0, 0, 0], [1, 0.1, 0]],
        [[1.0, 0, 0]] * 5,
    ],
)
def test_too_little_to_go_by_faces_the_viewpoint(points):
    few = tr.Clouds(points=torch.tensor(points), viewpoint=torch.tensor([[1.0, 0, 5]]))
    found = tr.estimate_normals(few, tr.neighbors(few, 1.0, 5)).normals
    assert torch.allclose(found, torch.nn.functional.normalize(few.viewpoint - few.points, dim=1))


def test_a_point_at_the_viewpoint_has_a_normal_too():
    one = tr.Clouds(points=torch.zeros(1, 3), viewpoint=torch.zeros(1, 3))
    assert tr.estimate_normals(one, tr.neighbors(one, 1.0, 3)).normals.tolist() == [[0, 0, 1]]


def test_points_on_a_line_have_normals_across_it():
    line = torch.arange(20.0)[:, None] * torch.tensor([[0.1, 0.2, -0.1]])
    one = tr.Clouds(points=line, viewpoint=torch.tensor([[0.0, 0, 50]]))
    found = tr.estimate_normals(one, tr.neighbors(one, 1.0, 10)).normals
    assert close(torch.linalg.vector_norm(found, dim=1), torch.ones(()), atol=1e-6)
    assert ((found @ line[1]).abs() < 1e-3).all()


def test_garbage_in_invalid_slots_changes_nothing():
    scan = room_pair(600).source
    near = tr.neighbors(scan, 0.4, 40)
    assert not near.valid.all()
    assert same_bits(tr.estimate_normals(scan, near), tr.estimate_normals(scan, garbage_in_invalid_slots(near)))


def test_a_batch_equals_the_loop_over_its_clouds():
    flat = plane_cloud(40, 1.0)
    made = [room_pair(700, seed=seed).source for seed in range(2)]
    made.insert(1, tr.Clouds(points=flat.points, colors=flat.points))
    ball = sphere_cloud(300, dtype=torch.float32)  # without a viewpoint: its own mean point matters, no other
    made.append(tr.Clouds(points=ball.points + 20, colors=ball.colors))

    def oriented(clouds):
        return (tr.estimate_normals(clouds, tr.neighbors(clouds, 0.5, 20)).normals,)

    assert_batch_equals_loop(oriented, made)


def test_neither_threads_nor_pieces_change_a_bit():
    scan = room_pair(6000).source
    near = tr.neighbors(scan, 0.5, 30)
    assert_nothing_shows(lambda: tr.estimate_normals(scan, near))


def test_float32_points_are_worked_on_in_float64():
    scan = room_pair(500).source
    far = tr.Clouds(points=scan.points + 1000)  # differences of such neighbors are exact in float32
    near = tr.neighbors(far, 1.0, 30)
    wide = tr.estimate_normals(far.to(dtype=torch.float64), near)
    assert same_bits(tr.estimate_normals(far, near).normals, wide.normals.float())


def test_one_row_at_a_time_gives_the_same_bits():
    scan = room_pair(150).source
    near = tr.neighbors(scan, 1.0, 30)
    expected = tr.estimate_normals(scan, near)
    with pieces(1):
        assert same_bits(tr.estimate_normals(scan, near), expected)


def test_what_does_not_fit_is_refused():
    flat = plane_cloud(10, 1.0)
    near = tr.neighbors(flat, 1.0, 5)
    with refuses("near", "9", "10"):
        tr.estimate_normals(flat.rows(torch.arange(9), torch.tensor([0, 9])), near)
    with refuses("viewpoint", "(1, 3)", "(2, 3)"):
        tr.estimate_normals(flat, near, viewpoint=torch.zeros(2, 3))
    with refuses("viewpoint", "(1, 3)", "(4,)"):
        tr.estimate_normals(flat, near, viewpoint=torch.zeros(4))
