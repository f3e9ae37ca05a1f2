"""Consensus sets against loops, their weights against an eigen-solver, and their fits against Kabsch."""

import pytest
import torch
from closeness import close
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st

import torchreg as tr
from torchreg.solvers.compatibility.sets import consensus_sets, fit_sets


def random_graph(count, density, seed):
    graph = (torch.rand(count, count, generator=torch.Generator().manual_seed(seed)) < density).float().triu(1)
    return graph + graph.t()


def naive_sets(graph, wide, narrow):
    """The members of every set by sorted lists."""
    partners = [set(row.nonzero()[:, 0].tolist()) for row in graph]
    found = []
    for seed in range(len(graph)):
        shared = {j: len(partners[seed] & partners[j]) if j in partners[seed] else 0 for j in range(len(graph))}
        ranked = sorted((j for j in shared if j != seed), key=lambda j: (-shared[j], j))
        first = [seed, *ranked[:wide]]
        inside = [len(partners[seed] & partners[j] & set(first)) if j in partners[seed] else 0 for j in first]
        order = sorted(range(1, len(first)), key=lambda k: (-inside[k], k))
        found.append([seed, *(first[k] for k in order[: narrow - 1])])
    return found


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.integers(3, 20), st.floats(0.1, 1))
def test_the_members_are_those_of_the_naive_search(seed, count, density):
    graph = random_graph(count, density, seed)
    assert consensus_sets(graph, 8, 5)[0].tolist() == naive_sets(graph, 8, 5)


@given(st.integers(0, 2**31), st.integers(3, 20))
def test_weights_are_whole_and_belong_to_members_that_agree(seed, count):
    graph = random_graph(count, 0.5, seed)
    members, weights = consensus_sets(graph, 8, 5)
    assert torch.equal(weights, weights.round())
    assert weights.max() < 2**53
    inside = graph[members[:, :, None], members[:, None, :]]
    alone = ((inside @ inside) * inside).sum(dim=2) == 0
    assert (weights[alone] == 0).all()


def test_the_weights_near_the_leading_eigenvector():
    graph = random_graph(60, 0.7, 3)
    members, weights = consensus_sets(graph, 30, 12)
    inside = graph[members[:, :, None], members[:, None, :]].double()
    leading = torch.linalg.eigh((inside @ inside) * inside).eigenvectors[..., -1].abs()
    assert close(torch.nn.functional.normalize(weights, dim=1), leading, atol=0.02)


def test_the_largest_sets_stay_exact():
    members, weights = consensus_sets(1 - torch.eye(64), 60, 60)
    assert members.shape == (64, 60)
    assert weights.max() < 2**53
    assert torch.equal(weights, weights[:1, :1].expand_as(weights))


@pytest.mark.parametrize("count", [3, 10])
def test_the_fit_is_kabsch_with_the_weights(count):
    generator = torch.Generator().manual_seed(count)
    source, target = torch.randn(2, 3, 50, dtype=torch.float64, generator=generator)
    members = torch.randint(50, (7, count), generator=generator)
    weights = torch.randint(0, 9, (7, count), generator=generator).double()
    rotation, translation, _ = fit_sets(source, target, members, weights)
    for s in range(7):
        expected = tr.kabsch(source.t()[members[s]], target.t()[members[s]], weights[s])
        moved = [R @ source[:, members[s]] + t[:, None] for R, t in ((rotation[..., s], translation[:, s]),)]
        best = expected[:3, :3] @ source[:, members[s]] + expected[:3, 3:]
        cost = [((points - target[:, members[s]]).square().sum(dim=0) * weights[s]).sum() for points in (*moved, best)]
        assert close(cost[0], cost[1], atol=1e-9)


def test_a_set_has_its_bits_whatever_is_fitted_beside_it():
    generator = torch.Generator().manual_seed(8)
    source, target = torch.randn(2, 3, 50, dtype=torch.float64, generator=generator)
    members = torch.randint(50, (3000, 7), generator=generator)
    weights = torch.randint(0, 9, (3000, 7), generator=generator).double()
    together = fit_sets(source, target, members, weights)
    wider = [torch.nn.functional.pad(values, (0, 4)) for values in (members, weights)]  # members without weight
    assert same_bits(fit_sets(source, target, *wider), together)
    for rows in (slice(0, 1), slice(1500, 1520), slice(2999, 3000)):
        alone = fit_sets(source, target, members[rows], weights[rows])
        assert same_bits(alone, tuple(part[..., rows].contiguous() for part in together))


def test_sets_on_a_line_or_at_a_place_do_not_fix_a_rotation():
    line = torch.arange(6, dtype=torch.float64) * torch.tensor([[1.0], [2], [-1]], dtype=torch.float64)
    place = torch.ones(3, 6, dtype=torch.float64)
    flat = torch.rand(3, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    flat[2] = 0
    members, weights = torch.arange(6)[None], torch.ones(1, 6, dtype=torch.float64)
    for source, target, fixed in ((line, line, False), (place, place, False), (flat, line, False), (flat, flat, True)):
        rotation, translation, solvable = fit_sets(source, target, members, weights)
        assert solvable.tolist() == [fixed]
        assert torch.isfinite(rotation).all()
        assert torch.isfinite(translation).all()
    assert fit_sets(flat, flat, members, 0 * weights)[2].tolist() == [False]


def test_a_wider_first_set_gives_other_members():
    graph = random_graph(100, 0.4, 5)
    narrow, wide = consensus_sets(graph, 9, 10)[0], consensus_sets(graph, 60, 10)[0]
    assert not torch.equal(narrow, wide)
