"""An answer against the truth: its numbers by other means, and what becomes of exceptions and of nonsense."""

import json
import math
import time

import pytest
import torch
from made_up_methods import answering, posing, raising
from problems import room_pair

import torchreg as tr
from torchreg.benchmark.peers import Answer, Task
from torchreg.benchmark.peers.judge import judged
from torchreg.geometry.se3 import rigid


@pytest.fixture(scope="module")
def room():
    pair = room_pair(600, seed=2)
    return Task(source=pair.source, target=pair.target, voxel=0.1), pair.T_target_source[0]


def off(T, meters):
    return T @ rigid(torch.eye(3, dtype=torch.float64), torch.tensor([meters, 0.0, 0.0], dtype=torch.float64))


def test_the_truth_has_no_error(room):
    task, T = room
    found = judged(posing("truth", lambda _: T), task, T, 0.2, tr.metrics.information_of_matches(task.source.points))
    assert found["rre_deg"] == pytest.approx(0, abs=1e-6)
    assert (found["rte_m"], found["error"], found["success"]) == (0, "", True)
    assert found["rmse_m"] == pytest.approx(0, abs=1e-12)
    assert found["information_rmse_m"] == pytest.approx(0, abs=1e-7)
    assert torch.equal(torch.tensor(found["T"], dtype=torch.float64), T)
    json.dumps(found, allow_nan=False)


def test_errors_are_those_of_the_pose(room):
    task, T = room
    found = judged(posing("off", lambda _: off(T, 0.25), success=False), task, T, 0.2)
    assert found["rte_m"] == pytest.approx(0.25)
    assert found["rmse_m"] == pytest.approx(0.25)
    assert found["information_rmse_m"] is None
    assert found["success"] is False


def test_the_inlier_ratio_is_that_of_its_matches_under_the_truth(room):
    task, T = room
    found = judged(posing("truth", lambda _: T), task, T, 0.2)
    count = min(len(task.source.points), len(task.target.points))
    moved = tr.transform(task.source, T).points[:count]
    apart = (moved - task.target.points[:count]).norm(dim=1)
    assert found["matches"] == count
    assert found["inlier_ratio"] == pytest.approx(float((apart < 0.2).double().mean()))
    silent = judged(answering("silent", lambda _: Answer(T_target_source=T, success=True)), task, T, 0.2)
    assert (silent["matches"], silent["inlier_ratio"]) == (None, None)


def test_the_time_is_that_of_the_method(room):
    task, T = room

    def slow(_):
        time.sleep(0.05)
        return T

    assert 0.05 <= judged(posing("slow", slow), task, T, 0.2)["seconds"] < 1


def test_an_exception_is_a_pair_not_found(room):
    task, T = room
    found = judged(raising("unlucky"), task, T, 0.2)
    assert found["error"] == "RuntimeError: out of luck"
    assert (found["success"], found["inlier_ratio"]) == (False, None)
    assert found["T"] == torch.eye(4).tolist()


def test_a_pose_that_is_no_number_is_a_pair_not_found(room):
    task, T = room
    found = judged(posing("nonsense", lambda _: T * math.nan), task, T, 0.2)
    assert found["success"] is False
    assert "not finite" in found["error"]
    json.dumps(found, allow_nan=False)
