"""A failure names its kind, a sentence with the figures, and the figures themselves."""

import math

import pytest
import torch

from torchreg.verification.candidates import Candidates, Poses
from torchreg.verification.model import Evidence, probabilities
from torchreg.verification.reasons import MARGIN, accepted, failure_of

GOOD = {
    **{"overlap": 0.4, "closeness": 0.8, "normals": 0.9, "colors": 0.8, "strength": 0.2, "conflict": 0.01},
    **{"misses": 0.2, "features": 0.6, "color_features": 0.6},
}
POINTS = torch.rand(200, 3, generator=torch.Generator().manual_seed(0))


def refused(odds, of_best=0.2, surprise=20.0, **changed):
    """The failure of the first of poses with these log-odds, one meter apart; ``of_best``: its strength."""
    count = len(odds)
    shown = {name: torch.full((count,), value, dtype=torch.float64) for name, value in {**GOOD, **changed}.items()}
    steps = torch.arange(count, dtype=torch.float64)[:, None] * torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    zero = torch.zeros(count, dtype=torch.int64)
    poses = Poses(torch.eye(3, dtype=torch.float64).expand(count, 3, 3), steps, zero, zero)
    values = torch.tensor(odds, dtype=torch.float64)
    candidates = Candidates(poses, Evidence(**shown), zero + 9, zero, torch.full_like(values, surprise), values)
    return failure_of(candidates, probabilities(values).tolist(), of_best, POINTS, 0.6)


def test_a_success_has_no_reason():
    assert refused([3.0]) is None
    assert refused([3.0, 0.0]) is None


@pytest.mark.parametrize(
    ("changed", "kind", "words"),
    [
        ({"overlap": 0.02}, "little overlap", "2% of the points"),
        ({"closeness": 0.0}, "surfaces disagree", "1.00 thresholds apart"),
        ({"normals": 0.1}, "surfaces disagree", "cosine of 0.10"),
        ({"colors": 0.0}, "colors disagree", "correlate by 0.00"),
        ({"strength": 0.03}, "sliding", "strength 0.030"),
        ({"conflict": 0.5}, "free-space conflict", "50.0% of the points"),
        ({"surprise": 0.0}, "no consensus", "9 matches agree"),
    ],
)
def test_what_a_pose_lacks_most_is_named(changed, kind, words):
    failure = refused([-1.0], **changed)
    assert failure.kind == kind
    assert words in failure.text
    assert "probability 0.27 of being right, 0.6 is needed" in failure.text
    assert failure.figures["probability"] == pytest.approx(0.2689, abs=1e-4)
    assert failure.figures["support"] == 9
    for name in GOOD.keys() & changed.keys():
        assert failure.figures[name] == pytest.approx(changed[name])


def test_a_small_probability_is_not_said_to_be_zero():
    assert "probability 0.002 of being right" in refused([-6.0], colors=0.0).text


@pytest.mark.parametrize("name", ["colors", "conflict"])
def test_what_a_cloud_does_not_have_is_not_blamed(name):
    assert refused([-1.0], overlap=0.02, **{name: float("nan")}).kind == "little overlap"


def test_an_equal_rival_is_ambiguous_and_told_by_its_distance():
    failure = refused([3.0, 2.9])
    assert failure.kind == "ambiguous"
    assert "a second pose 1 m and 0 degrees away" in failure.text
    assert failure.figures["rival_meters"] == pytest.approx(1.0)
    assert failure.figures["rival_degrees"] == pytest.approx(0.0)
    assert failure.figures["margin"] == pytest.approx(0.1)


def test_a_close_runner_up_is_refused_even_where_the_best_is_probable():
    failure = refused([30.0, 29.5])
    assert failure.kind == "ambiguous"
    assert "log-odds 0.50 above it, 1 are needed" in failure.text


def test_surfaces_that_lie_on_each_other_and_leave_a_motion_open_slide():
    failure = refused([0.0, -0.1], of_best=0.01)
    assert failure.kind == "sliding"
    assert "strength 0.010" in failure.text
    assert failure.figures["strength"] == 0.01
    assert refused([0.0], of_best=0.01, overlap=0.1).kind != "sliding"


@pytest.mark.parametrize(
    ("probability", "odds", "expected"),
    [(0.9, [3.0], True), (0.9, [3.0, 0.5], True), (0.9, [3.0, 2.5], False), (0.5, [0.1], False)],
)
def test_a_success_is_probable_and_ahead_of_its_runner_up(probability, odds, expected):
    assert accepted(probability, torch.tensor(odds, dtype=torch.float64), MARGIN) is expected


def test_without_colors_a_success_is_farther_ahead():
    assert refused([3.0, 1.5]) is None
    assert refused([3.0, 1.5], colors=float("nan")) is not None
    assert refused([3.0, 0.5], colors=float("nan")) is None


def test_a_probability_just_too_low_does_not_read_as_enough():
    failure = refused([math.log(0.598 / 0.402)])
    assert failure is not None
    assert "probability 0.59 of being right, 0.6 is needed" in failure.text
