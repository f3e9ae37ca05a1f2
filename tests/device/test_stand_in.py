"""The stand-in for a GPU: its numbers are right, it refuses what a GPU refuses, and sees what makes one wait."""

import pytest
import torch
from problems import uniform
from stand_in import NAME, Shadow, StandIn

import torchreg as tr


@pytest.fixture
def stand_in():
    with StandIn() as running:
        yield running


def changed(x):
    x[1:] = 2.0
    x[x > 1] += 1
    x[[0, 2]] = x.new_tensor([5.0, 7.0])
    return x


@pytest.mark.parametrize(
    "run",
    [
        lambda x: x.new_zeros(3) + torch.ones(3, device=x.device),
        lambda x: torch.tensor([1.0, 2.0], device=x.device) * x[:2],
        lambda x: changed(x.clone()),
        lambda x: x.sort(descending=True).values[torch.tensor([2, 0])],
        lambda x: torch.stack(x.unbind()).view(-1, 1).t().contiguous(),
        lambda x: torch.where(x > 0.5, x, 0.0).cumsum(0)[x > 0.5],
    ],
)
def test_numbers_are_those_of_the_cpu(stand_in, run):
    x = uniform(5)
    there = run(x.to(NAME))
    assert isinstance(there, Shadow)
    assert there.device.type == NAME
    assert torch.equal(there.cpu(), run(x))
    assert there.tolist() == run(x).tolist()


def test_gradients_are_those_of_the_cpu(stand_in):
    x = uniform(4, 3).requires_grad_()
    there = x.detach().to(NAME).requires_grad_()
    for values in (x, there):
        (values.sin() @ values.new_tensor([1.0, 2.0, 3.0])).square().sum().backward()
    assert torch.equal(there.grad.cpu(), x.grad)


@pytest.mark.parametrize(
    "mix",
    [
        lambda x: x + torch.ones(5),
        lambda x: torch.ones(5)[x.long()],
        lambda x: torch.cat([x, torch.ones(2)]),
        lambda x: torch.where(torch.ones(5) > 0, x, x),
        lambda x: torch.dot(torch.ones(5), x),
    ],
)
def test_other_operands_on_the_cpu_are_refused(stand_in, mix):
    with pytest.raises(RuntimeError, match="same device"):
        mix(uniform(5).to(NAME))


def test_numpy_is_refused(stand_in):
    with pytest.raises(RuntimeError, match="numpy"):
        uniform(5).to(NAME).numpy()


@pytest.mark.parametrize(
    "wait",
    [
        lambda x: x.sum().item(),
        lambda x: bool((x > 0.5).any()),
        lambda x: (x > 0.5).nonzero(),
        lambda x: x[x > 0.5],
        lambda x: x.cpu(),
        lambda x: x.tolist(),
        lambda x: torch.empty(5).copy_(x),
        lambda x: x.unique(),
        lambda x: x[(x > 2).sum()],
        lambda x: torch.equal(x, x),
        lambda x: x.repeat_interleave((x > 2).long()),
    ],
)
def test_what_waits_is_counted_once(stand_in, wait):
    x = uniform(5).to(NAME)
    wait(x)
    assert stand_in.transfers.total() == 1


@pytest.mark.parametrize(
    "run",
    [
        lambda x: x.sort().values * 2 + 1,
        lambda x: torch.zeros(5).to(x),
        lambda x: x.repeat_interleave((x > 2).long() + 1, output_size=5),
        lambda x: x[torch.tensor([1, 2])],
        lambda x: x[[1, 2]],
    ],
)
def test_what_does_not_wait_is_not_counted(stand_in, run):
    run(uniform(5).to(NAME))
    assert stand_in.transfers.total() == 0


def test_no_kernel_for_the_cpu_runs_on_it(stand_in, monkeypatch):
    monkeypatch.setattr("torchreg.neighborhoods.search.search_open3d", lambda *_: pytest.fail("Open3D searched"))
    cloud = tr.Clouds(points=uniform(50, 3))
    there = tr.neighbors(cloud.to(NAME), 0.3, 8)
    monkeypatch.undo()
    assert torch.equal(there.index.cpu(), tr.neighbors(cloud, 0.3, 8).index)
