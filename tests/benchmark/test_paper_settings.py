"""The paper's settings and printed numbers, held against what its text says of them."""

import itertools
from dataclasses import replace

import pytest
import torch

from torchreg.benchmark.paper.methods import METHODS, PLAIN_HUE, options_of
from torchreg.benchmark.paper.printed import ERRORS, FPFH, FUSED, SECONDS
from torchreg.benchmark.paper.settings import EXPERIMENTS, SETTINGS, TABLES, InitialPose, settings_of
from torchreg.registration import PAPER


def reduction(experiment, setting, measure):
    """By how many percent color lowers an error."""
    one, other = (getattr(ERRORS[experiment, setting, method], measure) for method in (FPFH, FUSED))
    return 100 * (1 - other / one)


@pytest.mark.parametrize(
    ("experiment", "setting", "rre", "rte", "rmse"),
    [(1, "2", 74.9, 67.4, 74.6), (3, "0.5k", 26.2, 30.82, 27.73), (5, "road", 66.2, 63.4, 59.8)],
)
def test_reductions_are_those_that_the_text_states(experiment, setting, rre, rte, rmse):
    # its discussion of Tables 5, 7 and 9
    found = [reduction(experiment, setting, name) for name in ("rre_degrees", "rte_meters", "rmse_meters")]
    assert found == pytest.approx([rre, rte, rmse], abs=0.1)


def test_numbers_of_the_text_and_of_the_tables_agree():
    assert ERRORS[1, "1", FPFH].rte_meters == 0.0638
    assert ERRORS[1, "1", FUSED].rte_meters == 0.104
    assert tuple(ERRORS[2, "12k / 4k", FUSED]) == (2.1, 0.048, 0.2)
    assert SECONDS["4k", FUSED] == 0.00036


def test_every_setting_has_printed_numbers_for_both_methods_and_no_other():
    wanted = {(s.experiment, s.name, method) for s in SETTINGS for method in (FPFH, FUSED)}
    assert ERRORS.keys() == wanted
    assert SECONDS.keys() == {(s.name, method) for s in settings_of(3) for method in (FPFH, FUSED)}


def test_settings_are_those_of_section_4():
    counts = {number: [s.points for s in settings_of(number)] for number in EXPERIMENTS}
    assert counts[1] == [(10_000, 10_000)] * 3
    assert counts[2] == [(12_000, 4_000)]
    assert counts[3] == [(n, n) for n in (4_000, 2_000, 1_000, 500)]
    assert counts[4] == []
    assert counts[5] == [(10_000, 10_000)]
    assert TABLES == {1: 5, 2: 6, 3: 7, 4: 8, 5: 9}
    assert [s.outdoor for s in SETTINGS] == [s.experiment == 5 for s in SETTINGS]


def test_initial_poses_are_rigid_and_differ():
    matrices = [setting.pose.matrix() for setting in SETTINGS]
    for T, setting in zip(matrices, SETTINGS, strict=True):
        torch.testing.assert_close(T[:3, :3] @ T[:3, :3].T, torch.eye(3, dtype=torch.float64))
        assert float(torch.det(T[:3, :3])) == pytest.approx(1)
        assert T[:3, 3].tolist() == [setting.pose.x, setting.pose.y, setting.pose.z]
    assert not any(torch.equal(a, b) for a, b in itertools.combinations(matrices, 2))


@pytest.mark.parametrize(
    ("pose", "taken", "to"),
    [
        (InitialPose(90, 0, 0, 0, 0, 0), (0, 1, 0), (0, 0, 1)),
        (InitialPose(0, 90, 0, 0, 0, 0), (0, 0, 1), (1, 0, 0)),
        (InitialPose(0, 0, 90, 0, 0, 0), (1, 0, 0), (0, 1, 0)),
        (InitialPose(90, 0, 90, 0, 0, 5), (0, 0, 1), (1, 0, 5)),  # roll first, then yaw, then the shift
    ],
)
def test_roll_pitch_and_yaw_turn_about_x_y_and_z(pose, taken, to):
    T = pose.matrix()
    moved = T[:3, :3] @ torch.tensor(taken, dtype=torch.float64) + T[:3, 3]
    torch.testing.assert_close(moved, torch.tensor(to, dtype=torch.float64))


def test_methods_are_the_paper_preset_and_two_changes_of_it():
    assert options_of(FUSED) == PAPER
    assert options_of(FPFH).color == ()
    assert options_of(PLAIN_HUE).equalization == "none"
    assert options_of(PLAIN_HUE).color == PAPER.color
    assert set(METHODS) == {FPFH, FUSED, PLAIN_HUE}


def test_scale_changes_every_length_and_nothing_else():
    small = options_of(FUSED, scale=0.25, hypotheses=99)
    lengths = (small.normal_radius, small.feature_radius, small.color_radius, small.ransac.inlier_threshold)
    assert lengths == (0.5, 1.25, 0.5, 0.05)
    assert small.ransac.hypotheses == 99
    assert (small.color_bins, small.normal_max_neighbors, small.feature_max_neighbors) == (11, 30, 100)


def test_without_refitting_only_the_choice_among_samples_changes():
    bare = options_of(FUSED, refit=False)
    assert (bare.ransac.local_optimization, bare.ransac.scoring) == (0, "count")
    assert replace(bare, ransac=PAPER.ransac) == PAPER
