"""Kernels fused by the compiler: the same bits for hard histograms, the same numbers for soft ones."""

import pytest
import torch
from closeness import close
from determinism import pieces, same_bits, threads
from problems import sphere_cloud

import torchreg as tr
from torchreg.geometry.numerics import compiled
from torchreg.native import native_kernels

# what torch's own compiler does on its way
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script_method. is deprecated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning"),
]


@pytest.fixture(autouse=True)
def _kernels_of_torch():
    """The library of compiled kernels would do the work of hard histograms."""
    with native_kernels(False):
        yield


def described(cloud, near, binning):
    points, normals, colors = (v.clone().requires_grad_() for v in (cloud.points, cloud.normals, cloud.colors))
    made = tr.Clouds(points=points, normals=normals, colors=colors)
    values = torch.cat([f(made, near, binning=binning).values for f in (tr.fpfh, tr.pcfh)], dim=1)
    if binning == "hard":
        return (values,)
    return values.detach(), *torch.autograd.grad(values.square().sum(), (points, normals, colors))


@pytest.fixture
def traced(monkeypatch):
    """Compile without the slow part: everything but the generated code."""
    plain = torch.compile
    monkeypatch.setattr(torch, "compile", lambda kernel, **words: plain(kernel, backend="aot_eager", **words))
    compiled.forget_compiled()
    yield
    compiled.forget_compiled()


@pytest.mark.parametrize("binning", ["hard", "soft"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_every_kernel_is_one_graph(traced, binning, dtype):
    cloud = sphere_cloud(100).to(dtype=dtype)
    near = tr.neighbors(cloud, 0.6, 20)
    expected = described(cloud, near, binning)
    with tr.compiled_kernels():
        found = described(cloud, near, binning)
    for one, other in zip(expected, found, strict=True):
        assert close(one.detach(), other.detach(), atol=1e-3 * float(one.detach().abs().max()))


def test_the_context_ends():
    assert not compiled.kernels_are_compiled()
    with tr.compiled_kernels():
        assert compiled.kernels_are_compiled()
        with tr.compiled_kernels(False):
            assert not compiled.kernels_are_compiled()
    assert not compiled.kernels_are_compiled()


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_compiled_hard_histograms_are_the_same_bits(dtype):
    cloud = sphere_cloud(1000).to(dtype=dtype)
    near = tr.neighbors(cloud, 0.6, 40)
    expected = described(cloud, near, "hard")
    with tr.compiled_kernels():
        assert same_bits(described(cloud, near, "hard"), expected)
        with pieces(1000):
            assert same_bits(described(cloud, near, "hard"), expected)


@pytest.mark.slow
def test_compiled_soft_histograms_are_close_and_neither_threads_nor_pieces_change_a_bit():
    cloud = sphere_cloud(1000).to(dtype=torch.float32)
    near = tr.neighbors(cloud, 0.6, 40)
    expected = described(cloud, near, "soft")
    with tr.compiled_kernels():
        found = described(cloud, near, "soft")
        for one, other in zip(expected, found, strict=True):
            assert (one - other).abs().max() < 1e-3 * one.abs().max()
        with threads(1):
            assert same_bits(described(cloud, near, "soft")[0], found[0])
        with pieces(1000):
            assert same_bits(described(cloud, near, "soft")[0], found[0])
