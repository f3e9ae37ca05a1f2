"""The edge test as Open3D's checker has it, what fits is never dropped before its solve, and degenerate samples."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_rotation, random_transform

from torchreg.solvers.ransac.minimal import sample_fits, solve_samples
from torchreg.solvers.ransac.prune import DISSIMILAR, FITTING, SIMILAR, edge_marks, fitting_slack, spans_plane


def edges(count, seed=0, spread=0.3):
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
    source, target = edges(80, seed)
    assert edge_marks(source, target, similarity, slack).tolist() == by_lengths(source, target, similarity, slack)


def test_a_rigid_motion_passes_every_similarity_below_1():
    source, _ = edges(200)
    T = random_transform(torch.Generator().manual_seed(0))
    assert (edge_marks(source, T[:3, :3] @ source, 1 - 1e-9, 1e-9) == FITTING).all()


def test_the_edge_test_is_symmetric():
    source, target = edges(500)
    forth = edge_marks(source, target, 0.7, 0.1)
    assert torch.equal(forth, edge_marks(target, source, 0.7, 0.1))
    assert sorted(forth.unique().tolist()) == [DISSIMILAR, SIMILAR, FITTING]


def test_an_edge_without_length_never_passes():
    source, target = edges(10)
    for one, other in ((torch.zeros_like(source), target), (source, torch.zeros_like(target))):
        assert (edge_marks(one, other, 0.0, 100.0) == DISSIMILAR).all()


def test_a_higher_similarity_keeps_a_part():
    source, target = edges(2000)
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


@pytest.mark.parametrize(("degrees", "spans"), [(0.0, False), (2.0, False), (4.0, True), (90.0, True), (178.0, False)])
def test_points_nearly_on_a_line_leave_the_rotation_open(degrees, spans):
    angle = torch.tensor(degrees).deg2rad()
    points = torch.tensor([[0.0, 0, 0], [2, 0, 0], [float(angle.cos()), float(angle.sin()), 0]]).t()[..., None]
    assert spans_plane(points).tolist() == [spans]
    assert spans_plane(1e3 * points + 7).tolist() == [spans]


def test_coincident_points_span_nothing():
    assert spans_plane(torch.ones(3, 3, 2)).tolist() == [False, False]
