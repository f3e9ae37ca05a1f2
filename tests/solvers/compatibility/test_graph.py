"""Agreement about lengths, first and second order, against loops over pairs of correspondences."""

import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import columns

from torchreg.datasets import match_problem
from torchreg.solvers.compatibility import graph as module
from torchreg.solvers.compatibility.graph import first_order, second_order


def naive_graph(source, target, threshold):
    """A by its definition, pair by pair."""
    count = source.shape[1]
    found = torch.zeros(count, count)
    for i in range(count):
        for j in range(count):
            apart = (source[:, i] - source[:, j]).norm() - (target[:, i] - target[:, j]).norm()
            found[i, j] = float(i != j and abs(float(apart)) < threshold)
    return found


def naive_second_order(graph):
    """Common partners of every two that agree, by sets."""
    partners = [set(row.nonzero()[:, 0].tolist()) for row in graph]
    count = len(graph)
    return torch.tensor(
        [[len(partners[i] & partners[j]) if graph[i, j] else 0 for j in range(count)] for i in range(count)]
    ).float()


@settings(max_examples=10)
@given(st.integers(0, 2**31), st.integers(1, 25), st.floats(0.05, 2))
def test_both_orders_are_those_of_the_definition(seed, count, threshold):
    source, target = columns(match_problem(count, 0.4, seed=seed), torch.float64)
    graph = first_order(source, target, threshold)
    assert torch.equal(graph.float(), naive_graph(source, target, threshold))
    assert torch.equal(second_order(graph).float(), naive_second_order(graph))


def test_inliers_agree_with_each_other_and_share_their_partners():
    problem = match_problem(400, 0.8, noise=0.01)
    graph = first_order(*columns(problem, torch.float32), 0.2)
    shared = second_order(graph)
    right = problem.is_inlier
    assert graph[right][:, right].mean() > 0.98
    assert graph[right][:, ~right].mean() < 0.2
    assert shared[right][:, right].fill_diagonal_(1e9).min() > 2 * shared[right][:, ~right].mean()


def test_the_graph_is_symmetric_with_a_diagonal_of_zeros():
    graph = first_order(*columns(match_problem(300, 0.7), torch.float32), 0.2)
    assert torch.equal(graph, graph.t())
    assert torch.equal(graph.diagonal(), torch.zeros(300))
    assert set(graph.unique().tolist()) == {0.0, 1.0}


def test_swapped_sides_give_the_same_graph():
    source, target = columns(match_problem(300, 0.7), torch.float32)
    assert torch.equal(first_order(source, target, 0.2), first_order(target, source, 0.2))


@pytest.mark.parametrize("tile", [1, 1000, 1 << 22])
def test_neither_threads_nor_tiles_change_a_bit(tile, monkeypatch):
    source, target = columns(match_problem(700, 0.7), torch.float32)
    expected = second_order(first_order(source, target, 0.2))
    monkeypatch.setattr(module, "TILE_ELEMENTS", tile)
    for number in THREADS:
        with threads(number):
            assert same_bits(second_order(first_order(source, target, 0.2)), expected)
