"""Derivatives of the best transform: exact where it is unique, finite where it is not, the value untouched."""

import pytest
import torch
from closeness import close
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import numbers, random_transform
from torch.autograd import gradcheck, gradgradcheck

import torchreg as tr

CUBE = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0], dtype=torch.float64)] * 3)
OCTAHEDRON = torch.cat([torch.eye(3), -torch.eye(3)]).double()
LINE = torch.arange(5, dtype=torch.float64)[:, None] * torch.tensor([[1.0, 2, -1]])
MIRROR = torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
FLAT = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)


def moved(points, seed=0):
    T = random_transform(torch.Generator().manual_seed(seed))
    return points @ T[:3, :3].t() + T[:3, 3]


UNIQUE = {
    "noisy": (numbers(6, 3), numbers(6, 3, seed=1)),
    "exact": (numbers(6, 3), moved(numbers(6, 3))),
    "mirrored": (numbers(6, 3), moved(numbers(6, 3) * MIRROR)),
    "planar": (numbers(5, 3) * FLAT, moved(numbers(5, 3) * FLAT)),
    "planar and noisy": (numbers(5, 3) * FLAT, moved(numbers(5, 3, seed=1) * FLAT)),
    "triangle": (numbers(3, 3), numbers(3, 3, seed=1)),
    "equal singular values, cube": (CUBE, moved(CUBE)),
    "equal singular values, octahedron": (OCTAHEDRON, moved(OCTAHEDRON)),
    "two equal singular values": (OCTAHEDRON * FLAT, moved(OCTAHEDRON * FLAT)),
    "a batch": (numbers(2, 4, 3), numbers(2, 4, 3, seed=1)),
}
OPEN = {
    "collinear": (LINE, moved(LINE)),
    "coincident": (torch.ones(4, 3).double(), torch.full((4, 3), 2.0).double()),
    "one point": (numbers(1, 3), numbers(1, 3, seed=1)),
    "two points": (numbers(2, 3), numbers(2, 3, seed=1)),
    "no point": (numbers(0, 3), numbers(0, 3)),
    "mirrored cube": (CUBE, moved(CUBE * MIRROR)),
    "one side in one place": (numbers(5, 3), torch.zeros(5, 3).double()),
    "as small as numbers get": (1e-160 * numbers(4, 3), 1e-160 * numbers(4, 3, seed=1)),
}


def with_weights(source, target, seed=3):
    weights = numbers(*source.shape[:-1], seed=seed).abs() + 0.1
    return [value.clone().requires_grad_() for value in (source, target, weights)]


def derivatives(inputs):
    """First and second derivatives of a number made of all entries."""
    T = tr.kabsch(*inputs)
    first = torch.autograd.grad((T * T.detach().cos()).sum() + T.sin().sum(), inputs, create_graph=True)
    second = torch.autograd.grad(sum(part.square().sum() for part in first), inputs)
    return T, first, second


@pytest.mark.parametrize("name", UNIQUE)
def test_first_derivatives_are_exact(name):
    assert gradcheck(tr.kabsch, with_weights(*UNIQUE[name]))


@pytest.mark.parametrize("name", UNIQUE)
def test_second_derivatives_are_exact(name):
    assert gradgradcheck(tr.kabsch, with_weights(*UNIQUE[name]))


@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")
@pytest.mark.parametrize("name", ["noisy", "mirrored", "equal singular values, cube"])
def test_forward_derivatives_are_exact(name):
    assert gradcheck(tr.kabsch, with_weights(*UNIQUE[name]), check_forward_ad=True, check_backward_ad=False)


@pytest.mark.parametrize("name", OPEN)
def test_derivatives_are_finite_where_the_rotation_is_open(name):
    T, first, second = derivatives(with_weights(*OPEN[name]))
    assert T.isfinite().all()
    for part in (*first, *second):
        assert part.isfinite().all()


@pytest.mark.parametrize("name", UNIQUE)
def test_rows_of_weight_zero_and_no_weight_at_all_have_finite_gradients(name):
    source, target, weights = with_weights(*UNIQUE[name])
    for kept in ((torch.arange(weights.shape[-1]) < 2).double(), torch.zeros(weights.shape[-1]).double()):
        part = (weights.detach() * kept).requires_grad_()
        gradients = torch.autograd.grad(tr.kabsch(source, target, part).sin().sum(), (source, target, part))
        assert all(one.isfinite().all() for one in gradients)
        if not kept.any():
            assert all(one.eq(0).all() for one in gradients)


def test_a_turn_that_the_points_leave_open_has_no_gradient():
    for source, target in ((LINE, moved(LINE)), (numbers(2, 3), moved(numbers(2, 3)))):
        source = source.clone().requires_grad_()
        R = tr.kabsch(source, target)[:3, :3]
        axis = torch.nn.functional.normalize(target[1] - target[0], dim=0)
        about_axis = torch.linalg.cross(axis.expand(3, 3), R.detach().t()).t()  # of R, turned about the line
        (gradient,) = torch.autograd.grad((about_axis * R).sum(), source)
        assert close(gradient, torch.zeros(()).double(), atol=1e-12)


def test_points_on_a_line_still_turn_the_line():
    """Every best rotation takes the direction of the source line to that of the target line."""
    target = LINE.clone().requires_grad_()
    towards = tr.kabsch(LINE, target)[:3, :3] @ LINE[1]
    (gradient,) = torch.autograd.grad(towards @ torch.tensor([2.0, -1, 0]).double(), target)
    across = torch.tensor([[2.0, -1, 0]]).double()
    # the ends of the line, moved across it in opposite directions, turn it
    share = (LINE - LINE.mean(dim=0)) @ LINE[1] / (LINE - LINE.mean(dim=0)).square().sum()
    assert close(gradient, share[:, None] * across, atol=1e-9)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", {**UNIQUE, **OPEN})
def test_the_value_is_the_same_with_and_without_gradients(name, dtype):
    source, target, weights = with_weights(*{**UNIQUE, **OPEN}[name])
    inputs = [value.detach().to(dtype).requires_grad_() for value in (source, target, weights)]
    found = tr.kabsch(*inputs)
    with torch.no_grad():
        assert torch.equal(found, tr.kabsch(*inputs))
    assert torch.equal(found, tr.kabsch(*(value.detach() for value in inputs)))


@given(st.integers(0, 2**31), st.integers(1, 6), st.floats(0, 8), st.sampled_from([torch.float32, torch.float64]))
@settings(max_examples=60)
def test_gradients_are_finite_for_points_near_any_degeneracy(seed, rows, thinness, dtype):
    thin = 10.0 ** -torch.tensor([0.0, thinness, 2 * thinness], dtype=torch.float64)
    source, target = numbers(rows, 3, seed=seed) * thin, moved(numbers(rows, 3, seed=seed + 1) * thin, seed)
    inputs = [value.detach().to(dtype).requires_grad_() for value in with_weights(source, target)]
    _, first, _ = derivatives(inputs)
    assert all(part.isfinite().all() for part in first)


def test_gradients_agree_with_those_through_the_decomposition_where_it_has_any():
    source, target, weights = with_weights(*UNIQUE["noisy"])
    share = weights[:, None] / weights.sum()
    p, q = (side - (share * side).sum(dim=0) for side in (source, target))
    u, _, vh = torch.linalg.svd((share * p).t() @ q)
    flip = torch.diag(torch.stack([torch.ones(()), torch.ones(()), torch.det(u @ vh).detach().sign()]).double())
    through = torch.autograd.grad((vh.t() @ flip @ u.t()).sin().sum(), (source, target, weights))
    ours = torch.autograd.grad(tr.kabsch(source, target, weights)[:3, :3].sin().sum(), (source, target, weights))
    assert all(close(one, other, atol=1e-10) for one, other in zip(ours, through, strict=True))


def test_a_gradient_can_be_mapped_over_a_batch():
    source, target = numbers(3, 5, 3), numbers(5, 3, seed=1)

    def number(points):
        return tr.kabsch(points, target).sin().sum()

    one_by_one = torch.stack([torch.func.grad(number)(points) for points in source])
    assert close(torch.func.vmap(torch.func.grad(number))(source), one_by_one, atol=1e-12)
    together = torch.func.grad(lambda points: torch.func.vmap(number)(points).sum())(source)
    assert close(together, one_by_one, atol=1e-12)
