"""What training calls at every step never makes a GPU wait: no value is read back, forward or backward."""

import pytest
import torch
from host_transfers import HostTransfers
from problems import uniform

import torchreg as tr
from torchreg.geometry.eigen import least_eigenvector
from torchreg.geometry.kabsch import with_gradient
from torchreg.learning import (
    circle_loss,
    draw_hypothesis,
    draw_samples,
    expected_loss,
    info_nce,
    inlier_probability_loss,
    pose_loss,
    score_function_loss,
    select_softly,
)

SAMPLES = torch.tensor([[0, 1, 2], [3, 4, 5], [1, 3, 5], [2, 4, 0]])


def run_through(source, target, rows, generator=None):
    """Hypotheses, their expected loss, and that of one of them drawn."""
    chosen = select_softly(source, target, rows, inlier_threshold=0.2)
    true = torch.eye(4, device=source.device)
    drawn = draw_hypothesis(chosen, generator=generator)
    return expected_loss(chosen, pose_loss(chosen.T_target_source, true).total) + drawn.log_probability


def drawn(logits):
    return score_function_loss(logits[:4].square(), draw_samples(logits, 4).log_probability)


KERNELS = {
    "kabsch": (tr.kabsch, [uniform(2, 6, 3), uniform(2, 6, 3), uniform(2, 6)]),
    "with_gradient": (
        lambda H, R, s: with_gradient(R.detach(), H, R.detach(), s.detach()),
        [uniform(5, 3, 3), uniform(5, 3, 3), uniform(5, 3)],
    ),
    "least_eigenvector": (
        lambda C, s, V: least_eigenvector(C, s.detach(), V.detach()),
        [uniform(5, 3, 3), uniform(5, 3), uniform(5, 3, 3)],
    ),
    "pose_loss": (lambda a, b: pose_loss(a, b).total, [uniform(5, 4, 4), uniform(5, 4, 4)]),
    "info_nce": (
        lambda a, b, partner: info_nce(a, b, partner, ignored=(a @ b.t()) > 0.5),
        [uniform(3, 8), uniform(6, 8), torch.tensor([-1, 2, 5])],
    ),
    "circle_loss": (
        lambda a, b, d: circle_loss(a, b, d.detach(), positive_radius=0.3, negative_radius=0.6),
        [uniform(5, 8), uniform(6, 8), uniform(5, 6)],
    ),
    "inlier_probability_loss": (lambda x: inlier_probability_loss(x, x.detach() > 0.5), [uniform(7)]),
    "select_softly": (run_through, [uniform(6, 3), uniform(3, 6).t(), SAMPLES]),
    "draw_samples": (drawn, [uniform(9)]),
}


def differentiable(inputs):
    return [value.clone().requires_grad_(value.is_floating_point()) for value in inputs]


@pytest.mark.parametrize("name", KERNELS)
def test_nothing_reads_a_value_back_forward_or_backward(name):
    kernel, inputs = KERNELS[name]
    made = differentiable(inputs)
    with HostTransfers() as watch:
        kernel(*made).sum().backward()
    assert watch.transfers == []
    assert made[0].grad.isfinite().all()


@pytest.mark.parametrize("name", KERNELS)
def test_everything_runs_on_the_meta_device(name):
    kernel, inputs = KERNELS[name]
    made = [value.detach().to("meta").requires_grad_(value.is_floating_point()) for value in inputs]
    kernel(*made).sum().backward()
    assert made[0].grad.device.type == "meta"


@pytest.mark.parametrize("name", [name for name in KERNELS if name != "kabsch"])
def test_the_dtype_stays(name):
    kernel, inputs = KERNELS[name]
    for dtype in (torch.float32, torch.float64):
        made = [value.to(dtype) if value.is_floating_point() else value for value in inputs]
        if name == "select_softly":
            made.append(torch.Generator().manual_seed(0))
        assert kernel(*made).dtype == dtype
