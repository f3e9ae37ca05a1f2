"""What a link must be."""

import pytest
import torch
from refusals import refuses

from torchreg.site import KnownPose, Link, loose_covariance

EYE = torch.eye(4, dtype=torch.float64)


def link(**changes):
    fields = {
        "target": 0,
        "source": 1,
        "T_target_source": EYE,
        "log_odds": 1.0,
        "probability": 0.7,
        "covariance": loose_covariance(0.01, 10.0),
    }
    return Link(**{**fields, **changes})


def test_a_loose_covariance_moves_by_the_shift_at_the_reach():
    deviation = loose_covariance(0.05, 10.0).diagonal().sqrt()
    assert torch.allclose(deviation * torch.tensor([10.0, 10, 10, 1, 1, 1]), torch.full((6,), 0.05).double())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"source": 0}, ("source", "another scan")),
        ({"target": -1}, ("target", "at least 0", "-1")),
        ({"T_target_source": 2 * EYE}, ("T_target_source",)),
        ({"T_target_source": EYE.float()}, ("T_target_source", "float64")),
        ({"log_odds": float("nan")}, ("log_odds", "a number")),
        ({"probability": 1.2}, ("probability", "1.2")),
        ({"covariance": torch.zeros(6, 6, dtype=torch.float64)}, ("covariance", "positive definite")),
        ({"covariance": torch.full((6, 6), torch.nan, dtype=torch.float64)}, ("covariance", "positive definite")),
        ({"covariance": -torch.eye(6, dtype=torch.float64)}, ("covariance", "positive definite")),
        (
            {
                "covariance": torch.eye(6, dtype=torch.float64)
                + torch.eye(6, dtype=torch.float64)[:, [1, 0, 2, 3, 4, 5]].triu()
            },
            ("covariance", "symmetric"),
        ),
        ({"center": torch.full((3,), torch.inf, dtype=torch.float64)}, ("center", "finite")),
        ({"rank": -1}, ("rank", "-1")),
    ],
)
def test_what_no_link_can_be_is_refused(changes, words):
    link()
    with refuses(*words):
        link(**changes)


def test_what_no_known_pose_can_be_is_refused():
    with refuses("T_world_scan"):
        KnownPose(scan=0, T_world_scan=2 * EYE, covariance=loose_covariance(0.01, 1.0))
    with refuses("covariance", "positive definite"):
        KnownPose(scan=0, T_world_scan=EYE, covariance=torch.zeros(6, 6, dtype=torch.float64))
