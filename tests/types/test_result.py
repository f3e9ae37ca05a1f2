"""A result checks that all its fields have as many pairs, and a failure that its kind is known."""

import pytest
import torch
from problems import matched
from refusals import refuses
from torch.utils import _pytree as pytree

import torchreg as tr

MATCHES = matched(torch.arange(4), torch.arange(4))
COUNT = torch.zeros(1, dtype=torch.int64)
CLOUD = tr.Clouds(torch.zeros(4, 3))
NUMBER = torch.zeros(1, dtype=torch.float64)
FIELDS = {
    "T_target_source": torch.eye(4, dtype=torch.float64)[None],
    "inliers": torch.zeros(4, dtype=torch.bool),
    "fitness": NUMBER,
    "inlier_rmse": NUMBER,
    "success": torch.zeros(1, dtype=torch.bool),
    "failure": (tr.Failure("no consensus", "no reason"),),
    "hypotheses": tr.HypothesisCounts(COUNT, COUNT, COUNT),
    "source": CLOUD,
    "target": CLOUD,
    "correspondences": MATCHES,
}


def test_pairs_are_counted():
    assert len(tr.RegistrationResult(**FIELDS)) == 1


@pytest.mark.parametrize(
    ("fields", "name", "parts"),
    [
        ({"T_target_source": torch.eye(4, dtype=torch.float64)}, "T_target_source", ["(B, 4, 4)", "(4, 4)"]),
        ({"T_target_source": torch.eye(4)[None]}, "T_target_source", ["float64", "float32"]),
        ({"inliers": torch.zeros(3, dtype=torch.bool)}, "inliers", ["(4,)", "(3,)"]),
        ({"inliers": torch.zeros(4)}, "inliers", ["bool", "float32"]),
        ({"fitness": torch.zeros(2, dtype=torch.float64)}, "fitness", ["(1,)", "(2,)"]),
        ({"fitness": torch.zeros(1)}, "fitness", ["float64", "float32"]),
        ({"inlier_rmse": torch.zeros(1)}, "inlier_rmse", ["float64", "float32"]),
        ({"success": torch.zeros(2, dtype=torch.bool)}, "success", ["(1,)", "(2,)"]),
        ({"success": torch.zeros(1)}, "success", ["bool", "float32"]),
        ({"failure": ()}, "failure", ["one or None per pair (1)", "0"]),
        ({"source": tr.Clouds.pack([CLOUD, CLOUD])}, "source", ["one cloud per pair (1)", "2"]),
        ({"target": tr.Clouds.pack([CLOUD, CLOUD])}, "target", ["one cloud per pair (1)", "2"]),
        ({"hypotheses": tr.HypothesisCounts(COUNT, torch.zeros(2), COUNT)}, "hypotheses.kept", ["(1,)", "(2,)"]),
        ({"options": (tr.PAPER, tr.PAPER)}, "options", ["(1)", "2"]),
        ({"notes": ((), ())}, "notes", ["(1)", "2"]),
    ],
)
def test_what_does_not_fit_is_refused(fields, name, parts):
    with refuses(name, *parts):
        tr.RegistrationResult(**(FIELDS | fields))


def test_the_reason_is_the_text_of_the_failure():
    assert tr.RegistrationResult(**FIELDS).reason == ("no reason",)
    assert tr.RegistrationResult(**(FIELDS | {"failure": (None,)})).reason == ("",)


def test_a_failure_of_an_unknown_kind_is_refused():
    with refuses("kind", "'no consensus'", "'bad luck'"):
        tr.Failure("bad luck", "no reason")


def test_results_of_two_runs_become_one_whose_times_add_up():
    runs = [
        tr.RegistrationResult(**FIELDS, seconds=times)
        for times in ((("search", 1.0),), (("search", 2.0), ("icp", 0.5)))
    ]
    both = tr.RegistrationResult.pack(runs)
    assert len(both) == 2
    assert dict(both.seconds) == {"search": 3.0, "icp": 0.5}
    mean = pytree.tree_map(lambda one, other: (one + other) / 2 if one.is_floating_point() else one, *runs)
    assert dict(mean.seconds) == {"search": 1.0}
