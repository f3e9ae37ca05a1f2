"""Soft PCFH: the hard one in the limit, with true derivatives, finite everywhere, and the same bits however cut."""

import pytest
import torch
from closeness import close
from determinism import assert_nothing_shows, pieces, same_bits
from gradients import FEW, TROUBLE, assert_derivatives, changed, finite_gradients, leaves, small
from problems import garbage_in_invalid_slots, numbers, room_pair, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.soft.pcfh import soft_difference

CHANNELS = ("hue", "saturation", "value")


def soft(cloud, near, **options):
    return tr.pcfh(cloud, near, binning="soft", **options)


def of_leaves(near, **options):
    def function(points, normals, colors, weights):
        return soft(tr.Clouds(points=points, colors=colors), near, neighbor_weights=weights, **options).values

    return function


@pytest.mark.parametrize("equalization", ["none", "cloud"])
@pytest.mark.parametrize("weighted", [False, True])
def test_a_narrow_bandwidth_gives_the_hard_histogram(equalization, weighted):
    cloud = sphere_cloud(400)
    near = tr.neighbors(cloud, 0.5, 40)
    options = {"equalization": equalization, "saturation_weighting": weighted, "channels": CHANNELS}
    hard, narrow = tr.pcfh(cloud, near, **options), soft(cloud, near, bandwidth=1e-9, **options)
    # the hard vote by saturation is a whole number of 1/1024
    assert (hard.values - narrow.values).abs().max() < (0.5 if weighted else 1e-3)
    assert torch.equal(hard.valid, narrow.valid)


def test_narrowing_converges_in_float32_too():
    scan = room_pair(600).source
    near = tr.neighbors(scan, 1.0, 40)
    hard = tr.pcfh(scan, near).values
    far = [((soft(scan, near, bandwidth=b).values - hard).abs() > 1e-3).float().mean() for b in (1.0, 1e-2, 1e-4)]
    assert far[0] > 0.5
    assert far[2] <= far[1] < far[0]
    assert far[2] < 0.01


@pytest.mark.parametrize("bins", [1, 3, 11, 33])
def test_a_valid_row_keeps_its_sum(bins):
    scan = room_pair(500).source
    features = soft(scan, tr.neighbors(scan, 1.0, 60), bins=bins)
    assert torch.allclose(features.values.sum(dim=1)[features.valid], torch.tensor(200.0), rtol=1e-5)
    assert not features.values[~features.valid].any()
    assert features.values.min() >= 0


def test_equal_edges_and_equal_weights_are_the_default():
    cloud = sphere_cloud(150)
    near = tr.neighbors(cloud, 0.7, 30)
    edges = torch.linspace(0, 1, 8, dtype=torch.float64).repeat(2, 1)
    options = {"bins": 7, "channels": ("value", "hue")}
    plain = soft(cloud, near, **options).values
    given = soft(cloud, near, edges=edges, neighbor_weights=torch.full(near.index.shape, 0.3), **options)
    assert close(given.values, plain, atol=1e-5)


def test_turning_all_hues_changes_nothing():
    cloud = sphere_cloud(150)
    near = tr.neighbors(cloud, 0.6, 60)
    values = torch.rand(150, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    turned = values.clone()
    turned[:, 0] = (turned[:, 0] + 0.37) % 1
    assert close(soft(cloud, near, values=values).values, soft(cloud, near, values=turned).values, atol=1e-9)


def test_the_difference_of_hues_is_continuous_around_the_circle():
    a = torch.linspace(0, 1, 4001, dtype=torch.float64)
    for other in (0.0, 0.3, 0.5, 0.99):
        difference = soft_difference(a, torch.tensor(other, dtype=torch.float64), circular=True)
        assert difference.min() >= 0
        assert difference.max() <= 1
        assert difference.diff().abs().max() < 2 / 4000 + 1e-12
        assert abs(difference[0] - difference[-1]) < 1e-12


@pytest.mark.parametrize(
    "options",
    [
        {"bins": 4},
        {"bins": 4, "bandwidth": 0.5, "equalization": "none"},
        {"bins": 3, "channels": CHANNELS, "saturation_weighting": True, "equalization": "none"},
    ],
)
def test_derivatives_are_true(options):
    cloud = small()
    near = tr.neighbors(cloud, 9.0, FEW)
    assert_derivatives(of_leaves(near, **options), leaves(cloud, near))


def test_derivatives_with_respect_to_edges_are_true():
    cloud = small()
    near = tr.neighbors(cloud, 9.0, FEW)
    width = (numbers(1, 5).abs() + 0.5).requires_grad_()

    def function(width):
        inner = (width.cumsum(1) / width.sum(1, keepdim=True))[:, :-1]
        edges = torch.cat([torch.zeros(1, 1), inner, torch.ones(1, 1)], dim=1)
        return soft(cloud, near, bins=5, edges=edges, equalization="none").values

    assert_derivatives(function, (width,))


def test_the_derivative_by_hand_is_that_of_autograd():
    cloud = sphere_cloud(120)
    near = tr.neighbors(cloud, 0.8, 25)
    for options in ({}, {"bandwidth": 0.4, "channels": CHANNELS, "saturation_weighting": True}):
        inputs = leaves(cloud, near)
        values = of_leaves(near, **options)(*inputs)
        grad, asked = numbers(*values.shape), (inputs[0], inputs[2], inputs[3])
        by_hand = torch.autograd.grad(values, asked, grad, retain_graph=True)
        by_autograd = torch.autograd.grad(values, asked, grad, create_graph=True)
        for one, other in zip(by_hand, by_autograd, strict=True):
            assert close(one, other, atol=1e-11 * float(other.detach().abs().max()))


@pytest.mark.parametrize("trouble", TROUBLE)
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_derivatives_are_finite_in_trouble(trouble, weighted, dtype):
    cloud = TROUBLE[trouble]().to(dtype=dtype)
    near = tr.neighbors(cloud, 9.0, FEW)
    points, normals, colors, weights = leaves(cloud, near)
    inputs = (points, normals, colors, weights.to(dtype).detach().requires_grad_())
    assert finite_gradients(of_leaves(near, saturation_weighting=weighted, channels=CHANNELS), inputs)


def test_garbage_in_invalid_slots_changes_nothing():
    scan = room_pair(500).source
    near = tr.neighbors(scan, 0.7, 50)
    assert not near.valid.all()

    def run(near):
        colors = scan.colors.clone().requires_grad_()
        values = soft(changed(scan, colors=colors), near, channels=CHANNELS, saturation_weighting=True).values
        return values.detach(), torch.autograd.grad(values.square().sum(), colors)[0]

    assert same_bits(run(near), run(garbage_in_invalid_slots(near)))


def test_neither_threads_nor_pieces_change_a_bit_of_values_or_gradients():
    scan = room_pair(2500).source
    near = tr.neighbors(scan, 1.0, 40)

    def run():
        points, colors = (value.clone().requires_grad_() for value in (scan.points, scan.colors))
        cloud = tr.Clouds(points=points, colors=colors)
        values = soft(cloud, near, channels=CHANNELS, saturation_weighting=True).values
        return values.detach(), *torch.autograd.grad(values.square().sum(), (points, colors))

    assert_nothing_shows(run)
    expected = soft(scan, near)
    with pieces(1):
        assert same_bits(soft(scan, near), expected)


def test_a_batch_equals_the_loop_over_its_clouds():
    made = [room_pair(count, seed=count).source for count in (300, 500, 40)]

    def described(clouds):
        return soft(clouds, tr.neighbors(clouds, 0.9, 40), channels=CHANNELS).values

    assert same_bits(described(tr.Clouds.pack(made)), torch.cat([described(one) for one in made]))


def test_an_empty_cloud_has_no_rows():
    empty = tr.Clouds(points=torch.zeros(0, 3), colors=torch.zeros(0, 3))
    assert soft(empty, tr.neighbors(empty, 1.0, 5)).values.shape == (0, 11)


def test_what_does_not_fit_is_refused():
    scan = room_pair(100).source
    near = tr.neighbors(scan, 1.0, 20)
    with refuses("binning", "'hard', 'soft'", "'firm'"):
        tr.pcfh(scan, near, binning="firm")
    with refuses("neighbor_weights", "hard binning"):
        tr.pcfh(scan, near, neighbor_weights=torch.ones(near.index.shape))
    with refuses("edges", "1", "12"):
        soft(scan, near, edges=torch.linspace(0, 1, 11)[None])
    with refuses("equalization", "'none', 'cloud'"):
        soft(scan, near, equalization="joint")
