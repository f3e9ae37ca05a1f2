"""Pairs most of which are wrong: the pose of those that agree is found, and gradients pass through all rounds."""

import pytest
import torch
from closeness import close
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import correspondence_problem, numbers
from refusals import refuses
from torch.autograd import gradcheck, gradgradcheck

from torchreg.geometry.soft_kabsch import robust_kabsch, soft_kabsch


def few_right(count=60, outlier_ratio=0.5, seed=0):
    """Points, points and the confidence (N, M) of a problem whose matches are wrong at this rate."""
    problem = correspondence_problem(count, outlier_ratio, seed=seed)
    confidence = torch.zeros(count, count, dtype=torch.float64)
    confidence[problem.matches.source, problem.matches.target] = 1.0
    return problem.source.points, problem.target.points, confidence + 1e-4, problem.T_target_source[0]


@settings(max_examples=20)
@given(st.integers(0, 2**31))
def test_half_of_the_pairs_may_be_wrong(seed):
    source, target, confidence, T = few_right(seed=seed)
    found = robust_kabsch(source, target, confidence, scale=0.05)
    plain = soft_kabsch(source, target, confidence)
    assert close(found, T, atol=0.1)
    assert (found - T).abs().max() < 0.2 * (plain - T).abs().max()


def test_one_round_is_its_definition():
    source, target, confidence = numbers(6, 3), numbers(7, 3), numbers(6, 7).abs()
    first = soft_kabsch(source, target, confidence)
    distance = torch.cdist(source @ first[:3, :3].t() + first[:3, 3], target)
    expected = soft_kabsch(source, target, confidence * (0.3**2 / (0.3**2 + distance**2)) ** 2)
    assert close(robust_kabsch(source, target, confidence, scale=0.3, rounds=1), expected, atol=1e-9)


def test_a_batch_is_the_loop_and_the_map_over_its_pairs_each_with_its_scale():
    source, target, confidence = numbers(3, 6, 3), numbers(3, 5, 3, seed=1), numbers(3, 6, 5).abs()
    scale = torch.tensor([0.1, 0.5, 2.0])
    whole = robust_kabsch(source, target, confidence, scale=scale)
    mapped = torch.func.vmap(lambda p, q, c: robust_kabsch(p, q, c, scale=0.5))(source, target, confidence)
    for b in range(3):
        alone = robust_kabsch(source[b], target[b], confidence[b], scale=float(scale[b]))
        assert close(whole[b], alone, atol=1e-6)
    assert close(mapped[1], whole[1], atol=1e-9)


def test_first_and_second_derivatives_are_exact():
    inputs = numbers(4, 3), numbers(4, 3, seed=1), numbers(4, 4, seed=2).abs() + 0.1
    inputs = tuple(value.requires_grad_() for value in inputs)

    def run(source, target, confidence):
        return robust_kabsch(source, target, confidence, scale=0.8, rounds=2)

    assert gradcheck(run, inputs, atol=1e-5)
    assert gradgradcheck(run, inputs, atol=1e-3, fast_mode=True)


TROUBLE = {
    "nothing counts": (numbers(4, 3), numbers(5, 3), torch.zeros(4, 5).double()),
    "one pair": (numbers(1, 3), numbers(1, 3, seed=1), torch.ones(1, 1).double()),
    "exactly right": (numbers(4, 3), numbers(4, 3) + 1, torch.eye(4).double()),
    "one place": (torch.ones(4, 3).double(), numbers(5, 3), numbers(4, 5).abs()),
    "far apart": (numbers(4, 3), 1e6 * numbers(5, 3), numbers(4, 5).abs()),
    "nobody": (numbers(0, 3), numbers(0, 3), numbers(0, 0)),
}


@pytest.mark.parametrize("name", TROUBLE)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_leaves_the_pose_open_gives_a_rotation_and_finite_gradients(name, dtype):
    inputs = [value.to(dtype).requires_grad_() for value in TROUBLE[name]]
    T = robust_kabsch(*inputs, scale=0.1)
    assert close(T[:3, :3] @ T[:3, :3].t(), torch.eye(3, dtype=dtype), atol=1e-5)
    for grad in torch.autograd.grad(T.square().sum() + T[0].sum(), inputs):
        assert torch.isfinite(grad).all()


def test_memory_does_not_grow_with_rounds():
    source, target, confidence, _ = few_right(80)
    confidence.requires_grad_()

    def kept(rounds):
        sizes = {}  # by their place in memory: what is kept several times takes room once
        with torch.autograd.graph.saved_tensors_hooks(
            lambda t: sizes.update({t.data_ptr(): t.numel()}) or t, lambda t: t
        ):
            T = robust_kabsch(source, target, confidence, scale=0.1, rounds=rounds)
        return sum(sizes.values()) + T.numel()

    assert kept(9) - kept(1) < confidence.numel()


def test_bad_arguments_are_refused():
    source, target, confidence = numbers(3, 3), numbers(4, 3), numbers(3, 4).abs()
    with refuses("scale", "above 0"):
        robust_kabsch(source, target, confidence, scale=0.0)
    with refuses("scale", "a number or ()"):
        robust_kabsch(source, target, confidence, scale=torch.ones(2))
    with refuses("rounds", "at least 1"):
        robust_kabsch(source, target, confidence, scale=1.0, rounds=0)
