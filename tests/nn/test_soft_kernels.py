"""The kernels of soft registration: one graph each, no value read back, on the meta device, under transforms."""

import pytest
import torch
from closeness import close
from host_transfers import HostTransfers
from problems import uniform
from torch.func import grad, vmap

import torchreg as tr
from torchreg.geometry.soft_kabsch import robust_kabsch, soft_kabsch
from torchreg.matching.soft import expected_targets, squared_distances
from torchreg.matching.softmax import dual_softmax
from torchreg.matching.transport import sinkhorn
from torchreg.nn.descriptors import ascending_edges

# what torch's own compiler does on its way
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script_method. is deprecated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning"),
]


def distances(source, target):
    return squared_distances(source, target, source[:, 0] > 0.2, target[:, 0] > 0.2)


KERNELS = {
    "dual_softmax": (lambda s: dual_softmax(s, source_valid=s.detach()[:, 0] > 0.5), [uniform(4, 5)]),
    "dual_softmax with a dustbin": (lambda s, d: dual_softmax(s, dustbin=d), [uniform(4, 5), uniform(1)]),
    "sinkhorn": (lambda s, d: sinkhorn(s, dustbin=d, iterations=3), [uniform(4, 5), uniform(1)]),
    "squared_distances": (distances, [uniform(4, 6), uniform(5, 6)]),
    "expected_targets": (lambda c, q: torch.cat([*expected_targets(c, q)[:1]]), [uniform(4, 5), uniform(5, 3)]),
    "soft_kabsch": (soft_kabsch, [uniform(4, 3), uniform(5, 3), uniform(4, 5)]),
    "robust_kabsch": (
        lambda p, q, c: robust_kabsch(p, q, c, scale=0.3, rounds=2),
        [uniform(4, 3), uniform(5, 3), uniform(4, 5)],
    ),
    "kabsch": (tr.kabsch, [uniform(5, 3), uniform(6, 3)[1:], uniform(5)]),
    "ascending_edges": (ascending_edges, [uniform(3, 11)]),
}
every_kernel = pytest.mark.parametrize("name", KERNELS)


def leaves(inputs):
    return [value.clone().requires_grad_() for value in inputs]


def value_and_gradients(kernel, inputs):
    made = leaves(inputs)
    out = kernel(*made)
    return out, *torch.autograd.grad((out * uniform(*out.shape).to(out)).sum(), made)


def assert_compiles(name, backend):
    """Value and gradients are those of plain operations."""
    kernel, inputs = KERNELS[name]
    torch._dynamo.reset()
    compiled = torch.compile(kernel, fullgraph=True, backend=backend)
    expected = value_and_gradients(kernel, inputs)
    for one, other in zip(expected, value_and_gradients(compiled, inputs), strict=True):
        assert close(one, other, atol=1e-4)


@every_kernel
def test_every_kernel_is_one_graph_forward_and_backward(name):
    assert_compiles(name, "aot_eager")


@pytest.mark.slow
@every_kernel
def test_every_kernel_compiles(name):
    assert_compiles(name, "inductor")


@every_kernel
def test_nothing_reads_a_value_back_forward_or_backward(name):
    kernel, inputs = KERNELS[name]
    made = leaves(inputs)
    with HostTransfers() as watch:
        kernel(*made).sum().backward()
    assert watch.transfers == []


@every_kernel
def test_everything_runs_on_the_meta_device(name):
    kernel, inputs = KERNELS[name]
    made = leaves([value.to("meta") for value in inputs])
    kernel(*made).sum().backward()
    assert all(value.grad.device.type == "meta" for value in made)


@every_kernel
def test_transforms_of_torch_func_give_the_gradients_of_autograd(name):
    kernel, inputs = KERNELS[name]
    several = [torch.stack([value, 0.5 * value + 0.1]) for value in inputs]

    weights = uniform(*kernel(*inputs).shape)

    def loss(*values):
        return (kernel(*values) * weights).sum()

    places = tuple(range(len(inputs)))
    mapped = vmap(grad(loss, argnums=places))(*several)
    for b in range(2):
        expected = value_and_gradients(kernel, [value[b] for value in several])[1:]
        for one, other in zip(mapped, expected, strict=True):
            assert close(one[b], other, atol=2e-4)
