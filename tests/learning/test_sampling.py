"""Weighted samples: drawn as their probabilities say, whose gradients lead away from what fares badly."""

import math
from itertools import permutations

import pytest
import torch
from closeness import close
from determinism import same_bits
from problems import seeded
from refusals import refuses
from torch.autograd import gradcheck, gradgradcheck

from torchreg.learning import draw_samples, sampling, score_function_loss

LOGITS = torch.tensor([0.5, -1.0, 2.0, 0.0, -0.3], dtype=torch.float64)


def probability_of(order, logits=LOGITS):
    """Of drawing this order without replacement, one after another."""
    weights, left, product = logits.exp().tolist(), logits.exp().sum().item(), 1.0
    for row in order:
        product *= weights[row] / left
        left -= weights[row]
    return product


def test_no_correspondence_stands_in_a_sample_twice():
    rows = draw_samples(LOGITS, 300, sample_size=4, generator=seeded()).rows
    assert rows.shape == (300, 4)
    assert (rows.sort(dim=1).values.diff(dim=1) > 0).all()
    assert rows.min() == 0
    assert rows.max() == 4


def test_log_probabilities_are_those_of_the_orders_drawn():
    samples = draw_samples(LOGITS, 50, generator=seeded())
    expected = torch.tensor([probability_of(order) for order in samples.rows.tolist()], dtype=torch.float64)
    assert close(samples.log_probability.exp(), expected, atol=1e-12)


def test_orders_are_drawn_as_often_as_their_probabilities_say():
    count = 40000
    rows = draw_samples(LOGITS, count, generator=seeded(1)).rows.tolist()
    seen = dict.fromkeys(permutations(range(5), 3), 0)
    for row in rows:
        seen[tuple(row)] += 1
    chi = sum((n - count * probability_of(order)) ** 2 / (count * probability_of(order)) for order, n in seen.items())
    assert chi < 100  # 59 degrees of freedom: exceeded once in a thousand


def test_a_constant_added_to_the_logits_changes_nothing():
    one, other = (draw_samples(LOGITS + shift, 40, generator=seeded()) for shift in (0.0, 7.0))
    assert torch.equal(one.rows, other.rows)
    assert close(one.log_probability, other.log_probability, atol=1e-12)


def test_the_same_seed_draws_the_same_samples_and_another_seed_others(monkeypatch):
    one, same, other = (draw_samples(LOGITS, 40, generator=seeded(seed)) for seed in (0, 0, 1))
    assert same_bits(one, same)
    assert not torch.equal(one.rows, other.rows)
    state = torch.get_rng_state()
    draw_samples(LOGITS, 40, generator=seeded())
    assert torch.equal(torch.get_rng_state(), state)
    monkeypatch.setattr(sampling, "_DRAW_ELEMENTS", 35)  # pieces of seven samples each
    assert draw_samples(LOGITS, 40, generator=seeded()).rows.shape == (40, 3)


def test_gradients_of_log_probabilities_are_exact():
    def log_probability(logits):
        return draw_samples(logits, 6, generator=seeded()).log_probability

    logits = LOGITS.clone().requires_grad_()
    assert gradcheck(log_probability, logits, eps=1e-7)
    assert gradgradcheck(log_probability, logits, eps=1e-7)


@pytest.mark.parametrize(
    "logits",
    [[100.0, 0, 0, 0], [-torch.inf, 0, 0, 0], [0.0, -torch.inf, -torch.inf, 0], [1e30, 0, -1e30, 0]],
)
def test_gradients_are_finite_where_few_hold_all_the_weight(logits):
    logits = torch.tensor(logits, requires_grad=True)
    samples = draw_samples(logits, 20, generator=seeded())
    likely = samples.log_probability.isfinite()
    (gradient,) = torch.autograd.grad(torch.where(likely, samples.log_probability, 0).sum(), logits)
    assert gradient.isfinite().all()


def test_the_value_is_the_mean_and_gradients_of_the_losses_pass():
    losses = torch.tensor([1.0, 4.0, 2.5], requires_grad=True)
    log_probability = torch.tensor([-1.0, -2.0, -3.0], requires_grad=True)
    loss = score_function_loss(losses, log_probability)
    assert torch.isclose(loss, losses.mean())
    to_losses, to_probabilities = torch.autograd.grad(loss, (losses, log_probability))
    assert torch.allclose(to_losses, torch.full((3,), 1 / 3))
    assert torch.allclose(to_probabilities, torch.tensor([1 - 3.25, 4 - 1.75, 0.0]) / 3)


def test_the_gradient_is_that_of_the_expectation():
    """Against the sum over all 60 ordered samples, differentiated."""
    losses = {order: float(order[0] + 2 * (2 in order)) for order in permutations(range(5), 3)}
    logits = LOGITS.clone().requires_grad_()
    expectation = torch.zeros((), dtype=torch.float64)
    for order, loss in losses.items():
        weights, left, product = logits.exp(), logits.exp().sum(), 1.0
        for row in order:
            product, left = product * weights[row] / left, left - weights[row]
        expectation = expectation + loss * product
    (expected,) = torch.autograd.grad(expectation, logits)
    samples = draw_samples(logits, 60000, generator=seeded(2))
    drawn = torch.tensor([losses[tuple(row)] for row in samples.rows.tolist()], dtype=torch.float64)
    (found,) = torch.autograd.grad(score_function_loss(drawn, samples.log_probability), logits)
    assert close(found, expected, atol=0.02)
    assert expected.abs().max() > 0.2


def test_what_does_not_fit_is_refused():
    with refuses("logits", "at least 3", "(2,)"):
        draw_samples(torch.zeros(2), 5)
    with refuses("logits", "(M,)", "(2, 5)"):
        draw_samples(torch.zeros(2, 5), 5)
    with refuses("hypotheses", "at least 1", "0"):
        draw_samples(torch.zeros(5), 0)
    with refuses("sample_size", "at least 3", "2"):
        draw_samples(torch.zeros(5), 5, sample_size=2)
    with refuses("losses", "at least 2", "(1,)"):
        score_function_loss(torch.zeros(1), torch.zeros(1))
    with refuses("log_probability", "(3,)", "(2,)"):
        score_function_loss(torch.zeros(3), torch.zeros(2))


@pytest.mark.parametrize("distance", [1.0, 30.0, 40.0, 200.0, 2000.0])
def test_the_probability_is_exact_where_one_weight_dominates(distance):
    logits = torch.tensor([0.0, -distance, -distance, -distance], dtype=torch.float64, requires_grad=True)
    samples = draw_samples(logits, 4, generator=torch.Generator().manual_seed(0))
    first = samples.rows[:, 0] == 0
    # the dominant one first, then two of three equal ones, whatever their weight
    expected = -math.log(6) - math.log1p(3 * math.exp(-distance))
    assert torch.allclose(samples.log_probability[first].detach(), torch.tensor(expected).double(), atol=1e-9)
    (grad,) = torch.autograd.grad(samples.log_probability.sum(), logits)
    assert torch.isfinite(grad).all()
    assert abs(float(grad.sum())) < 1e-9
