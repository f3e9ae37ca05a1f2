"""Distances of poses are displacements of points, and a dominating mode leaves room for others."""

import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import matched, random_rotation

import torchreg as tr
from torchreg.datasets import match_problem
from torchreg.solvers import Hypotheses, MatchedPoints, poses_of_pairs
from torchreg.solvers.poses import APART, POSES, pose_vectors, spread_out

OPTIONS = tr.RansacOptions(hypotheses=50_000)


def poses(count, seed=0):
    generator = torch.Generator().manual_seed(seed)
    rotation = torch.stack([random_rotation(generator) for _ in range(count)], dim=-1)
    return rotation, torch.randn(3, count, dtype=torch.float64, generator=generator)


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.integers(1, 30))
def test_distances_are_rms_displacements(seed, points):
    rotation, translation = poses(2, seed)
    source = torch.randn(3, points, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) + 5
    moved = torch.einsum("ijh,jm->him", rotation, source) + translation.t()[:, :, None]
    expected = (moved[0] - moved[1]).square().sum(dim=0).mean().sqrt()
    vectors = pose_vectors(rotation, translation, source)
    assert close((vectors[:, 0] - vectors[:, 1]).norm(), expected, atol=1e-9)


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.integers(0, 60), st.floats(0.1, 3), st.integers(1, 20))
def test_the_choice_is_the_greedy_one(seed, count, radius, most):
    vectors = torch.randn(12, count, generator=torch.Generator().manual_seed(seed)) / 2
    chosen = []
    for h in range(count):
        near = [float((vectors[:, h] - vectors[:, c]).norm()) <= radius for c in chosen]
        if len(chosen) < most and not any(near):
            chosen.append(h)
    assert spread_out(vectors, torch.zeros(count).long(), [radius], most).tolist() == chosen


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.lists(st.integers(0, 40), min_size=1, max_size=6), st.integers(1, 9))
def test_the_choice_among_several_pairs_is_that_among_each(seed, counts, most):
    generator = torch.Generator().manual_seed(seed)
    each = [torch.randn(12, count, generator=generator) / 2 for count in counts]
    radii = [0.5 * (place + 1) for place in range(len(counts))]
    pair = torch.arange(len(counts)).repeat_interleave(torch.tensor(counts))
    begins = [0, *torch.tensor(counts).cumsum(0).tolist()]
    expected = [
        begin + place
        for begin, vectors, radius in zip(begins, each, radii, strict=False)
        for place in spread_out(vectors, torch.zeros(vectors.shape[1]).long(), [radius], most).tolist()
    ]
    assert spread_out(torch.cat(each, dim=1), pair, radii, most).tolist() == expected


def test_a_dominating_mode_does_not_push_out_another():
    # a rival with a quarter of the support: by count alone it comes after hundreds of hypotheses of the best mode
    problem = match_problem(1000, 0.6, rival=0.1, place="room")
    found = poses_of_pairs(problem.source, problem.target, problem.matches, [OPTIONS], 0)[0]
    assert found.inliers[0][problem.is_inlier].all()
    rivals = found.inliers[1] & ~problem.is_inlier
    assert rivals.sum() >= 99
    assert (found.support[2:] < 100).all()


def test_poses_are_apart_and_no_more_than_promised():
    problem = match_problem(500, 0.9)
    found = poses_of_pairs(problem.source, problem.target, problem.matches, [OPTIONS], 0)[0]
    assert 1 < len(found.support) <= POSES
    source = problem.source.points[problem.matches.source].t()
    vectors = pose_vectors(found.rotation.permute(1, 2, 0), found.translation.t(), source)
    apart = torch.cdist(vectors.t(), vectors.t()).fill_diagonal_(torch.inf)
    assert apart.min() > APART * OPTIONS.inlier_threshold * 0.999


def test_the_poses_hold_in_the_frames_of_the_points():
    problem = match_problem(500, 0.7)
    far = tr.Clouds(points=problem.source.points, origin=torch.tensor([[5e5, 1e6, 3.0]], dtype=torch.float64))
    found = poses_of_pairs(far, problem.target, problem.matches, [OPTIONS], 0)[0]
    for h in range(len(found.support)):
        moved = problem.source.points @ found.rotation[h].t() + found.translation[h]
        square = (moved[problem.matches.source] - problem.target.points[problem.matches.target]).square().sum(dim=1)
        assert torch.equal(found.inliers[h], square < 0.2**2)
        assert found.support[h] == found.inliers[h].sum()
        assert close(found.error[h], square[found.inliers[h]].sum(), atol=1e-9)


def test_no_pose_comes_with_a_reason():
    cloud = tr.Clouds(points=torch.ones(30, 3))
    rows = torch.arange(30)
    found = poses_of_pairs(cloud, cloud, matched(rows, rows), [OPTIONS], 0)[0]
    assert found.rotation.shape == (0, 3, 3)
    assert found.inliers.shape == (0, 30)
    assert found.failure.text.startswith("no hypothesis left")


@pytest.mark.parametrize("outlier_ratio", [0.6, 1.0])
def test_the_number_of_threads_changes_no_bit_of_any_pose(outlier_ratio):
    problem = match_problem(900, outlier_ratio, noise=0.1, size=3.0)
    found = []
    for number in THREADS:
        with threads(number):
            found.append(tuple(poses_of_pairs(problem.source, problem.target, problem.matches, [OPTIONS], 0)[0]))
    assert all(same_bits(one, found[0]) for one in found)


def test_hypotheses_keep_the_best_in_their_order(monkeypatch):
    rotation, translation = poses(300)
    source, target = torch.rand(2, 3, 40, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    monkeypatch.setattr("torchreg.solvers.solver._STORED", 30)
    hypotheses = Hypotheses(MatchedPoints(source, target, torch.zeros(40), 0), 1e-3 + 1.0)
    assert hypotheses.failure.kind == "no hypothesis"
    counts = []
    for begin in range(0, 300, 50):
        part = slice(begin, begin + 50)
        counts += hypotheses.add(rotation[..., part], translation[:, part]).tolist()
    assert len(set(counts)) > 5
    expected = sorted(range(300), key=lambda h: (-counts[h], h))[:20]
    best_rotation, best_translation = hypotheses.best(20)
    assert (hypotheses.total, hypotheses.failure) == (300, None)
    assert hypotheses.stored <= 60
    assert torch.equal(best_translation, translation[:, expected].to(hypotheses.dtype))
    assert torch.equal(best_rotation, rotation[..., expected].to(hypotheses.dtype))
