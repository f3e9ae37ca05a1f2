"""Samples are sifted by their edges: the same looked up, computed, and tested all at once."""

from itertools import combinations

import pytest
import torch
from determinism import same_bits
from problems import correspondence_problem

import torchreg as tr
from torchreg.solvers.ransac import edges as module
from torchreg.solvers.ransac import ransac_poses
from torchreg.solvers.ransac.edges import Edges
from torchreg.solvers.ransac.prune import FITTING, edge_marks, fitting_slack


def columns(count, dtype=torch.float32):
    problem = correspondence_problem(count, 0.7)
    source = problem.source.points[problem.matches.source].t().to(dtype)
    return source.contiguous(), problem.target.points[problem.matches.target].t().to(dtype).contiguous()


def all_at_once(source, target, similarity, threshold, samples):
    """The count and the samples from the marks of all edges of all samples."""
    slack = fitting_slack(source, target, threshold)
    marks = [
        edge_marks(
            source[:, samples[:, a]] - source[:, samples[:, b]],
            target[:, samples[:, a]] - target[:, samples[:, b]],
            similarity,
            slack,
        )
        for a, b in combinations(range(samples.shape[1]), 2)
    ]
    lowest = torch.stack(marks).amin(dim=0)
    return int((lowest > 0).sum()), samples[lowest == FITTING]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [3, 4])
@pytest.mark.parametrize("per_sample", [0, 1 << 20])
def test_samples_are_sifted_the_same_with_a_table_and_without(dtype, size, per_sample, monkeypatch):
    monkeypatch.setattr(module, "_EDGES_PER_SAMPLE", per_sample)
    source, target = columns(120, dtype)
    samples = torch.randint(120, (20_000, size), generator=torch.Generator().manual_seed(1))
    similar, fitting = Edges(source, target, 0.8, 0.2).sift(samples)
    count, expected = all_at_once(source, target, 0.8, 0.2, samples)
    assert similar == count > len(expected) > 0
    assert torch.equal(fitting, expected)


def test_the_table_comes_once_it_pays():
    edges = Edges(*columns(500), 0.9, 0.2)
    samples = torch.randint(500, (8000, 3), generator=torch.Generator().manual_seed(2))
    sifted = []
    for _ in range(3):
        sifted.append(edges.sift(samples))
    assert edges._table is not None
    assert 500**2 > 16 * 8000
    assert all(one[0] == sifted[0][0] and torch.equal(one[1], sifted[0][1]) for one in sifted)


def test_no_sample_is_left_of_none():
    similar, fitting = Edges(*columns(20), 0.9, 0.2).sift(torch.zeros(0, 3, dtype=torch.int64))
    assert similar == 0
    assert fitting.shape == (0, 3)


@pytest.mark.parametrize("confidence", [0.999, 1.0])
def test_the_table_does_not_show_in_the_poses(confidence, monkeypatch):
    problem = correspondence_problem(200, 0.8, noise=0.05)
    options = [tr.RansacOptions(hypotheses=30_000, confidence=confidence)]
    found = []
    for size in (0, 1 << 23):
        monkeypatch.setattr(module, "_TABLE_EDGES", size)
        found.append(tuple(ransac_poses(problem.source, problem.target, problem.matches, options, 3)[0]))
    assert same_bits(found[0], found[1])
