"""Soft FPFH: the hard one in the limit, with true derivatives, finite everywhere, and the same bits however cut."""

import pytest
import torch
from closeness import close
from determinism import assert_nothing_shows, pieces, same_bits
from gradients import FEW, TROUBLE, assert_derivatives, changed, finite_gradients, leaves, small
from problems import garbage_in_invalid_slots, numbers, oriented_room, sphere_cloud
from refusals import refuses

import torchreg as tr

EDGES = torch.linspace(0, 1, 12, dtype=torch.float64).repeat(3, 1)


def soft(cloud, near, **options):
    return tr.fpfh(cloud, near, binning="soft", **options)


def of_leaves(near, **options):
    def function(points, normals, colors, weights):
        return soft(tr.Clouds(points=points, normals=normals), near, neighbor_weights=weights, **options).values

    return function


@pytest.mark.parametrize("mode", ["open3d", "pcl"])
@pytest.mark.parametrize("made", [lambda: sphere_cloud(400), lambda: oriented_room(dtype=torch.float64)[0]])
def test_a_narrow_bandwidth_gives_the_hard_histogram(mode, made):
    cloud = made()
    near = tr.neighbors(cloud, 0.7, 40)
    hard, narrow = tr.fpfh(cloud, near, mode=mode), soft(cloud, near, mode=mode, bandwidth=1e-9)
    assert (hard.values - narrow.values).abs().max() < 1e-3
    assert torch.equal(hard.valid, narrow.valid)


def test_narrowing_converges_in_float32_too():
    cloud, near = oriented_room()
    hard = tr.fpfh(cloud, near).values
    far = [((soft(cloud, near, bandwidth=b).values - hard).abs() > 1e-3).float().mean() for b in (1.0, 1e-2, 1e-4)]
    assert far[0] > 0.5
    assert far[1] < 0.3
    assert far[2] < 0.01


@pytest.mark.parametrize(("mode", "block"), [("open3d", 200), ("pcl", 100)])
@pytest.mark.parametrize("bandwidth", [1.0, 0.3])
def test_every_block_keeps_its_sum(mode, block, bandwidth):
    cloud, near = oriented_room()
    features = soft(cloud, near, mode=mode, bandwidth=bandwidth)
    sums = features.values.view(-1, 3, 11).sum(dim=2)[features.valid]
    assert torch.allclose(sums, torch.tensor(float(block)), rtol=1e-5)
    assert features.values.min() >= 0


def test_equal_edges_and_equal_weights_are_the_default():
    cloud = sphere_cloud(150)
    near = tr.neighbors(cloud, 0.7, 30)
    for bandwidth in (1.0, 0.4):
        plain = soft(cloud, near, bandwidth=bandwidth).values
        given = soft(cloud, near, bandwidth=bandwidth, edges=EDGES, neighbor_weights=torch.full(near.index.shape, 0.3))
        assert close(given.values, plain, atol=1e-5)


def test_a_neighbor_of_weight_zero_is_as_good_as_absent():
    cloud = sphere_cloud(150)
    near = tr.neighbors(cloud, 0.7, 30)
    weights = (numbers(*near.index.shape) > 0).double()
    fewer = tr.Neighborhoods(near.index, near.valid & (weights > 0), near.sq_distance)
    assert close(soft(cloud, near, neighbor_weights=weights).values, soft(cloud, fewer).values, atol=1e-9)


def test_values_move_continuously_with_the_points():
    cloud = sphere_cloud(200)
    near = tr.neighbors(cloud, 0.7, 30)
    step = numbers(200, 3)

    def far(scale):
        moved = changed(cloud, points=cloud.points + scale * step)
        return (soft(moved, near).values - soft(cloud, near).values).abs().max()

    assert far(1e-6) < 0.05
    assert far(1e-9) < 5e-5


@pytest.mark.parametrize("options", [{}, {"bandwidth": 0.5}, {"mode": "pcl"}])
def test_derivatives_are_true(options):
    cloud = small()
    near = tr.neighbors(cloud, 9.0, FEW)
    inputs = leaves(cloud, near)
    inputs = (inputs[0], inputs[1], cloud.colors, inputs[3])
    assert_derivatives(of_leaves(near, **options), inputs)


def test_derivatives_with_respect_to_edges_are_true():
    cloud = small()
    near = tr.neighbors(cloud, 9.0, FEW)
    width = (numbers(3, 11).abs() + 0.5).requires_grad_()

    def function(width):
        inner = (width.cumsum(1) / width.sum(1, keepdim=True))[:, :-1]
        edges = torch.cat([torch.zeros(3, 1), inner, torch.ones(3, 1)], dim=1)
        return soft(cloud, near, edges=edges).values

    assert_derivatives(function, (width,))


def test_the_derivative_by_hand_is_that_of_autograd():
    cloud = sphere_cloud(120)
    near = tr.neighbors(cloud, 0.8, 25)
    for bandwidth in (1.0, 0.4):
        inputs = leaves(cloud, near)
        values = of_leaves(near, bandwidth=bandwidth)(*inputs)
        grad, asked = numbers(*values.shape), (inputs[0], inputs[1], inputs[3])
        by_hand = torch.autograd.grad(values, asked, grad, retain_graph=True)
        by_autograd = torch.autograd.grad(values, asked, grad, create_graph=True)
        for one, other in zip(by_hand, by_autograd, strict=True):
            assert close(one, other, atol=1e-11 * float(other.detach().abs().max()))


@pytest.mark.parametrize("trouble", TROUBLE)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_derivatives_are_finite_in_trouble(trouble, dtype):
    cloud = TROUBLE[trouble]().to(dtype=dtype)
    near = tr.neighbors(cloud, 9.0, FEW)
    inputs = leaves(cloud, near)
    assert finite_gradients(of_leaves(near), (*inputs[:3], inputs[3].to(dtype).detach().requires_grad_()))


@pytest.mark.parametrize("trouble", ["twins", "one place", "normals of length zero"])
def test_derivatives_in_trouble_are_those_of_what_is_defined(trouble):
    """Coincident points and missing normals hold still: what may move is the rest."""
    cloud = TROUBLE[trouble]()
    near = tr.neighbors(cloud, 9.0, FEW)
    _, _, colors, weights = leaves(cloud, near)
    assert_derivatives(lambda w: of_leaves(near)(cloud.points, cloud.normals, colors, w), (weights,))


def test_garbage_in_invalid_slots_changes_nothing():
    cloud, near = oriented_room()
    assert not near.valid.all()

    def run(near):
        points = cloud.points.clone().requires_grad_()
        values = soft(changed(cloud, points=points), near).values
        return values.detach(), torch.autograd.grad(values.square().sum(), points)[0]

    assert same_bits(run(near), run(garbage_in_invalid_slots(near)))


@pytest.mark.parametrize("options", [{}, {"bandwidth": 0.5, "edges": EDGES, "weighted": True}])
def test_neither_threads_nor_pieces_change_a_bit_of_values_or_gradients(options):
    cloud, near = oriented_room(2500)
    options = dict(options)
    weights = torch.rand(near.index.shape) + 0.5 if options.pop("weighted", False) else None

    def run():
        points, normals = (value.clone().requires_grad_() for value in (cloud.points, cloud.normals))
        values = soft(tr.Clouds(points=points, normals=normals), near, neighbor_weights=weights, **options).values
        return values.detach(), *torch.autograd.grad(values.square().sum(), (points, normals))

    assert_nothing_shows(run)


def test_one_row_at_a_time_gives_the_same_bits():
    cloud, near = oriented_room(150)
    expected = soft(cloud, near)
    with pieces(1):
        assert same_bits(soft(cloud, near), expected)


def test_an_empty_cloud_has_no_rows():
    empty = tr.Clouds(points=torch.zeros(0, 3), normals=torch.zeros(0, 3))
    assert soft(empty, tr.neighbors(empty, 1.0, 5)).values.shape == (0, 33)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")  # torch.func.jvp's own
def test_transforms_of_torch_func_give_the_same_derivatives():
    cloud = sphere_cloud(40)
    near = tr.neighbors(cloud, 0.9, 10)

    def total(points):
        return soft(changed(cloud, points=points), near).values.square().sum()

    points = cloud.points.clone().requires_grad_()
    expected = torch.autograd.grad(total(points), points)[0]
    assert close(torch.func.grad(total)(cloud.points), expected, atol=1e-6)
    many = torch.func.vmap(torch.func.grad(total))(torch.stack([cloud.points, cloud.points * 2]))
    assert close(many[0], expected, atol=1e-6)
    _, along = torch.func.jvp(total, (cloud.points,), (torch.ones_like(cloud.points),))
    assert close(along, expected.sum(), atol=1e-6)


def test_what_does_not_fit_is_refused():
    cloud, near = oriented_room(100)
    with refuses("bandwidth", "(0, 1]", "0"):
        soft(cloud, near, bandwidth=0)
    with refuses("bandwidth", "hard binning"):
        tr.fpfh(cloud, near, bandwidth=0.5)
    with refuses("edges", "hard binning"):
        tr.fpfh(cloud, near, edges=EDGES)
    with refuses("edges", "3", "12"):
        soft(cloud, near, edges=EDGES[:2])
    with refuses("edges", "ascend"):
        soft(cloud, near, edges=EDGES.flip(1))
    with refuses("edges", "0 to 1"):
        soft(cloud, near, edges=EDGES * 2)
    with refuses("neighbor_weights", "not below 0"):
        soft(cloud, near, neighbor_weights=-torch.ones(near.index.shape))
