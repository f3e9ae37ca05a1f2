"""Poses by least squares: the truth without noise, errors as covariances say, wrong links that lose their weight."""

import torch
from closeness import close
from problems import numbers, seeded
from sites import link_of, made_poses, near_pairs, right_link

from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of, rotation_vector
from torchreg.site.graph import residuals, site_graph
from torchreg.site.optimize import settle_poses


def moved_frames(poses, graph):
    """True poses (N + 1, 4, 4) of the moved frames of a graph, the world at the identity."""
    frames = torch.cat([poses, torch.eye(4, dtype=torch.float64)[None]])
    return compose(frames, rigid(torch.eye(3, dtype=torch.float64).expand(len(frames), 3, 3), graph.zero))


def held(count):
    """The first scan and the world stay."""
    fixed = torch.zeros(count + 1, dtype=torch.bool)
    fixed[[0, count]] = True
    return fixed


def off(poses, fixed, turn=0.03, shift=0.2, seed=0):
    """Poses away from these, but for those that stay."""
    x, y = numbers(2, len(poses), 3, seed=seed)
    return torch.where(fixed[:, None, None], poses, compose(poses, rigid(rotation_of(turn * x), shift * y)))


def exact(poses, pair):
    return link_of(pair, compose(inverse(poses[pair[0]]), poses[pair[1]]), 4.0)


def test_links_without_noise_have_no_residual_and_give_the_truth():
    poses = made_poses(12)
    graph = site_graph([exact(poses, pair) for pair in near_pairs(poses, 30)], (), 12)
    truth, fixed = moved_frames(poses, graph), held(12)
    assert close(residuals(graph, truth), torch.zeros(30, 6, dtype=torch.float64), 1e-12)
    settled = settle_poses(graph, off(truth, fixed), fixed)
    assert close(settled.poses, truth, 1e-9)
    assert settled.scale == 1


def test_residuals_are_those_of_a_motion_about_the_center():
    poses = made_poses(2)
    center = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    turn, shift = 0.1 * numbers(2, 3)
    R = rotation_of(turn)
    true = compose(inverse(poses[0]), poses[1])
    link = link_of((0, 1), compose(inverse(rigid(R, center + shift - R @ center)), true), 4.0, center=center)
    graph = site_graph([link], (), 2)
    assert close(residuals(graph, moved_frames(poses, graph))[0], torch.cat([turn, shift]), 1e-12)


def test_errors_are_as_large_as_the_covariance_says():
    squares = []
    for seed in range(6):
        poses = made_poses(20, seed)
        generator = seeded(seed)
        graph = site_graph([right_link(poses, pair, generator) for pair in near_pairs(poses, 70)], (), 20)
        truth, fixed = moved_frames(poses, graph), held(20)
        settled = settle_poses(graph, truth, fixed)
        D = compose(inverse(truth), settled.poses)[1:20]
        error = torch.cat([rotation_vector(D[:, :3, :3]), D[:, :3, 3]], dim=1)
        squares.append((error * torch.linalg.solve(settled.covariance[1:20], error)).sum(1).mean() / 6)
    assert 0.4 < float(torch.stack(squares).mean()) < 1.6


def test_a_wrong_link_loses_its_weight():
    poses = made_poses(10)
    links = [exact(poses, pair) for pair in near_pairs(poses, 24)]
    wrong = compose(links[5].T_target_source, rigid(rotation_of(numbers(3)), numbers(3)))
    links[5] = link_of((links[5].target, links[5].source), wrong, 4.0)
    graph = site_graph(links, (), 10)
    truth, fixed = moved_frames(poses, graph), held(10)
    settled = settle_poses(graph, off(truth, fixed), fixed)
    assert close(settled.poses, truth, 1e-4)
    assert [number for number, weight in zip(graph.number.tolist(), settled.weight, strict=True) if weight < 0.5] == [5]


def test_covariances_that_promise_too_much_are_found_out():
    poses, generator = made_poses(30), seeded()
    links = [right_link(poses, pair, generator, noise=5.0) for pair in near_pairs(poses, 150)]
    graph = site_graph(links, (), 30)
    assert 15 < settle_poses(graph, moved_frames(poses, graph), held(30)).scale < 40
