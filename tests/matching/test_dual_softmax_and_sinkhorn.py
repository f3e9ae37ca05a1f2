"""Confidences from scores: what both solvers promise, and what each is by definition."""

from functools import partial

import pytest
import torch
from closeness import close
from hypothesis import given
from hypothesis import strategies as st
from problems import numbers
from refusals import refuses
from torch.autograd import gradcheck, gradgradcheck

from torchreg.matching.softmax import dual_softmax
from torchreg.matching.transport import sinkhorn

SOLVERS = {
    "dual softmax": dual_softmax,
    "dual softmax with a dustbin": partial(dual_softmax, dustbin=0.3),
    "sinkhorn": partial(sinkhorn, dustbin=0.3, iterations=6),
}
every_solver = pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS)


def some(size, seed=0):
    return torch.rand(size, generator=torch.Generator().manual_seed(seed + size)) > 0.4


def plain_dual_softmax(scores):
    by_row = scores.exp() / scores.exp().sum(dim=1, keepdim=True)
    return by_row * scores.exp() / scores.exp().sum(dim=0, keepdim=True)


def plain_transport(scores, dustbin, iterations=400):
    """The optimal transport with a dustbin, in the plain domain: rows and columns scaled in turn."""
    rows, columns = scores.shape
    K = torch.full((rows + 1, columns + 1), dustbin, dtype=scores.dtype)
    K[:-1, :-1] = scores
    K = K.exp()
    mu, nu = torch.ones(rows + 1, dtype=scores.dtype), torch.ones(columns + 1, dtype=scores.dtype)
    mu[-1], nu[-1] = columns, rows
    v = torch.ones_like(nu)
    for _ in range(iterations):
        u = mu / (K @ v)
        v = nu / (K.t() @ u)
    return u[:, None] * K * v


@given(st.integers(0, 2**31), st.integers(1, 9), st.integers(1, 9))
def test_dual_softmax_is_its_definition(seed, rows, columns):
    scores = numbers(rows, columns, seed=seed)
    assert close(dual_softmax(scores), plain_dual_softmax(scores), atol=1e-12)


@given(st.integers(0, 2**31), st.integers(1, 9), st.integers(1, 9))
def test_a_dustbin_of_dual_softmax_is_one_more_row_and_column(seed, rows, columns):
    scores = numbers(rows, columns, seed=seed)
    right, below = scores.new_full((rows, 1), 0.4), scores.new_full((1, columns), 0.4)
    by_row = torch.cat([scores, right], dim=1).softmax(dim=1)[:, :-1]
    by_column = torch.cat([scores, below], dim=0).softmax(dim=0)[:-1]
    assert close(dual_softmax(scores, dustbin=0.4), by_row * by_column, atol=1e-12)


@given(st.integers(0, 2**31), st.integers(1, 7), st.integers(1, 7))
def test_sinkhorn_settles_on_the_transport_with_every_mass_spent(seed, rows, columns):
    scores = numbers(rows, columns, seed=seed)
    plan = plain_transport(scores, 0.3)
    expected = torch.ones(rows + 1, dtype=scores.dtype)
    expected[-1] = columns
    assert close(plan.sum(dim=1), expected, atol=1e-9)  # the oracle itself
    assert close(sinkhorn(scores, dustbin=0.3, iterations=400), plan[:-1, :-1], atol=1e-9)


def test_each_iteration_brings_sinkhorn_nearer():
    scores = 3 * numbers(6, 5)
    settled = sinkhorn(scores, dustbin=0.0, iterations=3000)
    errors = [float((sinkhorn(scores, dustbin=0.0, iterations=k) - settled).abs().max()) for k in (1, 4, 16, 64)]
    assert errors[0] > errors[1] > errors[2] > errors[3]


@every_solver
@given(seed=st.integers(0, 2**31), rows=st.integers(1, 6), columns=st.integers(1, 6), size=st.floats(0, 40))
def test_rows_and_columns_share_at_most_a_mass_of_one(solve, seed, rows, columns, size):
    confidence = solve(size * numbers(rows, columns, seed=seed))
    assert confidence.min() >= 0
    assert confidence.sum(dim=0).max() <= 1 + 1e-12
    if solve is not SOLVERS["sinkhorn"]:
        assert confidence.sum(dim=1).max() <= 1 + 1e-12


def test_rows_of_sinkhorn_share_at_most_one_once_settled():
    assert sinkhorn(numbers(30, 20), dustbin=0.0, iterations=200).sum(dim=1).max() <= 1 + 1e-9


@every_solver
def test_sides_can_be_exchanged(solve):
    if solve is SOLVERS["sinkhorn"]:
        solve = partial(sinkhorn, dustbin=0.3, iterations=300)
    scores = numbers(5, 7)
    assert close(solve(scores), solve(scores.t()).t(), atol=1e-9)


@every_solver
@given(seed=st.integers(0, 2**31), rows=st.integers(1, 6), columns=st.integers(1, 6))
def test_rows_that_do_not_take_part_are_as_if_not_there(solve, seed, rows, columns):
    scores, source, target = numbers(rows, columns, seed=seed), some(rows, seed % 97), some(columns, seed % 89)
    poisoned = torch.where(source[:, None] & target, scores, torch.nan)
    found = solve(poisoned, source_valid=source, target_valid=target)
    assert not found[~source].any()
    assert not found[:, ~target].any()
    assert close(found[source][:, target], solve(scores[source][:, target]), atol=1e-12)


@every_solver
def test_a_batch_is_the_loop_over_its_pairs(solve):
    scores, source = numbers(2, 3, 4, 5), some(24).view(2, 3, 4)
    whole = solve(scores, source_valid=source)
    mapped = torch.func.vmap(lambda s, m: solve(s, source_valid=m))(scores[0], source[0])
    for i in range(2):
        for k in range(3):
            assert close(whole[i, k], solve(scores[i, k], source_valid=source[i, k]), atol=1e-14)
            assert i == 1 or close(whole[i, k], mapped[k], atol=1e-14)


CLEAR = {
    "dual softmax": (dual_softmax, 1 / 16, 1e-6),  # the last two have all others, equally, and nobody else
    "dual softmax with a dustbin": (partial(dual_softmax, dustbin=0.0), 0.0, 1e-6),
    "sinkhorn": (partial(sinkhorn, dustbin=0.0, iterations=200), 0.0, 1e-2),
}


@pytest.mark.parametrize("name", CLEAR)
def test_clear_scores_are_decided(name):
    solve, left, error = CLEAR[name]
    scores = torch.full((4, 4), -50.0)
    expected = torch.zeros(4, 4)
    scores[[0, 1, 2], [2, 0, 1]] = 50.0
    expected[[0, 1, 2], [2, 0, 1]] = 1.0
    expected[3, 3] = left
    assert close(solve(scores), expected, atol=error)


def test_a_higher_dustbin_takes_more():
    scores = numbers(6, 6)
    for solve in (dual_softmax, sinkhorn):
        left = [float(solve(scores, dustbin=dustbin).sum()) for dustbin in (-3.0, 0.0, 3.0)]
        assert left[0] > left[1] > left[2] > 0


MASKS = {
    "all": lambda shape: {},
    "some": lambda shape: {"source_valid": some(shape[-2]), "target_valid": some(shape[-1])},
    "no source": lambda shape: {"source_valid": torch.zeros(shape[-2], dtype=torch.bool)},
    "nobody": lambda shape: {
        "source_valid": torch.zeros(shape[-2], dtype=torch.bool),
        "target_valid": torch.zeros(shape[-1], dtype=torch.bool),
    },
}


@pytest.mark.parametrize("solve", [dual_softmax, partial(sinkhorn, iterations=5)], ids=["dual softmax", "sinkhorn"])
@pytest.mark.parametrize("masks", MASKS)
@pytest.mark.parametrize("shape", [(3, 4), (1, 3), (3, 1), (1, 1), (0, 3), (3, 0)], ids=str)
def test_first_and_second_derivatives_are_exact(solve, masks, shape):
    words = MASKS[masks](shape)
    inputs = numbers(*shape).requires_grad_(), numbers(1).requires_grad_()

    def run(scores, dustbin):
        return solve(scores, dustbin=dustbin, **words)

    assert gradcheck(run, inputs)
    assert gradgradcheck(run, inputs)


@every_solver
def test_derivatives_are_exact_where_all_scores_are_equal(solve):
    scores = torch.full((3, 4), 2.0, dtype=torch.float64, requires_grad=True)
    assert gradcheck(solve, (scores,))
    assert gradgradcheck(solve, (scores,))


@every_solver
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [1e4, 1e30])
def test_huge_scores_have_finite_values_and_gradients(solve, dtype, size):
    scores = (size * numbers(6, 5)).to(dtype).requires_grad_()
    confidence = solve(scores)
    confidence.square().sum().backward()
    assert confidence.dtype == dtype
    assert torch.isfinite(confidence).all()
    assert confidence.max() <= 1 + 1e-6
    assert torch.isfinite(scores.grad).all()


def test_the_way_back_of_sinkhorn_is_that_of_plain_autograd():
    scores, weights = numbers(9, 8), numbers(9, 8, seed=1)

    def loss(scores):
        return (sinkhorn(scores, dustbin=0.1, iterations=30) * weights).sum()

    by_hand = torch.autograd.grad(loss(leaf := scores.clone().requires_grad_()), leaf)[0]
    assert close(by_hand, torch.func.grad(loss)(scores), atol=1e-13)  # whose tensors take the plain way


def test_memory_of_sinkhorn_does_not_grow_with_iterations():
    scores, kept = numbers(60, 50).requires_grad_(), []
    with torch.autograd.graph.saved_tensors_hooks(lambda t: kept.append(t.numel()) or t, lambda t: t):
        sinkhorn(scores, iterations=100)
    assert sum(kept) < 10 * scores.numel() + 100 * (61 + 51)


def test_bad_arguments_are_refused():
    scores = numbers(3, 4)
    for solve in (dual_softmax, sinkhorn):
        with refuses("scores", "(..., N, M)"):
            solve(scores[0])
        with refuses("scores", "floating-point"):
            solve(scores.long())
        with refuses("source_valid", "(3,)"):
            solve(scores, source_valid=some(4))
        with refuses("target_valid", "bool"):
            solve(scores, target_valid=torch.ones(4))
        with refuses("dustbin", "one number"):
            solve(scores, dustbin=torch.zeros(2))
    with refuses("iterations", "at least 1"):
        sinkhorn(scores, iterations=0)
