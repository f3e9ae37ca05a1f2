"""Sparse factors solve what dense ones solve, and marginals are blocks of the inverse."""

import pytest
import torch
from closeness import close
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import numbers

from torchreg.site.elimination import Elimination


def dense(count, edges, diagonal, between):
    blocks = torch.zeros(count, 6, count, 6, dtype=torch.float64)
    for node in range(count):
        blocks[node, :, node] = diagonal[node]
    for (a, b), block in zip(edges, between, strict=True):
        blocks[a, :, b], blocks[b, :, a] = block, block.t()
    return blocks.view(6 * count, 6 * count)


def system(count, edges, seed=0):
    """Blocks of a positive definite matrix: sums of J J^T over edges, and a little on the diagonal."""
    diagonal = torch.eye(6, dtype=torch.float64).repeat(count, 1, 1)
    between = torch.zeros(len(edges), 6, 6, dtype=torch.float64)
    for number, (a, b) in enumerate(edges):
        one, other = numbers(2, 6, 6, seed=seed + number)
        diagonal[a] += one @ one.t()
        diagonal[b] += other @ other.t()
        between[number] = one @ other.t()
    return diagonal, between


GRAPHS = {
    "none": (1, []),
    "apart": (3, []),
    "chain": (6, [(k + 1, k) for k in range(5)]),
    "star": (6, [(0, k) for k in range(1, 6)]),
    "ring": (7, [(k, (k + 1) % 7) for k in range(7)]),
    "all": (5, [(a, b) for a in range(5) for b in range(a)]),
    "two": (6, [(0, 1), (1, 2), (3, 4), (4, 5), (5, 3)]),
}


@pytest.mark.parametrize("name", GRAPHS)
def test_known_graphs(name):
    count, edges = GRAPHS[name]
    agrees_with_dense(count, edges)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 14), st.integers(0, 2**20), st.floats(0.05, 0.9))
def test_any_graph(count, seed, share):
    draws = torch.rand(count, count, generator=torch.Generator().manual_seed(seed))
    agrees_with_dense(count, [(a, b) for a in range(count) for b in range(a) if draws[a, b] < share], seed)


def agrees_with_dense(count, edges, seed=0):
    diagonal, between = system(count, edges, seed)
    matrix = dense(count, edges, diagonal, between)
    graph = Elimination(count, edges)
    factors = graph.factor(diagonal, between)
    right = numbers(count, 6, seed=seed)
    assert close(graph.solve(factors, right).view(-1), torch.linalg.solve(matrix, right.view(-1)), 1e-10)
    inverse = torch.linalg.inv(matrix).view(count, 6, count, 6)
    blocks = torch.stack([inverse[node, :, node] for node in range(count)])
    assert close(graph.marginals(factors), blocks, 1e-10)


def test_a_complete_graph_is_one_front():
    count, edges = 8, [(a, b) for a in range(8) for b in range(a)]
    assert [front.pivots for front in Elimination(count, edges).fronts] == [8]


def test_a_chain_has_small_fronts():
    assert max(len(front.nodes) for front in Elimination(50, [(k, k + 1) for k in range(49)]).fronts) == 2


def test_a_matrix_that_is_not_positive_definite_has_no_factor():
    diagonal = torch.eye(6, dtype=torch.float64).repeat(3, 1, 1)
    diagonal[1] = -diagonal[1]
    assert Elimination(3, [(0, 1)]).factor(diagonal, torch.zeros(1, 6, 6, dtype=torch.float64)) is None
