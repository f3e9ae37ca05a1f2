"""InfoNCE, circle loss and inlier probability: naive twins, invariances, and nothing to learn from."""

import math

import pytest
import torch
from closeness import close
from hypothesis import given
from hypothesis import strategies as st
from problems import numbers, random_transform
from refusals import refuses
from torch.autograd import gradcheck, gradgradcheck

from torchreg.learning import circle_loss, info_nce, inlier_probability_loss, true_distances

RADII = {"positive_radius": 0.3, "negative_radius": 0.8}


def features(rows, seed=0):
    return torch.nn.functional.normalize(numbers(rows, 5, seed=seed), dim=1)


def places(rows, columns, seed=0):
    return torch.rand(rows, columns, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) * 1.5


def naive_info_nce(source, target, partner, ignored, temperature):
    losses = []
    for i, j in enumerate(partner.tolist()):
        if j < 0:
            continue
        kept = [k for k in range(len(target)) if k == j or not ignored[i, k]]
        total = sum(math.exp(float(source[i] @ target[k]) / temperature) for k in kept)
        losses.append(-math.log(math.exp(float(source[i] @ target[j]) / temperature) / total))
    return sum(losses) / len(losses)


def naive_circle(source, target, distances, positive_radius, negative_radius, margins=(0.1, 1.4), scale=16.0):
    apart = torch.cdist(source, target)
    sides = []
    for near, far in ((apart, distances), (apart.t(), distances.t())):
        losses = []
        for d, place in zip(near, far, strict=True):
            pulled = [math.exp(scale * max(0, x - margins[0]) ** 2) for x in d[place < positive_radius].tolist()]
            pushed = [math.exp(scale * max(0, margins[1] - x) ** 2) for x in d[place > negative_radius].tolist()]
            if pulled and pushed:
                losses.append(math.log(1 + sum(pulled) * sum(pushed)) / scale)
        sides.append(sum(losses) / len(losses))
    return sum(sides) / 2


@given(st.integers(0, 2**31), st.floats(0.05, 2))
def test_info_nce_is_what_its_formula_says(seed, temperature):
    source, target = features(6, seed), features(8, seed + 1)
    partner = torch.randint(-1, 8, (6,), generator=torch.Generator().manual_seed(seed))
    partner[0] = 3
    ignored = numbers(6, 8, seed=seed) > 0.5
    found = info_nce(source, target, partner, ignored=ignored, temperature=temperature)
    assert float(found) == pytest.approx(naive_info_nce(source, target, partner, ignored, temperature), rel=1e-9)


@given(st.integers(0, 2**31))
def test_circle_loss_is_what_its_formula_says(seed):
    source, target, distances = features(7, seed), features(6, seed + 1), places(7, 6, seed)
    distances[0, :2] = torch.tensor([0.1, 1.2])
    distances[1, 0] = 1.3
    found = circle_loss(source, target, distances, **RADII)
    assert float(found) == pytest.approx(naive_circle(source, target, distances, **RADII), rel=1e-6)


def test_derivatives_are_exact():
    source, target = features(5).requires_grad_(), features(6, 1).requires_grad_()
    partner, ignored = torch.tensor([0, -1, 3, 5, 2]), numbers(5, 6) > 0.3
    logits, truth = numbers(7).requires_grad_(), numbers(7, seed=1) > 0.4
    cases = [
        (lambda a, b: info_nce(a, b, partner, ignored=ignored, temperature=0.3), (source, target)),
        (lambda a, b: circle_loss(a, b, places(5, 6), **RADII), (source, target)),
        (lambda x: inlier_probability_loss(x, truth), (logits,)),
    ]
    for loss, inputs in cases:
        assert gradcheck(loss, inputs)
        assert gradgradcheck(loss, inputs)


def test_the_order_of_rows_does_not_matter():
    source, target, distances = features(5), features(6, 1), places(5, 6)
    rows, columns = torch.tensor([3, 0, 4, 1, 2]), torch.tensor([5, 2, 0, 1, 4, 3])
    partner, back = torch.tensor([0, -1, 3, 5, 2]), columns.argsort()
    moved = torch.where(partner[rows] < 0, -1, back[partner[rows]])
    assert close(info_nce(source[rows], target[columns], moved), info_nce(source, target, partner), atol=1e-12)
    shuffled = circle_loss(source[rows], target[columns], distances[rows][:, columns], **RADII)
    assert close(shuffled, circle_loss(source, target, distances, **RADII), atol=1e-12)
    swapped = circle_loss(target, source, distances.t(), **RADII)
    assert close(swapped, circle_loss(source, target, distances, **RADII), atol=1e-12)


def test_better_features_have_smaller_losses():
    target, partner = features(30), torch.arange(30)
    distances = true_distances(torch.eye(30, 3), torch.eye(30, 3), torch.eye(4)) + 1 - torch.eye(30)
    good, poor = target + 0.1 * numbers(30, 5, seed=1), target + 1.0 * numbers(30, 5, seed=1)
    assert info_nce(target, good, partner) < info_nce(target, poor, partner)
    assert circle_loss(target, good, distances, **RADII) < circle_loss(target, poor, distances, **RADII)


def test_an_ignored_row_is_no_negative_and_a_partner_is_never_ignored():
    source, target = features(1), torch.cat([features(1), features(1)])  # two rows at the true place
    partner = torch.tensor([0])
    assert info_nce(source, target, partner) > 0.69
    assert info_nce(source, target, partner, ignored=torch.tensor([[False, True]])) == 0
    assert info_nce(source, target, partner, ignored=torch.tensor([[True, True]])) == 0


def test_pairs_between_the_radii_count_for_nothing():
    distances = places(5, 6)
    between = (distances >= 0.3) & (distances <= 0.8)
    assert between.any()
    source, target = features(5).requires_grad_(), features(6, 1)
    found = circle_loss(source, target, distances, **RADII)
    other = circle_loss(source, target, torch.where(between, 0.5, distances), **RADII)
    assert torch.equal(found, other)


@pytest.mark.parametrize("shape", [(4, 5), (0, 5), (4, 0), (0, 0)])
def test_nothing_to_learn_from_is_a_loss_of_zero_with_zero_gradients(shape):
    rows, columns = shape
    source, target = features(rows).requires_grad_(), features(columns, 1).requires_grad_()
    ignored = torch.ones(rows, columns, dtype=torch.bool)
    far, near = torch.full(shape, 9.0).double(), torch.zeros(shape).double()
    for loss in (
        info_nce(source, target, torch.full((rows,), -1)),
        info_nce(source, target, torch.full((rows,), -1), ignored=ignored),
        circle_loss(source, target, far, **RADII),
        circle_loss(source, target, near, **RADII),
    ):
        assert loss == 0
        for gradient in torch.autograd.grad(loss, (source, target)):
            assert gradient.eq(0).all()


@pytest.mark.parametrize("made", ["zero", "equal", "huge"])
def test_gradients_are_finite_at_extremes(made):
    rows = {"zero": torch.zeros(4, 3), "equal": torch.ones(4, 3), "huge": 1e6 * numbers(4, 3).float()}[made]
    source, target = rows.clone().requires_grad_(), rows.clone().requires_grad_()
    distances = torch.ones(4, 4) - torch.eye(4)
    for loss in (info_nce(source, target, torch.arange(4)), circle_loss(source, target, distances, **RADII)):
        assert loss.isfinite()
        assert all(part.isfinite().all() for part in torch.autograd.grad(loss, (source, target)))


def test_true_distances_are_those_under_the_transform():
    generator = torch.Generator().manual_seed(0)
    T = random_transform(generator)
    source, target = numbers(5, 3), numbers(7, 3, seed=1)
    expected = torch.cdist(source @ T[:3, :3].t() + T[:3, 3], target)
    assert close(true_distances(source.requires_grad_(), target, T), expected, atol=1e-9)
    assert not true_distances(source, target, T).requires_grad


def test_inliers_and_outliers_weigh_the_same_whatever_their_number():
    logits, truth = torch.tensor([2.0, -1.0]), torch.tensor([True, False])
    many = torch.cat([logits[:1], logits[1:].expand(99)]), torch.cat([truth[:1], truth[1:].expand(99)])
    assert torch.isclose(inlier_probability_loss(*many), inlier_probability_loss(logits, truth))
    by_hand = (math.log1p(math.exp(-2.0)) + math.log1p(math.exp(-1.0))) / 2
    assert float(inlier_probability_loss(logits, truth)) == pytest.approx(by_hand)
    assert torch.isclose(inlier_probability_loss(-logits, ~truth), inlier_probability_loss(logits, truth))


def test_one_class_stands_alone_and_none_is_zero():
    logits = torch.tensor([2.0, -1.0], requires_grad=True)
    for truth in (torch.tensor([True, True]), torch.tensor([False, False])):
        plain = torch.nn.functional.binary_cross_entropy_with_logits(logits, truth.float())
        assert torch.isclose(inlier_probability_loss(logits, truth), plain)
    empty = torch.zeros(0, requires_grad=True)
    loss = inlier_probability_loss(empty, torch.zeros(0, dtype=torch.bool))
    assert loss == 0
    assert torch.autograd.grad(loss, empty)[0].shape == (0,)


def test_huge_logits_stay_finite():
    logits = torch.tensor([1e4, -1e4, 1e4, -1e4], requires_grad=True)
    loss = inlier_probability_loss(logits, torch.tensor([True, False, False, True]))
    assert float(loss.detach()) == pytest.approx(5e3)
    assert torch.autograd.grad(loss, logits)[0].isfinite().all()


def test_what_does_not_fit_is_refused():
    source, target = features(3), features(4)
    with refuses("target_features", "(M, 5)", "(4, 2)"):
        info_nce(source, target[:, :2], torch.zeros(3, dtype=torch.int64))
    with refuses("partner", "int64", "float64"):
        info_nce(source, target, torch.zeros(3).double())
    with refuses("ignored", "(3, 4)", "(4, 3)"):
        info_nce(source, target, torch.zeros(3, dtype=torch.int64), ignored=torch.zeros(4, 3).bool())
    with refuses("temperature", "above 0", "0"):
        info_nce(source, target, torch.zeros(3, dtype=torch.int64), temperature=0)
    with refuses("distances", "(3, 4)", "(4, 3)"):
        circle_loss(source, target, torch.zeros(4, 3), **RADII)
    with refuses("negative_radius", "at least 0.3", "0.2"):
        circle_loss(source, target, torch.zeros(3, 4), positive_radius=0.3, negative_radius=0.2)
    with refuses("is_inlier", "(3,)", "(4,)"):
        inlier_probability_loss(torch.zeros(3), torch.zeros(4).bool())
