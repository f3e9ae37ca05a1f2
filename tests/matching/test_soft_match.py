"""Soft matching of features, and where the partners of points are expected."""

import pytest
import torch
from closeness import close
from hypothesis import given
from hypothesis import strategies as st
from problems import features, numbers
from refusals import refuses
from torch.autograd import gradcheck, gradgradcheck

import torchreg as tr
from torchreg.matching.soft import expected_targets, soft_targets, squared_distances

WAYS = {
    "dual softmax": {"method": "dual_softmax"},
    "dual softmax with a dustbin": {"method": "dual_softmax", "dustbin": -0.4},
    "sinkhorn": {"method": "sinkhorn", "dustbin": -0.4, "iterations": 8},
}
every_way = pytest.mark.parametrize("words", WAYS.values(), ids=WAYS)


def unit(*shape, seed=0):
    return torch.nn.functional.normalize(numbers(*shape, seed=seed), dim=1)


@given(st.integers(0, 2**31), st.integers(1, 12), st.integers(1, 12))
def test_at_a_low_temperature_the_confident_pairs_are_the_mutual_nearest(seed, rows, columns):
    source, target = features(unit(rows, 6, seed=seed)), features(unit(columns, 6, seed=seed + 1))
    confidence = tr.soft_match(source, target, temperature=1e-7).confidence[0]
    matches = tr.match_mutual(source, target)
    found = (confidence > 0.5).nonzero()
    assert found.tolist() == torch.stack([matches.source, matches.target], dim=1).tolist()


@every_way
def test_a_dustbin_is_the_squared_distance_at_which_no_partner_is_as_good(words):
    source, target = features(torch.zeros(1, 2)), features(torch.tensor([[0.6, 0.0]]))
    at = {dustbin: float(tr.soft_match(source, target, **{**words, "dustbin": dustbin}).confidence[0]) for dustbin in (
        -0.30, -0.36, -0.42)}  # fmt: skip
    assert at[-0.30] < at[-0.36] < at[-0.42]
    assert at[-0.36] == pytest.approx(0.25 if words["method"] == "dual_softmax" else 0.5, abs=1e-5)


@every_way
def test_a_batch_is_the_loop_over_its_pairs(words):
    source, target = numbers(9, 5), numbers(8, 5, seed=1)
    valid, other = torch.arange(9) % 3 > 0, torch.arange(8) != 4
    whole = tr.soft_match(features(source, [4, 0, 5], valid), features(target, [2, 3, 3], other), **words)
    assert [tuple(matrix.shape) for matrix in whole.confidence] == [(4, 2), (0, 3), (5, 3)]
    for matrix, rows, columns in zip(
        whole.confidence, (slice(0, 4), slice(4, 4), slice(4, 9)), (slice(0, 2), slice(2, 5), slice(5, 8)), strict=True
    ):
        alone = tr.soft_match(
            features(source[rows], valid=valid[rows]), features(target[columns], valid=other[columns]), **words
        )
        assert torch.equal(matrix, alone.confidence[0])


@every_way
@pytest.mark.parametrize("garbage", [torch.nan, torch.inf, 1e30])
def test_rows_that_are_not_valid_match_nobody_and_poison_nothing(words, garbage):
    source, target, valid = numbers(6, 4), numbers(5, 4, seed=1), torch.tensor([True, False, True, True, False, True])
    broken, broken_target = source.clone(), target.clone()
    broken[~valid], broken_target[2] = garbage, garbage
    other = torch.arange(5) != 2
    one, two = broken.requires_grad_(), broken_target.requires_grad_()
    found = tr.soft_match(features(one, valid=valid), features(two, valid=other), **words).confidence[0]
    clean = tr.soft_match(features(source[valid]), features(target[other]), **words).confidence[0]
    assert close(found[valid][:, other], clean, atol=1e-12)
    assert not found[~valid].any()
    assert not found[:, ~other].any()
    for grad in torch.autograd.grad(found.square().sum(), (one, two)):
        assert torch.isfinite(grad).all()
        assert grad.any()
    assert not torch.autograd.grad(
        tr.soft_match(features(one, valid=valid), features(two, valid=other), **words).confidence[0].sum(), one
    )[0][~valid].any()


@every_way
@pytest.mark.parametrize("masked", [False, True])
def test_first_and_second_derivatives_are_exact(words, masked):
    valid = torch.tensor([True, not masked, True])
    inputs = [numbers(3, 3), numbers(4, 3, seed=1), torch.tensor(0.7).double(), torch.tensor(-0.5).double()]

    def run(source, target, temperature, dustbin):
        words_now = {**words, "temperature": temperature}
        if "dustbin" in words:
            words_now["dustbin"] = dustbin
        return tr.soft_match(features(source, valid=valid), features(target), **words_now).confidence[0]

    inputs = tuple(value.requires_grad_() for value in (inputs if "dustbin" in words else inputs[:3]))
    check = run if "dustbin" in words else lambda *three: run(*three, None)
    assert gradcheck(check, inputs)
    assert gradgradcheck(check, inputs)


@every_way
def test_equal_features_have_finite_gradients(words):
    values = torch.ones(4, 3, requires_grad=True)
    confidence = tr.soft_match(features(values), features(values), **words).confidence[0]
    assert close(confidence, confidence[0, 0].expand(4, 4), atol=1e-6)
    assert torch.isfinite(torch.autograd.grad(confidence.square().sum(), values)[0]).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_distances_are_those_of_the_difference_far_from_zero_too(dtype):
    source, target = (50 + 0.1 * numbers(7, 33)).to(dtype), (50 + 0.1 * numbers(6, 33, seed=1)).to(dtype)
    every = torch.ones(7, dtype=torch.bool)
    expected = (source.double()[:, None] - target.double()[None]).square().sum(dim=2)
    error = (squared_distances(source, target, every, every[:6]) - expected).abs().max()
    assert error < 20 * torch.finfo(dtype).eps


@given(st.integers(0, 2**31), st.integers(1, 8), st.integers(1, 8))
def test_expected_partners_are_means_by_confidence(seed, rows, columns):
    target, confidence = numbers(columns, 3, seed=seed + 1), numbers(rows, columns, seed=seed + 2).abs()
    partners = expected_targets(confidence, target)
    share = confidence / confidence.sum(dim=1, keepdim=True)
    assert close(partners.points, (share[..., None] * target).sum(dim=1), atol=1e-12)
    assert close(partners.weights, confidence.sum(dim=1), atol=1e-12)


def test_expected_partners_of_a_batch_and_of_rows_without():
    matches = tr.SoftCorrespondences(
        (torch.tensor([[0.5, 0.5], [0.0, 0.0]]), torch.zeros(1, 0), torch.tensor([[0.25]])),
        torch.tensor([0, 2, 3, 4]),
        torch.tensor([0, 2, 2, 3]),
    )
    points = torch.tensor([[0.0, 0, 0], [2.0, 0, 0], [0, 0, 7]], requires_grad=True)
    found = soft_targets(matches, points)
    assert found.points.tolist() == [[1, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 7]]
    assert found.weights.tolist() == [1, 0, 0, 0.25]
    found.points.sum().backward()
    assert points.grad.tolist() == [[0.5] * 3, [0.5] * 3, [1.0] * 3]
    with refuses("target", "3 points"):
        soft_targets(matches, points[:2])


@pytest.mark.parametrize("rows", [0, 1, 3])
def test_derivatives_of_expected_partners(rows):
    confidence = numbers(rows, 4).abs()
    confidence[:1] = 0  # on the edge of what differences can see: held fixed
    inputs = confidence[1:].requires_grad_(), numbers(4, 3).requires_grad_()

    def run(rest, points):
        return tuple(expected_targets(torch.cat([confidence[:1].detach(), rest]), points))

    assert gradcheck(run, inputs)
    assert gradgradcheck(run, inputs)


def test_bad_arguments_are_refused():
    one, two = features(numbers(3, 4)), features(numbers(3, 5))
    with refuses("target", "width 4"):
        tr.soft_match(one, two)
    with refuses("target", "1 clouds"):
        tr.soft_match(one, features(numbers(3, 4), [1, 2]))
    with refuses("method", "sinkhorn"):
        tr.soft_match(one, one, method="hungarian")
    with refuses("dustbin", "Sinkhorn"):
        tr.soft_match(one, one, method="sinkhorn")
    with refuses("temperature", "above 0"):
        tr.soft_match(one, one, temperature=0.0)
    with refuses("temperature", "one number"):
        tr.soft_match(one, one, temperature=torch.ones(2))
    with refuses("iterations", "at least 1"):
        tr.soft_match(one, one, iterations=0)
    with refuses("confidence", "(3, 2)"):
        tr.SoftCorrespondences((torch.zeros(2, 2),), torch.tensor([0, 3]), torch.tensor([0, 2]))


@pytest.mark.parametrize("function", [tr.soft_match, tr.nn.SoftMatch(), tr.match_mutual, tr.fuse])
def test_a_tensor_in_place_of_features_is_refused_with_how_these_are_made(function):
    values = torch.rand(5, 16)
    with pytest.raises(TypeError, match=r"^\w+: expected Features, such as .*, got a tensor \(5, 16\)") as caught:
        function(values, values)
    assert 'Features(values, clouds.offsets, (("mine", 16),), valid)' in str(caught.value)
    with pytest.raises(TypeError, match=r"^\w+: expected Features, got None"):
        function(None, None)
