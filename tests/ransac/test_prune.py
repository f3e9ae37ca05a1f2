"""The edge test as Open3D's checker has it, and degenerate samples."""

from itertools import combinations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_transform

from torchreg.ransac.prune import similar_edges, spans_plane


def by_lengths(source, target, similarity):
    """Open3D's rule, sample by sample: both ratios of every edge at least the similarity."""
    kept = []
    for r in range(source.shape[2]):
        good = True
        for i, j in combinations(range(source.shape[1]), 2):
            a = float((source[:, i, r] - source[:, j, r]).norm())
            b = float((target[:, i, r] - target[:, j, r]).norm())
            good = good and a >= similarity * b and b >= similarity * a and a > 0 and b > 0
        kept.append(good)
    return kept


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(3, 5), st.floats(0, 1))
def test_samples_pass_by_the_lengths_of_their_edges(seed, size, similarity):
    generator = torch.Generator().manual_seed(seed)
    source = torch.randn(3, size, 50, dtype=torch.float64, generator=generator)
    target = source + 0.3 * torch.randn(3, size, 50, dtype=torch.float64, generator=generator)
    assert similar_edges(source, target, similarity).tolist() == by_lengths(source, target, similarity)


@pytest.mark.parametrize("size", [3, 4])
def test_a_rigid_motion_passes_every_similarity_below_1(size):
    generator = torch.Generator().manual_seed(0)
    source = torch.randn(3, size, 200, dtype=torch.float64, generator=generator)
    T = random_transform(generator)
    target = torch.einsum("ij,jsr->isr", T[:3, :3], source) + T[:3, 3, None, None]
    assert similar_edges(source, target, 1 - 1e-9).all()


def test_the_edge_test_is_symmetric():
    source, target = torch.randn(2, 3, 3, 500, generator=torch.Generator().manual_seed(1))
    forth = similar_edges(source, target, 0.7)
    assert torch.equal(forth, similar_edges(target, source, 0.7))
    assert forth.any()
    assert not forth.all()


def test_a_point_drawn_twice_never_passes():
    source = torch.rand(3, 3, 10, generator=torch.Generator().manual_seed(2))
    source[:, 1] = source[:, 0]
    assert not similar_edges(source, source, 0.0).any()


def test_a_higher_similarity_keeps_a_part():
    source, target = torch.randn(2, 3, 3, 2000, generator=torch.Generator().manual_seed(3))
    kept = [int(similar_edges(source, target, similarity).sum()) for similarity in (0.0, 0.3, 0.6, 0.9)]
    assert kept[0] == 2000
    assert kept == sorted(kept, reverse=True)
    assert len(set(kept)) == 4


@pytest.mark.parametrize(("degrees", "spans"), [(0.0, False), (2.0, False), (4.0, True), (90.0, True), (178.0, False)])
def test_points_nearly_on_a_line_leave_the_rotation_open(degrees, spans):
    angle = torch.tensor(degrees).deg2rad()
    points = torch.tensor([[0.0, 0, 0], [2, 0, 0], [float(angle.cos()), float(angle.sin()), 0]]).t()[..., None]
    assert spans_plane(points).tolist() == [spans]
    assert spans_plane(1e3 * points + 7).tolist() == [spans]


def test_coincident_points_span_nothing():
    assert spans_plane(torch.ones(3, 3, 2)).tolist() == [False, False]
