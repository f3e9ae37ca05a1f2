"""Correspondence problems: what they say is true is true."""

import pytest
import torch
from determinism import same_bits

from torchreg.datasets import match_problem


def residuals(problem):
    T = problem.T_target_source[0]
    moved = problem.source.points[problem.matches.source].double() @ T[:3, :3].t() + T[:3, 3]
    return (moved - problem.target.points[problem.matches.target]).norm(dim=1)


@pytest.mark.parametrize("place", ["cube", "room"])
def test_right_matches_are_near_and_wrong_ones_are_not(place):
    problem = match_problem(2000, 0.9, place=place, noise=0.01)
    assert problem.is_inlier.sum() == 200
    assert residuals(problem)[problem.is_inlier].max() < 0.06
    assert (residuals(problem)[~problem.is_inlier] > 0.06).float().mean() > 0.99


@pytest.mark.parametrize("outlier_ratio", [0.0, 1.0])
def test_all_or_none_may_be_right(outlier_ratio):
    problem = match_problem(50, outlier_ratio, place="room")
    assert problem.is_inlier.float().mean() == 1 - outlier_ratio


def test_points_of_a_room_lie_on_its_faces():
    points = match_problem(500, 0.5, place="room").source.points
    on_wall = (points[:, :1] % 10 == 0).any(dim=1) | (points[:, 1:2] % 7 == 0).any(dim=1) | (points[:, 2] % 4 == 0)
    assert 0.7 < on_wall.float().mean() < 1


def test_rivals_agree_on_half_a_turn():
    problem = match_problem(1000, 0.8, rival=0.3)
    T = problem.T_target_source[0]
    world = (problem.target.points[problem.matches.target] - T[:3, 3]) @ T[:3, :3]
    turned = problem.source.points.clone()
    turned[:, :2] = 10 - turned[:, :2]
    near = (world - turned).norm(dim=1) < 1e-9
    assert near.sum() == 300
    assert not (near & problem.is_inlier).any()


def test_scores_are_smaller_for_right_matches_on_average():
    problem = match_problem(2000, 0.5)
    score, right = problem.matches.score, problem.is_inlier
    assert score[right].mean() < score[~right].mean()
    assert score[right].max() > score[~right].min()


def test_the_seed_decides():
    one, other, third = (match_problem(100, 0.5, seed=seed) for seed in (1, 1, 2))
    assert same_bits(one, other)
    assert not torch.equal(one.source.points, third.source.points)
    assert match_problem(100, 0.5, dtype=torch.float32).source.points.dtype == torch.float32


@pytest.mark.parametrize(
    "wrong", [{"count": 0}, {"outlier_ratio": 1.5}, {"place": "sea"}, {"size": 0.0}, {"rival": 0.9}]
)
def test_what_does_not_fit_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        match_problem(**({"count": 10, "outlier_ratio": 0.5} | wrong))
