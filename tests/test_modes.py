"""Torch's modes do not show: in each of them every stage gives the bits that it gives outside."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace

import pytest
import torch
from problems import room_pair
from refusals import refuses
from stages import STAGES, given
from torch import Tensor

import torchreg as tr

GIVEN = given(500)
WITH_GRADIENTS = {name for name in STAGES if "gradient" in name}
INTERNAL = {"nearest", "surfels"}  # called inside of public functions alone
TAKES_SECONDS = {"register, thorough", "register, the paper's preset"}


@contextmanager
def default_dtype(dtype) -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@contextmanager
def default_device(device) -> Iterator[None]:
    torch.set_default_device(device)
    try:
        yield
    finally:
        torch.set_default_device(None)


@contextmanager
def deterministic() -> Iterator[None]:
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(False)


MODES = {
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "inference mode": torch.inference_mode,
    "float64 by default": lambda: default_dtype(torch.float64),
    "float16 by default": lambda: default_dtype(torch.float16),
    "meta by default": lambda: default_device("meta"),
    "deterministic algorithms": deterministic,
}
LEFT_OUT = {
    "autocast": WITH_GRADIENTS,  # a backward pass belongs outside of autocast, as torch says
    "inference mode": WITH_GRADIENTS,
    "meta by default": WITH_GRADIENTS | INTERNAL | {"nn.Register"},  # whose weights are then made there
}


def leaves(value):
    if is_dataclass(value):
        return [leaf for each in fields(value) if each.name != "seconds" for leaf in leaves(getattr(value, each.name))]
    if isinstance(value, tuple):
        return [leaf for each in value for leaf in leaves(each)]
    return [value.detach().clone() if isinstance(value, Tensor) else value]


def same(one, other):
    if isinstance(one, Tensor):
        return one.dtype == other.dtype and torch.equal(one.nan_to_num(), other.nan_to_num())
    return one == other or (one != one and other != other)


@pytest.mark.parametrize("name", [name for name in STAGES if name not in TAKES_SECONDS])
def test_no_mode_changes_a_bit_of_a_stage(name):
    expected = leaves(STAGES[name].run(GIVEN))
    for mode, entered in MODES.items():
        if name in LEFT_OUT.get(mode, ()):
            continue
        with entered():
            result = leaves(STAGES[name].run(GIVEN))
        assert len(result) == len(expected), mode
        assert all(map(same, expected, result)), mode


def test_modes_hold_again_afterwards():
    with torch.autocast("cpu", dtype=torch.bfloat16), torch.device("meta"):
        tr.spacing(GIVEN.source)
        assert torch.is_autocast_enabled("cpu")
        assert torch.get_default_device().type == "meta"
        with refuses("radius"):
            tr.neighbors(GIVEN.source, -1.0, 5)
        assert torch.is_autocast_enabled("cpu")


def test_what_was_made_in_inference_mode_can_be_registered_outside():
    pair = room_pair(500)
    with torch.inference_mode():
        source, target = pair.source.to(dtype=torch.float64), pair.target.to(dtype=torch.float64)
    wide = (pair.source.to(dtype=torch.float64), pair.target.to(dtype=torch.float64))
    expected, found = tr.register(*wide), tr.register(source, target)
    assert torch.equal(expected.T_target_source, found.T_target_source)


META = GIVEN.source.to("meta")
READS_VALUES = {
    "register": lambda: tr.register(META, META),
    "verify": lambda: tr.verify(META, META, torch.eye(4)),
    "icp": lambda: tr.icp(META, META, torch.eye(4)),
    "neighbors": lambda: tr.neighbors(META, 1.0, 5),
    "voxel_downsample": lambda: tr.voxel_downsample(META, 1.0),
    "spacing": lambda: tr.spacing(META),
    "register_site": lambda: tr.register_site([META, META]),
    "nn.Register": lambda: tr.nn.Register()(META, META),
}


@pytest.mark.parametrize("name", READS_VALUES)
def test_tensors_without_values_are_refused_where_values_are_read(name):
    with pytest.raises(ValueError, match=r"^\w+: expected a tensor with values, got \(\d+, 3\) float32 on meta: "):
        READS_VALUES[name]()


def test_shapes_alone_are_enough_where_no_value_is_read():
    T = torch.eye(4, device="meta")
    assert tr.transform(META, T).points.is_meta
    assert tr.kabsch(META.points, META.points).shape == (4, 4)
    assert len(tr.random_downsample(META, 40).points) == 40


def test_clouds_can_be_made_on_a_default_device():
    with default_device("meta"):
        cloud = tr.Clouds(torch.rand(5, 3))
    assert cloud.points.is_meta
    assert cloud.lengths == [5]


def test_weights_are_float32_whatever_the_default():
    def names(module):
        return [(name, value.dtype, value.tolist()) for name, value in module.state_dict().items()]

    expected = names(tr.nn.Register())
    with default_dtype(torch.float16):
        assert names(tr.nn.Register()) == expected


def test_functions_of_tensors_go_through_transforms():
    torch.manual_seed(0)
    source, target = torch.rand(3, 9, 3, dtype=torch.float64), torch.rand(3, 9, 3, dtype=torch.float64)
    by_vmap = torch.func.vmap(tr.kabsch)(source, target)
    assert torch.allclose(by_vmap, tr.kabsch(source, target), atol=1e-12)

    def moved(points):
        return tr.kabsch(points, target[0])[:3, 3].sum()

    plain = source[0].clone().requires_grad_()
    moved(plain).backward()
    assert torch.allclose(torch.func.grad(moved)(source[0]), plain.grad, atol=1e-12)
    assert torch.allclose(torch.func.jacrev(moved)(source[0]), plain.grad, atol=1e-12)


@pytest.mark.parametrize("describe", ["fpfh", "pcfh", "pfh", "pfhrgb", "shape_context"])
def test_soft_descriptors_go_through_transforms(describe):
    cloud = replace(GIVEN.oriented.to(dtype=torch.float64))

    def total(points, colors):
        given = replace(cloud, points=points, colors=colors)
        return getattr(tr, describe)(given, GIVEN.near, binning="soft").values.square().sum() / 1e4

    points, colors = cloud.points.clone().requires_grad_(), cloud.colors.clone().requires_grad_()
    total(points, colors).backward()
    found = torch.func.grad(total, argnums=(0, 1))(cloud.points, cloud.colors)
    for one, other in zip(found, (points.grad, colors.grad), strict=True):
        assert torch.allclose(one, torch.zeros_like(one) if other is None else other, atol=1e-6)


def test_soft_matches_go_through_transforms():
    features, other = GIVEN.features, GIVEN.other_features

    def total(values):
        (confidence,) = tr.soft_match(replace(features, values=values), other, dustbin=-0.1).confidence
        return confidence.square().sum()

    plain = features.values.clone().requires_grad_()
    total(plain).backward()
    assert torch.allclose(torch.func.grad(total)(features.values), plain.grad, atol=1e-5)
