"""A result in words: it names every figure, and advice follows from figures."""

import math
import sys
from dataclasses import replace

import pytest
import torch
from problems import random_transform, turned
from refusals import refuses
from results import (
    FOUR_POINTS,
    OPTIONS,
    PROPOSALS,
    STAGES,
    bare_result,
    candidate,
    failed_result,
    number,
    verified_result,
)

import torchreg as tr
from torchreg.report.explain.advice import CLOUD_RULES, FIRST_RULES, IMPOSTOR_RULES
from torchreg.report.text import chance, columns, odds, percent, share
from torchreg.types.failure import KINDS

HEADINGS = ("origin", "support", "by", "chance", "overlap", "normals", "colors", "conflict", "log-odds", "probability")


def line(text, label):
    rows = [row for row in text.splitlines() if row.startswith(f"{label} ")]
    assert len(rows) == 1, (label, text)
    return rows[0]


def advice(result):
    return result.explain().partition("\nMay help")[2]


def test_every_stage_has_its_line():
    text = verified_result().explain()
    points = line(text, "Points")
    assert "30,433 (source) and 28,001 (target) given, 9,812 and 9,950 left by voxels of 0.05 m" in points
    assert "9,700 of 9,812 (98.9 %) and 9,950 of 9,950 (100 %) have one, from 0.25 m" in line(text, "Features")
    rows = text.splitlines()
    first, second = (place for place, row in enumerate(rows) if row.startswith("Proposal "))
    assert rows[first].endswith(" fpfh + contrast, compatibility")
    assert "2,104 matches; 512 hypotheses, 400 kept, 200 scored; 12 poses, " in rows[first + 1]
    assert "the best with 310 inliers (14.7 %)" in rows[first + 1]
    assert "; 1 pose, the best with 90" in rows[second + 1]
    assert "downsampled to voxels" in line(text, "Note")
    assert PROPOSALS[0].origin in line(text, "Pose")
    assert "52 % of the points" in line(text, "Overlap")
    assert "0.31 of 1: held 3.2 times less firmly in its loosest direction" in line(text, "Strength")
    assert "fitness 0.61" in line(text, "Fit")
    assert "inlier_rmse 0.0123 m" in line(text, "Fit")
    assert line(text, "Verdict").endswith("registered, probability 0.998 that the pose is right")
    assert line(text, "May help").endswith("nothing needs to change (probability 0.998)")


def test_stages_come_in_the_order_of_the_run():
    labels = [row.split()[0] for row in verified_result().explain().splitlines() if not row.startswith(" ")]
    assert labels == [
        *("Points", "Features", "Proposal", "Proposal", "Note", "Candidates"),
        *("Pose", "Runner-up", "Overlap", "Strength", "Fit", "Verdict", "May"),
    ]


def test_lines_are_short():
    assert max(map(len, verified_result().explain().splitlines())) <= 120


def test_candidates_stand_in_columns():
    many = tuple(candidate(support=10 * rank, log_odds=float(-rank)) for rank in range(9))
    rows = verified_result(candidates=(many,)).explain().splitlines()
    first = next(place for place, row in enumerate(rows) if row.startswith("Candidates"))
    assert "the best 6 of 9" in rows[first]
    table = rows[first + 1 : first + 8]
    assert rows[first + 8].startswith("Pose")
    assert len({len(row) for row in table}) == 1
    assert table[0].split() == [*HEADINGS]
    assert table[1].split()[-6:] == ["0.52", "0.91", "0.43", "0.01", "0.0", "0.998"]


def test_what_is_not_known_is_a_dash():
    table = verified_result().explain().splitlines()
    slide = next(row for row in table if row.strip().startswith("slide"))
    assert slide.split() == ["slide", "-", "-", "0.52", "0.91", "-", "0.01", "6.3", "0.998"]
    assert "nan" not in verified_result().explain().replace("inlier", "")


def test_a_result_of_a_solver_alone():
    text = bare_result().explain()
    assert line(text, "Matches").endswith(" 4")
    assert "9,000 drawn, 800 kept by the first test, 70 scored" in line(text, "Hypotheses")
    assert "3 of 4 (75 %) matches" in line(text, "Inliers")
    assert line(text, "Verdict").endswith(" registered")
    assert line(text, "May help").endswith("weighs the pose against the clouds as well")
    for label in ("Points", "Candidates", "Pose", "Runner-up", "Overlap", "Strength"):
        assert label not in text


def test_the_runner_up_is_measured_in_the_middle_of_the_overlap():
    """Turned by 90 degrees about the origin and shifted by (3, 4): a point at c moves by (R - 1) c + (3, 4)."""
    assert "turned by 90 degrees, the middle of the overlap moved by 5 m" in line(
        verified_result().explain(), "Runner-up"
    )
    assert "log-odds 5.2 lower (about 181 to 1)" in line(verified_result().explain(), "Runner-up")
    center = torch.tensor([2.0, -1.0, 7.0], dtype=torch.float64)
    x, y, z = (50 * center).tolist()
    information = 50 * torch.eye(6, dtype=torch.float64)
    information[:3, 3:] = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    information[3:, :3] = information[:3, 3:].T
    moved = (
        turned(90)[:3, :3] @ center
        - center
        + (turned(100, translation=(3.0, 4.0, 0.0)) @ torch.linalg.inv(turned(10)))[:3, 3]
    )
    text = verified_result(information=information[None]).explain()
    assert f"moved by {float(moved.norm()):.4g} m" in line(text, "Runner-up")


def test_the_distance_of_the_runner_up_does_not_change_with_the_frame():
    """Clouds far from their zero: poses and information in the far frame, the same words."""
    shift = turned(0, translation=(5e5, 5e6, 300.0))
    back = torch.linalg.inv(shift)
    far = {
        name: (shift @ getattr(verified_result(), name)[0] @ back)[None] for name in ("T_target_source", "runner_up")
    }
    x, y, z = (100 * shift[:3, 3]).tolist()
    information = 100 * torch.eye(6, dtype=torch.float64)
    information[:3, 3:] = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    near = line(verified_result().explain(), "Runner-up")
    assert line(verified_result(**far, information=information[None]).explain(), "Runner-up") == near


@pytest.mark.parametrize("seed", range(3))
def test_the_angle_of_the_runner_up(seed):
    generator = torch.Generator().manual_seed(seed)
    one, other = random_transform(generator), random_transform(generator)
    result = verified_result(T_target_source=one[None], runner_up=other[None], information=None)
    cosine = (float(torch.trace(one[:3, :3].T @ other[:3, :3])) - 1) / 2
    distance = float((one[:3, 3] - other[:3, 3]).norm())
    words = f"{math.degrees(math.acos(cosine)):.3g} degrees, the middle of the overlap moved by {distance:.4g} m"
    assert words in line(result.explain(), "Runner-up")


def test_no_runner_up():
    alone = verified_result(runner_up=torch.full((1, 4, 4), math.nan, dtype=torch.float64), margin=number(math.inf))
    assert line(alone.explain(), "Runner-up").endswith("none: no other distinct pose was weighed")


@pytest.mark.parametrize(
    ("strength", "words"),
    [
        (0.0, "held far less firmly in its loosest direction than in its firmest: it can slide or turn there"),
        (0.02, "held 50 times less firmly in its loosest direction than in its firmest: it can slide or turn there"),
        (0.05, "held 20 times less firmly in its loosest direction than in its firmest, which is weak"),
        (0.163, "held 6.1 times less firmly in its loosest direction than in its firmest, which is usual"),
        (0.9, "held about as firmly in every direction"),
    ],
)
def test_strength_is_put_in_words(strength, words):
    assert words in line(verified_result(strength=number(strength)).explain(), "Strength")


@pytest.mark.parametrize("kind", KINDS)
def test_every_failure_is_explained_and_answered(kind):
    failed = failed_result(kind, "these are the figures")
    text = failed.explain()
    verdict = line(text, "Verdict")
    assert "not registered, probability 0.070" in verdict
    assert verdict.endswith("; these are the figures")
    assert "none accepted; the likeliest is from" in line(text, "Pose")
    assert "nothing needs to change" not in text
    assert 1 <= len(advice(failed).splitlines()) <= 2


def test_every_kind_of_failure_has_its_rules():
    """In one of three tables: clouds and pairs that no setting helps, and failures that some setting may prevent."""
    assert sorted([*CLOUD_RULES, *IMPOSTOR_RULES, *FIRST_RULES]) == sorted(KINDS)
    assert all(FIRST_RULES.values())
    assert all(IMPOSTOR_RULES.values())
    of_clouds = KINDS[: KINDS.index("too few matches")]
    assert tuple(CLOUD_RULES) == of_clouds


def few(**changes):
    return (STAGES._replace(**changes),)


def options(**changes):
    return (replace(OPTIONS, **changes),)


TIGHT = replace(OPTIONS.ransac, inlier_threshold=0.01)
NO_VIEWPOINT = replace(FOUR_POINTS, viewpoint=None)
UNKNOWN_VIEWPOINT = replace(FOUR_POINTS, viewpoint=torch.full((1, 3), math.nan))
ASSUMED_VIEWPOINT = replace(FOUR_POINTS, viewpoint_assumed=torch.tensor([True]))
NO_COLORS = {"source": replace(FOUR_POINTS, colors=None), "target": replace(FOUR_POINTS, colors=None)}
MATCHES = (PROPOSALS[0]._replace(matches=40),)
# what changes -> (kind of failure, fields, words of the setting, the figure it follows from)
ADVICE = {
    "few points": (
        "too few points",
        {"stages": few(points=(100, 9950))},
        "smaller voxel_size (now 0.05 m)",
        "only 100 of the 30,433 points of the source",
    ),
    "few given": ("too few points", {"stages": few(given=(3, 9), points=(3, 9))}, "denser clouds", "3 points"),
    "few features": (
        *("too few matches", {"stages": few(described=(3000, 9950))}),
        *("larger radius of the descriptors (now 0.25 m)", "3,000 of 9,812 (30.6 %)"),
    ),
    "few matches": ("too few matches", {"stages": few(proposals=MATCHES)}, 'effort="thorough"', "only 40 matches"),
    "all effort": (
        *("too few matches", {"stages": few(proposals=MATCHES), "options": options(effort="thorough")}),
        *("a larger match_neighbors (now 2)", "only 40 matches"),
    ),
    "ratio": (
        *("too few matches", {"stages": few(proposals=MATCHES), "options": options(ratio=0.8, match_neighbors=1)}),
        *("ratio=None (now 0.8)", "only 40 matches"),
    ),
    "none scored": (
        "no hypothesis",
        {"hypotheses": bare_result().hypotheses._replace(scored=torch.zeros(1, dtype=torch.int64))},
        *("lower edge_similarity (now 0.9)", "9,000 hypotheses none"),
    ),
    "threshold": (
        *("no consensus", {"options": options(ransac=TIGHT)}),
        *("inlier_threshold of about 0.075 m (now 0.01 m)", "voxels of 0.05 m"),
    ),
    "few inliers": ("no consensus", {"inliers": torch.zeros(4, dtype=torch.bool)}, 'effort="thorough"', "0 of 4 (0 %)"),
    "colors": ("ambiguous", NO_COLORS, "clouds with colors", "geometry alone was matched"),
    "colors of one": ("ambiguous", {"target": NO_COLORS["target"]}, "clouds with colors", "geometry alone was matched"),
    "color off": ("ambiguous", {"options": options(color=())}, "descriptors of color", "geometry alone"),
    "viewpoint": ("ambiguous", {"source": NO_VIEWPOINT}, "viewpoint", "not known for the source"),
    "unknown viewpoint": ("ambiguous", {"target": UNKNOWN_VIEWPOINT}, "viewpoint", "not known for the target"),
    "assumed viewpoint": (
        "ambiguous",
        {"target": ASSUMED_VIEWPOINT},
        'viewpoint ("origin" for',
        "only assumed for the target",
    ),
    "context": (
        "ambiguous",
        {"margin": number(0.5)},
        "radius of the descriptors (now 0.25 m) or voxel_size",
        "about 1.6 to 1",
    ),
    "sliding": ("sliding", {"strength": number(0.01)}, "larger scans", "strength 0.01"),
    "overlap": ("little overlap", {"overlap": number(0.083)}, "nearer to each other", "8.3 %"),
    "conflict": ("free-space conflict", {"candidates": ((candidate(conflict=0.3),),)}, "viewpoints", "30 %"),
    "normals": ("surfaces disagree", {"candidates": ((candidate(normals=0.2),),)}, "normal_radius (now 0.1 m)", "0.20"),
    "light": ("colors disagree", {"candidates": ((candidate(colors=-0.1),),)}, "without_color", "-0.10"),
}


@pytest.mark.parametrize("which", ADVICE)
def test_advice_names_the_setting_and_the_figure_it_follows_from(which):
    kind, fields, setting, figure = ADVICE[which]
    first = advice(failed_result(kind, **fields)).splitlines()[0]
    assert setting in first
    assert figure in first


@pytest.mark.parametrize("which", ADVICE)
def test_without_the_figure_the_advice_is_not_given(which):
    kind, _, setting, _ = ADVICE[which]
    enough = {"inliers": torch.ones(4, dtype=torch.bool)}
    assert setting not in advice(failed_result(kind, **enough))


def test_a_success_that_is_not_likely_gets_advice():
    assert "radius of the descriptors" in advice(verified_result(probability=number(0.6), margin=number(0.4)))
    assert "nothing needs" in advice(verified_result(probability=number(0.95), margin=number(0.4)))


def test_clouds_that_cannot_be_registered_at_all():
    """Their settings are not to blame: nothing was left by voxels because nothing was downsampled."""
    refused = {"candidates": ((),), "stages": few(given=(50, 3), points=(0, 0))}
    degenerate = failed_result("degenerate", "the points of the source lie on one line", **refused)
    assert line(degenerate.explain(), "Verdict").endswith("lie on one line")
    assert advice(degenerate).strip() == "other clouds: the reason says why"
    assert advice(failed_result("too few points", **refused)).strip() == "denser clouds: one has only 3 points"


IMPOSTORS = {
    "units": ({"factor": 1000.0}, "divide the coordinates of the larger one by 1000"),
    "mirrored": ({}, "handedness"),
    "scaled": ({"factor": 0.9091}, "multiply the source's coordinates by 0.9091"),
}


@pytest.mark.parametrize("kind", IMPOSTORS)
def test_an_impostor_gets_the_one_advice_that_helps(kind):
    """Whatever else the figures may say: a larger radius mends no mirrored cloud."""
    figures, words = IMPOSTORS[kind]
    poor = {"margin": number(0.1), "strength": number(0.01), "overlap": number(0.05), "stages": few(points=(42, 9950))}
    (only,) = advice(failed_result(kind, **poor, failure=(tr.Failure(kind, kind, figures),))).splitlines()
    assert words in only
    assert "radius" not in only


@pytest.mark.parametrize("kind", FIRST_RULES)
def test_voxels_that_leave_hardly_any_points_are_said_first(kind):
    """The larger cloud may be the one that suffers: the counts of one cloud are compared, not the least of both."""
    for given, points in (((1397, 1200), (42, 900)), ((1200, 1397), (900, 42))):
        first = advice(failed_result(kind, stages=few(given=given, points=points))).splitlines()[0]
        name = "source" if points[0] == 42 else "target"
        assert f"voxel_size (now 0.05 m): it leaves only 42 of the 1,397 points of the {name}" in first


@pytest.mark.parametrize(("surprise", "shown"), [(41.7, "10^-42"), (0.2, "1"), (-0.0, "1"), (math.nan, "-")])
def test_chance_is_a_power_of_ten(surprise, shown):
    row = verified_result(candidates=((candidate(surprise=surprise),),)).explain().split("probability\n")[1]
    assert row.split()[7] == shown


def test_without_a_pose_nothing_is_said_of_one():
    """``register`` has zeros for a pair in which no solver found a pose: they are not shown as figures."""
    zeros = {name: number(0.0) for name in ("probability", "overlap", "strength", "fitness")}
    text = failed_result("too few matches", candidates=((),), margin=number(math.inf), **zeros).explain()
    for label in ("Candidates", "Pose", "Runner-up", "Overlap", "Strength", "Fit "):
        assert f"\n{label}" not in text
    assert "share only" not in text
    assert "strength" not in text


def test_pairs_of_a_batch_are_told_apart():
    both = replace(
        bare_result(),
        T_target_source=torch.stack([turned(10), turned(0)]),
        **{name: getattr(bare_result(), name).repeat(2) for name in ("fitness", "inlier_rmse")},
        success=torch.tensor([True, False]),
        failure=(None, tr.Failure("no consensus", "no consensus: none")),
        source=tr.Clouds.pack([FOUR_POINTS, FOUR_POINTS]),
        target=tr.Clouds.pack([FOUR_POINTS, FOUR_POINTS]),
        hypotheses=type(bare_result().hypotheses)(*(count.repeat(2) for count in bare_result().hypotheses)),
        correspondences=replace(bare_result().correspondences, offsets=torch.tensor([0, 3, 4])),
    )
    assert "3 of 3" in line(both.explain(0), "Inliers")
    assert "0 of 1" in line(both.explain(1), "Inliers")
    assert "not registered" in both.explain(1)
    for pair in (-1, 2):
        with refuses("pair", "a number from 0 to 1", str(pair)):
            both.explain(pair)


def test_words():
    assert [percent(share) for share in (0, 0.00012, 0.014, 0.1234, 0.9996, 1)] == [
        *("0 %", "0.012 %", "1.4 %", "12.3 %", "100 %", "100 %")
    ]
    assert share(0, 0) == "0 of 0"
    assert [chance(p) for p in (0.0, 2e-5, 0.5, 0.99996, 1.0, math.nan)] == [
        *("0.000", "2.0e-05", "0.500", "0.99996", "1.000", "-")
    ]
    assert [odds(margin) for margin in (0.0, math.log(7), math.log(1234), 50.0)] == [
        *("about 1 to 1", "about 7 to 1", "about 1,234 to 1", "more than a million to 1")
    ]
    assert columns([("a", "b"), ("ccc", "10")]) == ["a     b", "ccc  10"]


def test_nothing_but_text_is_imported():
    """The explanation is written from plain numbers: none of its modules holds a library for tables or pictures."""
    modules = [module for name, module in sys.modules.items() if name.startswith("torchreg.report.explain")]
    assert len(modules) >= 4
    assert not any(hasattr(module, name) for module in modules for name in ("torch", "rich", "np", "numpy"))
