"""What every module promises: the function's own values, state kept, dtype and device kept, digits under autocast."""

import copy
import io
from dataclasses import replace

import pytest
import torch
from closeness import close
from determinism import same_bits
from problems import sphere_cloud, uniform
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.fuse import rooted
from torchreg.nn import BinEdges

CLOUD = sphere_cloud(40)
NEAR = tr.neighbors(CLOUD, 0.9, 10)
OTHER = sphere_cloud(30, seed=1)


def described(cloud):
    near = tr.neighbors(cloud, 0.9, 10)
    return tr.fuse(tr.fpfh(cloud, near), tr.pcfh(cloud, near))


SOURCE, TARGET = described(CLOUD), described(OTHER)
MATCHES = tr.soft_match(SOURCE, TARGET, temperature=0.05)

MODULES = {
    "FPFH": lambda: (tr.nn.FPFH(), (CLOUD, NEAR)),
    "FPFH with edges": lambda: (tr.nn.FPFH(mode="pcl", learn_edges=True, bandwidth=0.5), (CLOUD, NEAR)),
    "FPFH hard": lambda: (tr.nn.FPFH(binning="hard"), (CLOUD, NEAR)),
    "PCFH": lambda: (tr.nn.PCFH(saturation_weighting=True), (CLOUD, NEAR)),
    "PCFH with edges": lambda: (
        tr.nn.PCFH(bins=7, channels=("hue", "value"), equalization="none", learn_edges=True),
        (CLOUD, NEAR),
    ),
    "PCFH hard": lambda: (tr.nn.PCFH(binning="hard"), (CLOUD, NEAR)),
    "Equalize": lambda: (tr.nn.Equalize(bandwidth=0.5), (CLOUD,)),
    "Fuse": lambda: (tr.nn.Fuse((1.0, 0.5)), (SOURCE, SOURCE)),
    "SoftMatch": lambda: (tr.nn.SoftMatch(), (SOURCE, TARGET)),
    "SoftMatch without a dustbin": lambda: (tr.nn.SoftMatch(dustbin=None), (SOURCE, TARGET)),
    "SoftMatch by Sinkhorn": lambda: (tr.nn.SoftMatch(method="sinkhorn", iterations=5), (SOURCE, TARGET)),
    "WeightedKabsch": lambda: (tr.nn.WeightedKabsch(), (CLOUD, OTHER, MATCHES)),
    "WeightedKabsch in rounds": lambda: (tr.nn.WeightedKabsch(rounds=2, scale=0.3), (CLOUD, OTHER, MATCHES)),
    "Register": lambda: (tr.nn.Register(), (CLOUD, OTHER)),
    "PointNetwork": lambda: (tr.nn.PointNetwork(), (CLOUD, NEAR)),
}
every_module = pytest.mark.parametrize("name", MODULES)


def tensors(value):
    """All floating-point tensors in what a module returns."""
    if isinstance(value, torch.Tensor):
        return [value] if value.is_floating_point() else []
    if isinstance(value, tr.Features):
        return [value.values]
    if isinstance(value, tr.SoftCorrespondences):
        return list(value.confidence)
    if isinstance(value, tr.Clouds):
        return [value.points]
    return [found for part in value for found in tensors(part)]


def cast(value, dtype):
    """Clouds, features and matches with their tensors in another dtype."""
    if isinstance(value, tr.Clouds):
        return value.to(dtype=dtype)
    if isinstance(value, tr.Features):
        return tr.Features(value.values.to(dtype), value.offsets, value.blocks, value.valid)
    if isinstance(value, tr.SoftCorrespondences):
        matrices = tuple(matrix.to(dtype) for matrix in value.confidence)
        return tr.SoftCorrespondences(matrices, value.source_offsets, value.target_offsets)
    return value


def shaken(module):
    """Other weights than those to begin with."""
    with torch.no_grad():
        for seed, weight in enumerate(module.parameters()):
            weight += 0.1 * uniform(*weight.shape, seed=seed).to(weight)
    return module


@every_module
def test_the_state_comes_back_from_a_file(name):
    module, inputs = MODULES[name]()
    shaken(module)
    file = io.BytesIO()
    torch.save(module.state_dict(), file)
    file.seek(0)
    fresh = MODULES[name]()[0]
    fresh.load_state_dict(torch.load(file, weights_only=True))
    for one, other in zip(tensors(module(*inputs)), tensors(fresh(*inputs)), strict=True):
        assert same_bits(one.detach(), other.detach())


@every_module
def test_weights_are_all_that_is_learned_and_all_have_gradients(name):
    module, inputs = MODULES[name]()
    shaken(module)
    assert not list(module.buffers())
    weights = list(module.parameters())
    if weights:
        sum((out * uniform(*out.shape).to(out)).sum() for out in tensors(module(*inputs))).backward()
    for weight in weights:
        assert torch.isfinite(weight.grad).all()
        assert weight.grad.any()


@every_module
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtypes_of_weights_and_inputs_may_differ_and_the_inputs_stays(name, dtype):
    module, inputs = MODULES[name]()
    inputs = [cast(value, dtype) for value in inputs]
    for weights in (torch.float32, torch.float64, torch.bfloat16):
        for out in tensors(module.to(weights)(*inputs)):
            assert out.dtype == dtype or out.shape[-2:] == (4, 4)
            assert torch.isfinite(out).all()


@every_module
def test_geometry_keeps_its_digits_under_autocast(name):
    module, inputs = MODULES[name]()
    inputs = [cast(value, torch.float32) for value in inputs]
    expected = tensors(module(*inputs))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = tensors(module(*inputs))
        assert torch.is_autocast_enabled("cpu")
        assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == torch.bfloat16  # the caller's own setting stands
    for one, other in zip(expected, found, strict=True):
        assert other.dtype == one.dtype
        assert same_bits(one.detach(), other.detach())


@pytest.mark.parametrize("name", ["SoftMatch", "SoftMatch by Sinkhorn", "Fuse"])
@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_half_precision_of_a_network_is_widened(name, dtype):
    module, inputs = MODULES[name]()
    halves = [cast(value, dtype) for value in inputs]
    wide = [cast(value, torch.float32) for value in halves]
    for one, other in zip(tensors(module(*halves)), tensors(module(*wide)), strict=True):
        assert one.dtype == torch.float32
        assert same_bits(one.detach(), other.detach())


@every_module
def test_a_copy_is_independent_and_print_shows_the_options(name):
    module, _ = MODULES[name]()
    other = shaken(copy.deepcopy(module))
    for one, two in zip(module.parameters(), other.parameters(), strict=True):
        assert not torch.equal(one, two)
    assert type(module).__name__ in repr(module)


@pytest.mark.parametrize("binning", ["soft", "hard"])
def test_descriptors_are_the_functions_with_the_modules_options(binning):
    words = {"binning": binning, "bandwidth": 0.5 if binning == "soft" else 1.0}
    weights = uniform(*NEAR.index.shape).double() if binning == "soft" else None
    found = tr.nn.FPFH(mode="pcl", **words)(CLOUD, NEAR, neighbor_weights=weights)
    assert same_bits(found.values, tr.fpfh(CLOUD, NEAR, mode="pcl", neighbor_weights=weights, **words).values)
    words |= {"bins": 5, "channels": ("value", "hue"), "equalization": "none", "saturation_weighting": True}
    found = tr.nn.PCFH(**words)(CLOUD, NEAR, neighbor_weights=weights)
    assert same_bits(found.values, tr.pcfh(CLOUD, NEAR, neighbor_weights=weights, **words).values)
    values = uniform(40, 3).double()
    found = tr.nn.PCFH(**words)(CLOUD, NEAR, values=values)
    assert same_bits(found.values, tr.pcfh(CLOUD, NEAR, values=values, **words).values)


def test_edges_to_learn_begin_as_equal_bins_and_stay_in_order():
    edges = BinEdges(2, 11)
    assert close(edges(), torch.linspace(0, 1, 12).expand(2, 12), atol=1e-6)
    with torch.no_grad():
        edges.log_widths.copy_(1000 * uniform(2, 11))
    assert (edges().diff(dim=1) > 0).all()
    assert edges()[:, 0].tolist() == [0, 0]
    assert edges()[:, -1].tolist() == [1, 1]
    plain = tr.nn.FPFH()(CLOUD, NEAR).values
    assert close(tr.nn.FPFH(learn_edges=True)(CLOUD, NEAR).values, plain, atol=1e-3)
    module = shaken(tr.nn.PCFH(learn_edges=True))
    assert same_bits(module(CLOUD, NEAR).values.detach(), tr.pcfh(
        CLOUD, NEAR, binning="soft", edges=module.edges()).values.detach())  # fmt: skip


def test_fusion_weighs_blocks_as_the_function_does():
    blocks = tr.fpfh(CLOUD, NEAR), tr.pcfh(CLOUD, NEAR)
    found = tr.nn.Fuse((1.0, 0.3)).double()(*blocks)
    expected = tr.fuse(*blocks, weights=(1.0, 0.3))
    assert close(found.values, expected.values, atol=1e-6)
    assert found.blocks == expected.blocks
    assert torch.equal(found.valid, expected.valid)
    by_roots = [replace(block, values=rooted(block.values, 0.7)) for block in blocks]
    assert close(tr.nn.Fuse(root=0.7)(*blocks).values, tr.fuse(*by_roots).values, atol=1e-6)


def test_equalization_is_the_functions_and_joint_is_that_of_the_joined_clouds():
    from torchreg.descriptors.color import hsv

    module = tr.nn.Equalize(bandwidth=0.5)
    batch, other = tr.Clouds.pack([CLOUD, OTHER]), tr.Clouds.pack([OTHER, sphere_cloud(20, seed=3)])
    values = hsv(batch.colors)
    expected = tr.soft_equalize(values[:, 0], batch.offsets, 0.5)
    assert torch.equal(module(batch), torch.cat([expected[:, None], values[:, 1:]], dim=1))
    both = module.joint(batch, other)
    for b in range(2):
        one, two = batch.select(b), other.select(b)
        joined = module(tr.Clouds(torch.cat([one.points, two.points]), colors=torch.cat([one.colors, two.colors])))
        (i, j), (k, m) = batch.offsets[b : b + 2].tolist(), other.offsets[b : b + 2].tolist()
        assert torch.equal(both.source[i:j], joined[: j - i])
        assert torch.equal(both.target[k:m], joined[j - i :])


def test_bad_options_are_refused():
    with refuses("mode"):
        tr.nn.FPFH(mode="paper")
    for module in (tr.nn.FPFH, tr.nn.PCFH):
        with refuses("binning"):
            module(binning="fuzzy")
        with refuses("learn_edges", "hard"):
            module(binning="hard", learn_edges=True)
    with refuses("channels"):
        tr.nn.PCFH(channels=("red",))
    with refuses("bandwidth"):
        tr.nn.Equalize(bandwidth=0.0)
    with refuses("weights"):
        tr.nn.Fuse((1.0, 0.0))
    with refuses("features", "2 descriptors"):
        tr.nn.Fuse()(SOURCE)
    with refuses("dustbin", "Sinkhorn"):
        tr.nn.SoftMatch(method="sinkhorn", dustbin=None)
    with refuses("scale"):
        tr.nn.WeightedKabsch(scale=1.0)
    with refuses("scale", "one per pair"):
        tr.nn.WeightedKabsch(rounds=1)(CLOUD, OTHER, MATCHES)
    with refuses("source", "[0, 40]"):
        tr.nn.WeightedKabsch()(OTHER, OTHER, MATCHES)
