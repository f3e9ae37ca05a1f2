"""Coverage against hand-made values and Open3D's evaluate_registration."""

import numpy as np
import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from problems import random_transform, room_pair
from refusals import refuses

import torchreg as tr
from torchreg.geometry.se3 import inverse
from torchreg.open3d_loader import load_open3d

EYE = torch.eye(4, dtype=torch.float64)[None]


def line(*places):
    points = torch.zeros(len(places), 3, dtype=torch.float64)
    points[:, 0] = torch.tensor(places, dtype=torch.float64)
    return tr.Clouds(points=points)


def test_hand_made_values():
    source, target = line(0, 1, 2, 10), line(0.3, 1.4, 50)
    # nearest at 0.3, 0.4, 0.6 and 8.6
    assert tr.metrics.fitness(source, target, EYE, 0.5).tolist() == [0.5]
    assert tr.metrics.inlier_rmse(source, target, EYE, 0.5).tolist() == pytest.approx([(0.25 / 2) ** 0.5])
    assert tr.metrics.fitness(target, source, EYE, 0.5).tolist() == pytest.approx([2 / 3])
    assert tr.metrics.overlap(source, target, EYE, 0.5).tolist() == pytest.approx([(1 / 2 + 2 / 3) / 2])


def test_a_distance_of_the_threshold_is_out():
    source, target = line(0, 5), line(0.5, 5.25)
    assert tr.metrics.fitness(source, target, EYE, 0.5).tolist() == [0.5]


def test_no_partner_gives_zero():
    for source, target in ((line(0), line(9)), (line(), line(1)), (line(1), line()), (line(), line())):
        assert tr.metrics.fitness(source, target, EYE, 0.5).tolist() == [0]
        assert tr.metrics.inlier_rmse(source, target, EYE, 0.5).tolist() == [0]
        assert tr.metrics.overlap(source, target, EYE, 0.5).tolist() == [0]


@pytest.mark.parametrize("threshold", [0.02, 0.1, 0.5])
def test_values_are_those_of_open3d(threshold):
    o3d = load_open3d()
    pair = room_pair(1500, dtype=torch.float64)
    nudge = torch.eye(4, dtype=torch.float64)
    nudge[:3, 3] = torch.tensor([0.02, -0.01, 0.03])
    T = nudge @ pair.T_target_source[0]
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.asarray(side.points))) for side in pair[:2]]
    expected = o3d.pipelines.registration.evaluate_registration(*clouds, threshold, T.numpy())
    assert 0 < expected.inlier_rmse < threshold
    fitness = tr.metrics.fitness(pair.source, pair.target, T[None], threshold)
    assert fitness.tolist() == pytest.approx([expected.fitness], abs=1e-12)
    rmse = tr.metrics.inlier_rmse(pair.source, pair.target, T[None], threshold)
    assert rmse.tolist() == pytest.approx([expected.inlier_rmse], rel=1e-9)


def test_origins_are_taken_into_account():
    pair = room_pair(800, dtype=torch.float64)
    at, to = (torch.tensor([[5e5, 5e6, 1e2]], dtype=torch.float64) * sign for sign in (1, -1))
    source = tr.Clouds(points=pair.source.points, origin=at)
    target = tr.Clouds(points=pair.target.points, origin=to)
    shift_back, shift_to = EYE.clone(), EYE.clone()
    shift_back[0, :3, 3], shift_to[0, :3, 3] = -at[0], to[0]
    T = shift_to @ pair.T_target_source @ shift_back
    expected = tr.metrics.fitness(pair.source, pair.target, pair.T_target_source, 0.1)
    assert tr.metrics.fitness(source, target, T, 0.1).tolist() == expected.tolist()
    assert 0.1 < expected < 0.5


def test_overlap_is_symmetric():
    pair = room_pair(800)
    T = pair.T_target_source
    forth = tr.metrics.overlap(pair.source, pair.target, T, 0.1)
    back = tr.metrics.overlap(pair.target, pair.source, inverse(T), 0.1)
    assert close(forth, back, atol=1e-12)


def test_a_batch_equals_the_loop_over_its_pairs():
    pairs = [room_pair(count, seed=count) for count in (300, 700, 100)]
    empty = pairs[0].source.rows(torch.zeros(0, dtype=torch.int64), torch.tensor([0, 0]))
    sources = [pairs[0].source, empty, pairs[1].source, pairs[2].source]
    targets = [pairs[0].target, pairs[0].target, pairs[1].target, pairs[2].target]
    T = torch.cat([pairs[0].T_target_source, EYE, pairs[1].T_target_source, pairs[2].T_target_source])
    source, target = tr.Clouds.pack(sources), tr.Clouds.pack(targets)
    for metric in (tr.metrics.fitness, tr.metrics.inlier_rmse, tr.metrics.overlap):
        alone = [metric(*pair, T[b : b + 1], 0.1) for b, pair in enumerate(zip(sources, targets, strict=True))]
        assert same_bits(metric(source, target, T, 0.1), torch.cat(alone))


def test_the_number_of_threads_changes_nothing():
    pair = room_pair(6000)
    errors = []
    for number in THREADS:
        with threads(number):
            errors.append(tr.metrics.inlier_rmse(pair.source, pair.target, pair.T_target_source, 0.1))
    assert all(same_bits(one, errors[0]) for one in errors)


def test_an_empty_batch_has_no_values():
    none = tr.Clouds(points=torch.zeros(0, 3), offsets=torch.tensor([0]))
    T = torch.zeros(0, 4, 4, dtype=torch.float64)
    assert tr.metrics.fitness(none, none, T, 1.0).shape == (0,)


@pytest.mark.parametrize("metric", [tr.metrics.fitness, tr.metrics.inlier_rmse, tr.metrics.overlap])
def test_what_does_not_fit_is_refused(metric):
    one = line(0, 1)
    two = tr.Clouds.pack([one, one])
    with refuses("threshold", "above 0", "0"):
        metric(one, one, EYE, 0)
    with refuses("T_target_source", "(1, 4, 4)", "(4, 4)"):
        metric(one, one, EYE[0], 1.0)
    with refuses("target", "1 clouds", "2"):
        metric(one, two, EYE, 1.0)
    with refuses("T_target_source", "(2, 4, 4)", "(1, 4, 4)"):
        metric(two, two, random_transform(torch.Generator())[None], 1.0)
