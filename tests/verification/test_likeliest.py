"""The pose of a pair, trusted or not, and none where none was found."""

import torch
from problems import turned
from results import bare_result, candidate, failed_result, verified_result

from torchreg.verification.likeliest import likeliest_pose

IDENTITY = torch.eye(4, dtype=torch.float64)[None]


def test_the_pose_of_a_pair_that_succeeded():
    for result in (bare_result(), verified_result(), verified_result(T_target_source=IDENTITY)):
        assert torch.equal(likeliest_pose(result), result.T_target_source[0])


def test_the_likeliest_pose_of_a_pair_that_was_refused():
    refused = failed_result("ambiguous", T_target_source=turned(10)[None], candidates=((candidate(),),))
    assert torch.equal(likeliest_pose(refused), turned(10))
    by_a_solver = bare_result(success=torch.tensor([False]), failure=refused.failure)
    assert torch.equal(likeliest_pose(by_a_solver), turned(10))


def test_no_pose():
    refused = failed_result("too few matches")
    assert likeliest_pose(failed_result("too few matches", candidates=((),))) is None
    by_a_solver = bare_result(T_target_source=IDENTITY, success=torch.tensor([False]), failure=refused.failure)
    assert likeliest_pose(by_a_solver) is None
