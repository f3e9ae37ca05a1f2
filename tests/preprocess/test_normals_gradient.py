"""Derivatives of normals: those of the least eigenvector, finite where it is open, the value untouched."""

import pytest
import torch
from closeness import close
from determinism import pieces, same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import garbage_in_invalid_slots, numbers, room_pair
from torch.autograd import gradcheck, gradgradcheck

import torchreg as tr

AWAY = torch.tensor([[0.3, -0.2, 9.0]], dtype=torch.float64)


def normals(points, viewpoint=AWAY, max_neighbors=6):
    near = tr.neighbors(tr.Clouds(points=points.detach()), 20.0, max_neighbors)
    viewpoint = None if viewpoint is None else viewpoint.to(points.dtype)
    return tr.estimate_normals(tr.Clouds(points=points, viewpoint=viewpoint), near).normals


CLEAR = {
    "random": numbers(8, 3),
    "planar": numbers(6, 3) * torch.tensor([1.0, 1, 0]),
    "equal larger eigenvalues": torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]),
    "three points": numbers(3, 3),
    "two points face the viewpoint": numbers(2, 3),
}
OPEN = {
    "coincident": torch.ones(5, 3),
    "collinear": torch.arange(5)[:, None] * torch.tensor([[1.0, 2.0, -3.0]]),
    "one": torch.ones(1, 3),
    "at the viewpoint": AWAY,
    "none": torch.zeros(0, 3),
    "octahedron": torch.cat([torch.eye(3), -torch.eye(3)]),
    "equal smaller eigenvalues": torch.tensor([[0.0, 0, 3], [0, 0, -3], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]),
}


@pytest.mark.parametrize("name", CLEAR)
def test_derivatives_are_exact(name):
    points = CLEAR[name].double().requires_grad_()
    assert gradcheck(normals, points)
    assert gradgradcheck(normals, points)


def test_derivatives_reach_a_viewpoint_where_the_normal_is_its_direction():
    assert gradcheck(normals, (numbers(2, 3).requires_grad_(), AWAY.clone().requires_grad_()))


@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")
def test_forward_derivatives_are_exact():
    assert gradcheck(normals, numbers(7, 3).requires_grad_(), check_forward_ad=True, check_backward_ad=False)


@pytest.mark.parametrize("viewpoint", [AWAY, None])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", OPEN)
def test_derivatives_are_finite_where_the_normal_is_open(name, dtype, viewpoint):
    points = OPEN[name].to(dtype).clone().requires_grad_()
    found = normals(points, viewpoint)
    (first,) = torch.autograd.grad(found.sin().sum(), points, create_graph=True)
    (second,) = torch.autograd.grad(first.square().sum(), points, allow_unused=True)
    assert first.isfinite().all()
    assert second is None or second.isfinite().all()


@given(st.integers(0, 2**31), st.integers(1, 8), st.floats(0, 9), st.sampled_from([torch.float32, torch.float64]))
@settings(max_examples=60)
def test_gradients_are_finite_for_points_near_any_degeneracy(seed, rows, thinness, dtype):
    thin = 10.0 ** -torch.tensor([0.0, thinness, 2 * thinness], dtype=torch.float64)
    points = (numbers(rows, 3, seed=seed) * thin).to(dtype).requires_grad_()
    (gradient,) = torch.autograd.grad(normals(points).sin().sum(), points)
    assert gradient.isfinite().all()


def test_a_direction_that_equal_eigenvalues_leave_open_has_no_gradient():
    """On a line every direction across it is a normal: only what turns the line turns the normal."""
    points = OPEN["collinear"].double().requires_grad_()
    found = normals(points)
    along = torch.nn.functional.normalize(points.detach()[1], dim=0)
    across = torch.linalg.cross(along.expand_as(found), found.detach())
    (about_the_line,) = torch.autograd.grad((found * across).sum(), points, retain_graph=True)
    assert close(about_the_line, torch.zeros(()).double(), atol=1e-9)
    (with_the_line,) = torch.autograd.grad((found @ along).sum(), points)
    assert with_the_line.abs().max() > 0.1


def test_moving_the_whole_cloud_changes_no_normal():
    points = numbers(30, 3).requires_grad_()
    (gradient,) = torch.autograd.grad((normals(points) * numbers(30, 3, seed=1)).sum(), points)
    assert gradient.abs().max() > 0.1
    assert close(gradient.sum(dim=0), torch.zeros(3).double(), atol=1e-10)


def test_the_value_has_the_same_bits_with_gradients_and_in_any_pieces():
    scan = room_pair(400).source
    near = tr.neighbors(scan, 0.8, 30)
    expected = tr.estimate_normals(scan, near).normals
    gradients = []
    for elements in (1 << 20, 1000):  # one piece, and many, which are recomputed on the way back
        points = scan.points.clone().requires_grad_()
        with pieces(elements):
            found = tr.estimate_normals(tr.Clouds(points=points, viewpoint=scan.viewpoint), near).normals
            assert same_bits(found.detach(), expected)
            gradients += torch.autograd.grad(found.sin().sum(), points)
    assert gradients[0].isfinite().all()
    assert torch.allclose(gradients[0], gradients[1], rtol=1e-4, atol=1e-4)


def test_garbage_in_invalid_slots_changes_no_gradient():
    scan = room_pair(300, dtype=torch.float64).source
    near = tr.neighbors(scan, 0.5, 30)
    gradients = []
    for around in (near, garbage_in_invalid_slots(near)):
        points = scan.points.clone().requires_grad_()
        found = tr.estimate_normals(tr.Clouds(points=points, viewpoint=scan.viewpoint), around).normals
        gradients += torch.autograd.grad(found.sin().sum(), points)
    assert close(gradients[0], gradients[1], atol=1e-12)


def test_points_that_ask_for_no_gradient_get_none():
    assert not normals(numbers(9, 3)).requires_grad
