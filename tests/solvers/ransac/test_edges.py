"""The edge test as Open3D's checker has it; what fits is never dropped before its solve; a table changes nothing."""

from itertools import combinations

import pytest
import torch
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import columns, correspondence_problem, random_rotation, random_transform

import torchreg as tr
from torchreg.solvers import poses_of_pairs
from torchreg.solvers.ransac import edges as module
from torchreg.solvers.ransac.edges import DISSIMILAR, FITTING, SIMILAR, Edges, edge_marks, fitting_slack
from torchreg.solvers.ransac.samples import sample_fits, solve_samples, spans_plane


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
    source, target = columns(correspondence_problem(120, 0.7), dtype)
    samples = torch.randint(120, (20_000, size), generator=torch.Generator().manual_seed(1))
    similar, fitting = Edges(source, target, 0.8, 0.2).sift(samples)
    count, expected = all_at_once(source, target, 0.8, 0.2, samples)
    assert similar == count > len(expected) > 0
    assert torch.equal(fitting, expected)


def test_the_table_comes_once_it_pays():
    edges = Edges(*columns(correspondence_problem(500, 0.7), torch.float32), 0.9, 0.2)
    samples = torch.randint(500, (8000, 3), generator=torch.Generator().manual_seed(2))
    sifted = []
    for _ in range(3):
        sifted.append(edges.sift(samples))
    assert edges._table is not None
    assert 500**2 > 16 * 8000
    assert all(one[0] == sifted[0][0] and torch.equal(one[1], sifted[0][1]) for one in sifted)


def test_no_sample_is_left_of_none():
    similar, fitting = Edges(*columns(correspondence_problem(20, 0.7), torch.float32), 0.9, 0.2).sift(
        torch.zeros(0, 3, dtype=torch.int64)
    )
    assert similar == 0
    assert fitting.shape == (0, 3)


@pytest.mark.parametrize("confidence", [0.999, 1.0])
def test_the_table_does_not_show_in_the_poses(confidence, monkeypatch):
    problem = correspondence_problem(200, 0.8, noise=0.05)
    options = [tr.RansacOptions(hypotheses=30_000, confidence=confidence)]
    found = []
    for size in (0, 1 << 23):
        monkeypatch.setattr(module, "_TABLE_EDGES", size)
        found.append(tuple(poses_of_pairs(problem.source, problem.target, problem.matches, options, 3)[0]))
    assert same_bits(found[0], found[1])


def random_edges(count, seed=0, spread=0.3):
    """Edges (3, count) and those of their partners."""
    generator = torch.Generator().manual_seed(seed)
    source = torch.randn(3, count, dtype=torch.float64, generator=generator)
    return source, source + spread * torch.randn(3, count, dtype=torch.float64, generator=generator)


def by_lengths(source, target, similarity, slack):
    """Open3D's rule, edge by edge: both ratios at least the similarity."""
    marks = []
    for a, b in zip(source.norm(dim=0).tolist(), target.norm(dim=0).tolist(), strict=True):
        similar = a >= similarity * b and b >= similarity * a and a > 0 and b > 0
        marks.append(DISSIMILAR if not similar else FITTING if abs(a - b) <= slack else SIMILAR)
    return marks


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.floats(0, 1), st.floats(0.01, 2))
def test_edges_are_judged_by_their_lengths(seed, similarity, slack):
    source, target = random_edges(80, seed)
    assert edge_marks(source, target, similarity, slack).tolist() == by_lengths(source, target, similarity, slack)


def test_a_rigid_motion_passes_every_similarity_below_1():
    source, _ = random_edges(200)
    T = random_transform(torch.Generator().manual_seed(0))
    assert (edge_marks(source, T[:3, :3] @ source, 1 - 1e-9, 1e-9) == FITTING).all()


def test_the_edge_test_is_symmetric():
    source, target = random_edges(500)
    forth = edge_marks(source, target, 0.7, 0.1)
    assert torch.equal(forth, edge_marks(target, source, 0.7, 0.1))
    assert sorted(forth.unique().tolist()) == [DISSIMILAR, SIMILAR, FITTING]


def test_an_edge_without_length_never_passes():
    source, target = random_edges(10)
    for one, other in ((torch.zeros_like(source), target), (source, torch.zeros_like(target))):
        assert (edge_marks(one, other, 0.0, 100.0) == DISSIMILAR).all()


def test_a_higher_similarity_keeps_a_part():
    source, target = random_edges(2000)
    kept = [int((edge_marks(source, target, similarity, 0.1) > 0).sum()) for similarity in (0.0, 0.3, 0.6, 0.9)]
    assert kept[0] == 2000
    assert kept == sorted(kept, reverse=True)
    assert len(set(kept)) == 4


@settings(max_examples=60)
@given(
    st.integers(0, 2**31),
    st.integers(3, 5),
    st.floats(0, 1.2),
    st.floats(1, 150),
    st.floats(0.05, 1),
    st.sampled_from([torch.float32, torch.float64]),
)
def test_a_sample_that_fits_has_fitting_edges_alone(seed, size, noise, reach, thin, dtype):
    # flat samples and far ones, moved apart by about the threshold, as bad for rounding as a solver meets them
    generator = torch.Generator().manual_seed(seed)
    shape = torch.tensor([1.0, thin, thin], dtype=torch.float64)[:, None, None]
    rotation = random_rotation(generator)
    source = reach * (
        rotation
        @ (shape * torch.rand(3, size * 400, dtype=torch.float64, generator=generator).view(3, size, -1)).flatten(1)
    ).view(3, size, -1)
    target = (random_rotation(generator) @ source.flatten(1)).view_as(source)
    target = (target + noise * torch.randn(target.shape, dtype=torch.float64, generator=generator)).to(dtype)
    source = source.to(dtype)
    poses = solve_samples(source, target)
    fits = sample_fits(source, target, *poses, 1.0) & spans_plane(source) & spans_plane(target)
    slack = fitting_slack(source.flatten(1), target.flatten(1), 1.0)
    for a in range(size):
        for b in range(a):
            marks = edge_marks(source[:, a] - source[:, b], target[:, a] - target[:, b], 0.0, slack)
            assert (marks[fits] == FITTING).all()
