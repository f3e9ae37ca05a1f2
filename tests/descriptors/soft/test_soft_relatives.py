"""Soft PFH, PFHRGB and shape contexts: the hard ones in the limit, true derivatives, and the same bits however cut."""

import pytest
import torch
from closeness import close
from determinism import assert_nothing_shows, same_bits
from gradients import FEW, TROUBLE, assert_derivatives, finite_gradients, leaves, small
from problems import garbage_in_invalid_slots, numbers, oriented_room, sphere_cloud

import torchreg as tr

SOFT = {"pfh": tr.pfh, "pfhrgb": tr.pfhrgb, "shape context": tr.shape_context}
every_one = pytest.mark.parametrize("describe", SOFT.values(), ids=SOFT)


def of_leaves(describe, near, **options):
    """The values of points, normals and colors; shape contexts get frames that are no rotations, but close."""

    def function(points, normals, colors):
        cloud = tr.Clouds(points=points, normals=normals, colors=colors)
        words = dict(options)
        if describe is tr.shape_context:
            words["frames"] = torch.stack([normals.roll(1, dims=1), normals.roll(2, dims=1), normals], dim=1)
        return describe(cloud, near, binning="soft", **words).values

    return function


def mixed(function, width=4):
    """A few sums of the values by random weights: fewer derivatives to compare, and none left out."""

    def of_inputs(*inputs):
        values = function(*inputs)
        return values @ numbers(values.shape[1], width, seed=3).to(values)

    return of_inputs


@every_one
def test_a_narrow_bandwidth_gives_the_hard_histogram(describe):
    cloud = sphere_cloud(100)
    near = tr.neighbors(cloud, 0.7, 30)
    hard, narrow = describe(cloud, near), describe(cloud, near, binning="soft", bandwidth=1e-9)
    assert close(hard.values / hard.values.max(), narrow.values / hard.values.max(), atol=1e-5)
    assert torch.equal(hard.valid, narrow.valid)


@pytest.mark.parametrize("describe", [tr.pfh, tr.pfhrgb])
def test_every_half_keeps_its_sum(describe):
    cloud, near = oriented_room(300)
    features = describe(cloud, near, binning="soft", bandwidth=0.6)
    sums = features.values.view(len(near), -1, 125).sum(dim=2)[features.valid]
    assert torch.allclose(sums, torch.tensor(100.0 if describe is tr.pfh else 200.0), rtol=1e-5)


@every_one
@pytest.mark.parametrize("options", [{}, {"bandwidth": 0.5}])
def test_derivatives_are_true(describe, options):
    cloud = small()
    near = tr.neighbors(cloud, 3.0, FEW)
    assert_derivatives(mixed(of_leaves(describe, near, **options)), leaves(cloud, near)[:3])


@every_one
@pytest.mark.parametrize("trouble", TROUBLE)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_derivatives_are_finite_in_trouble(describe, trouble, dtype):
    cloud = TROUBLE[trouble]().to(dtype=dtype)
    near = tr.neighbors(cloud, 9.0, FEW)
    assert finite_gradients(of_leaves(describe, near), leaves(cloud, near)[:3])


@every_one
def test_neither_threads_nor_pieces_nor_garbage_change_a_bit_of_values_or_gradients(describe):
    cloud, near = oriented_room(150)
    assert not near.valid.all()

    def run(near=near):
        inputs = tuple(value.clone().requires_grad_() for value in (cloud.points, cloud.normals, cloud.colors))
        values = of_leaves(describe, near)(*inputs)
        gradients = torch.autograd.grad(values.square().sum(), inputs, allow_unused=True, materialize_grads=True)
        return values.detach(), *gradients

    assert_nothing_shows(run)
    assert same_bits(run(), run(garbage_in_invalid_slots(near)))


@every_one
def test_an_empty_cloud_has_no_rows(describe):
    empty = tr.Clouds(points=torch.zeros(0, 3), normals=torch.zeros(0, 3), colors=torch.zeros(0, 3))
    near = tr.neighbors(empty, 1.0, 5)
    width = describe(empty, near).values.shape[1]
    assert describe(empty, near, binning="soft").values.shape == (0, width)
    assert width in (125, 250, 1980)
