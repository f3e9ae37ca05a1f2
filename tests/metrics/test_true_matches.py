"""Errors over true matches: against a plain loop, and the information matrix against the points it sums up."""

import math

import pytest
import torch
from problems import random_transform, room_pair
from refusals import refuses

import torchreg as tr
from torchreg.geometry.se3 import apply, inverse, rigid
from torchreg.metrics import information_of_matches, rmse_by_information, rmse_of_true_matches


def turned(axis, degrees):
    """A rotation about an axis by Rodrigues' formula."""
    axis = torch.nn.functional.normalize(torch.tensor(axis, dtype=torch.float64), dim=0)
    x, y, z = axis.tolist()
    K = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    angle = math.radians(degrees)
    return torch.eye(3, dtype=torch.float64) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def a_little_off(meters, degrees, seed=0):
    g = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(torch.randn(3, dtype=torch.float64, generator=g), dim=0)
    return rigid(turned(torch.randn(3, generator=g).tolist(), degrees), meters * direction)


def by_hand(pair, T_true, T_estimated, threshold):
    """Point by point, all distances at once."""
    moved = apply(T_true, pair.source.points.double() + pair.source.origin)
    target = pair.target.points.double() + pair.target.origin
    near = torch.cdist(moved, target).amin(dim=1) < threshold
    found = apply(T_estimated, pair.source.points.double() + pair.source.origin)
    return (found - moved)[near].square().sum(dim=1).mean().sqrt()


def test_only_points_that_overlap_count():
    pair = room_pair(500, seed=1)
    T_true = pair.T_target_source
    T_estimated = T_true @ a_little_off(0.3, 20.0)
    expected = by_hand(pair, T_true[0], T_estimated[0], 0.15)
    found = rmse_of_true_matches(pair.source, pair.target, T_true, T_estimated, 0.15)
    assert torch.allclose(found, expected[None], rtol=1e-9)
    whole = tr.metrics.rmse(T_true[0], T_estimated[0], pair.source.points.double())
    assert abs(float(found) - float(whole)) > 1e-3  # so that the choice of points shows


def test_a_batch_and_origins_change_nothing():
    pairs = [room_pair(300, seed=seed) for seed in (1, 2)]
    T = torch.cat([pair.T_target_source for pair in pairs])
    off = T @ a_little_off(0.1, 5.0)
    shift = torch.tensor([[5e5, 4e6, 100.0]], dtype=torch.float64)
    source = tr.Clouds.pack([pair.source for pair in pairs])
    target = tr.Clouds.pack([pair.target for pair in pairs])
    found = rmse_of_true_matches(source, target, T, off, 0.15)
    alone = [rmse_of_true_matches(*pair[:2], T[b : b + 1], off[b : b + 1], 0.15) for b, pair in enumerate(pairs)]
    assert torch.equal(found, torch.cat(alone))
    far = tr.Clouds(points=pairs[0].source.points, origin=shift)
    there = rigid(torch.eye(3, dtype=torch.float64), shift[0])
    moved = [matrix[:1] @ inverse(there) for matrix in (T, off)]
    again = rmse_of_true_matches(far, pairs[0].target, *moved, 0.15)
    assert torch.allclose(again, found[:1], atol=1e-6)


def test_nothing_that_overlaps_is_an_infinite_error():
    pair = room_pair(200)
    away = pair.T_target_source.clone()
    away[0, :3, 3] += 100
    assert rmse_of_true_matches(pair.source, pair.target, away, away, 0.1).tolist() == [math.inf]
    assert rmse_by_information(away[0], away[0], torch.zeros(6, 6)).tolist() == math.inf


@pytest.mark.parametrize(("meters", "degrees", "within"), [(0.3, 0.0, 1e-9), (0.05, 2.0, 2e-3), (0.0, 40.0, 1e-9)])
def test_the_information_stands_for_the_points(meters, degrees, within):
    g = torch.Generator().manual_seed(3)
    points = 3 * torch.randn(200, 3, dtype=torch.float64, generator=g) + 2
    T_true = random_transform(g)
    T_estimated = T_true @ a_little_off(meters, degrees)
    found = rmse_by_information(T_true, T_estimated, information_of_matches(points))
    expected = tr.metrics.rmse(T_true, T_estimated, points)
    assert float(found) == pytest.approx(float(expected), rel=within)


def test_the_information_is_the_sum_over_its_points():
    p = torch.tensor([[1.0, 2.0, 3.0]])
    G = torch.tensor([[1, 0, 0, 0, 6, -4], [0, 1, 0, -6, 0, 2], [0, 0, 1, 4, -2, 0]], dtype=torch.float64)
    assert torch.equal(information_of_matches(p), G.t() @ G)
    assert torch.equal(information_of_matches(p.repeat(5, 1)), 5 * G.t() @ G)


def test_half_turns_are_finite_and_far():
    points = torch.randn(50, 3, generator=torch.Generator().manual_seed(0)).double()
    half = rigid(turned([1.0, 2.0, 0.5], 180.0), torch.zeros(3, dtype=torch.float64))
    found = float(rmse_by_information(torch.eye(4), half, information_of_matches(points)))
    assert math.isfinite(found)
    assert found > 0.5


def test_refused():
    pair = room_pair(200)
    with refuses("threshold", "above 0"):
        rmse_of_true_matches(pair.source, pair.target, pair.T_target_source, pair.T_target_source, 0)
    with refuses("T_estimated", "(1, 4, 4)"):
        rmse_of_true_matches(pair.source, pair.target, pair.T_target_source, pair.T_target_source[0], 0.1)
    with refuses("information", "(..., 6, 6)"):
        rmse_by_information(torch.eye(4), torch.eye(4), torch.eye(4))
