"""``verify`` with refinement: residuals at the pose as given, and the settled pose is the refined one."""

import pytest
import torch
from problems import room_pair, turned

import torchreg as tr

RESIDUALS = ("residual_median", "residual_rms", "residual_95")


@pytest.fixture(scope="module")
def room():
    pair = room_pair(1800, seed=3)
    return pair.source, pair.target, pair.T_target_source[0]


@pytest.fixture(scope="module")
def registered(room):
    return tr.register(*room[:2])


def moved(meters):
    return turned(0.0, translation=(meters, 0.0, 0.0))


def test_the_settled_pose_is_the_refined_one(room, registered):
    source, target, T = room
    result = tr.verify(source, target, moved(0.02) @ T)
    assert float(tr.metrics.rmse(registered.T_target_source[0], result.settled[0], source.points)) < 2e-4
    assert torch.equal(result.settled, result.search.T_target_source)
    without = tr.verify(source, target, moved(0.02) @ T, refine="none")
    off = [float(tr.metrics.rmse(T, each.settled[0], source.points)) for each in (result, without)]
    assert off[0] < off[1]
    assert torch.equal(without.settled[0], without.settled_candidate[0].T_target_source)


def test_the_pose_to_take_in_place_of_a_wrong_one_is_refined_too(room, registered):
    source, target, T = room
    wrong = tr.verify(source, target, turned(180.0) @ T)
    assert wrong.reason[0].startswith("another pose is better")
    assert torch.equal(wrong.likeliest, wrong.search.T_target_source)
    assert float(tr.metrics.rmse(registered.T_target_source[0], wrong.likeliest[0], source.points)) < 2e-4
    right = tr.verify(source, target, T)
    assert torch.equal(right.likeliest, right.settled)


def test_the_deviation_is_from_the_refined_pose(room, registered):
    source, target, T = room
    given = moved(0.03) @ T
    result = tr.verify(source, target, given)
    expected = tr.metrics.rmse(registered.T_target_source[0], given, result.source.points)
    assert float(result.deviation_meters[0]) == pytest.approx(float(expected), rel=1e-6)
    at_the_pose = tr.verify(source, target, registered.T_target_source)
    assert float(at_the_pose.deviation_meters[0]) < 1e-6
    assert float(at_the_pose.deviation_degrees[0]) < 1e-5


def test_residuals_are_those_at_the_pose_as_given(room, registered):
    source, target, _ = room
    best = tr.verify(source, target, registered.T_target_source)
    for name in RESIDUALS:
        own, refined = getattr(best, name), getattr(registered, name)
        torch.testing.assert_close(own, refined, rtol=0.05, atol=0)
    medians = []
    for meters in (0.0, 0.02, 0.05):
        result = tr.verify(source, target, moved(meters) @ registered.T_target_source[0])
        medians.append(float(result.residual_median[0]))
    assert medians[0] < medians[1] < medians[2]
    assert medians[2] > 0.01


def test_residuals_need_surfaces_that_meet_and_refinement(room):
    source, target, T = room
    for result in (tr.verify(source, target, moved(100.0) @ T), tr.verify(source, target, T, refine="none")):
        assert all(bool(getattr(result, name).isnan().all()) for name in RESIDUALS)
    far = tr.verify(source, target, moved(0.9) @ T)
    assert not bool(far.success[0])
    assert bool(far.residual_rms.isfinite().all())  # of what lies on each other there


def test_a_point_alone_has_no_residuals(room):
    source, target, T = room
    single = tr.Clouds(points=torch.zeros(2, 3), colors=torch.zeros(2, 3), viewpoint=torch.zeros(1, 3))
    both = tr.Clouds.pack([source, single]), tr.Clouds.pack([target, single])
    result = tr.verify(*both, T)
    for name in RESIDUALS:
        assert getattr(result, name).isnan().tolist() == [False, True]
