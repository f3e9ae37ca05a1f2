"""Tables and texts."""

import math
from dataclasses import replace

import pytest
import torch
from problems import room_pair, turned
from results import bare_result, failed_result, number, verified_result
from rich.console import Console

import torchreg as tr
from torchreg.geometry.se3 import rigid
from torchreg.io import read_cloud_report
from torchreg.metrics import PoseErrors
from torchreg.report import (
    DemoRow,
    cloud_table,
    demo_sentence,
    demo_table,
    matrix_text,
    picture_title,
    registration_table,
)
from torchreg.report.text import legible, share


def shown(table, width=200):
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(table)
    console.file.close()
    return console.export_text()


@pytest.fixture(scope="module")
def result():
    pair = room_pair(3000, seed=2)
    return tr.register(pair.source, pair.target)


def test_registration_table(result):
    truth = PoseErrors(0.5, 0.0123, 0.02)
    text = shown(registration_table(result, source="[a].ply", target="b.ply", truth=truth))
    options = result.options[0]
    for words in (
        "[a].ply",
        f"{options.normal_radius:.4g} m",
        f"{options.feature_radius:.4g} m",
        f"{options.ransac.inlier_threshold:.4g} m",
        f"{int(result.hypotheses.drawn[0]):,} drawn",
        f"{int(result.inliers.sum()):,} of {len(result.inliers):,}",
        f"{float(result.fitness[0]):.4f}",
        "RRE 0.5 degrees, RTE 12 mm, RMSE 20 mm",
        "descriptors",
        "weight 0.8",
    ):
        assert words in text
    assert text.rstrip().endswith("registered")


def test_registration_table_of_a_failure(result):
    failure = tr.Failure("too few matches", "too few [red]matches")
    failed = replace(
        result,
        success=torch.tensor([False]),
        failure=(failure,),
        notes=(("a [bold]note",),),
        source=replace(result.source, colors=None),
    )
    text = shown(registration_table(failed, source="a", target="b"))
    assert text.rstrip().endswith("not registered: too few [red]matches")
    assert "a [bold]note" in text
    assert "T_target_source" not in text
    assert "geometry alone" in text


def test_registration_table_of_a_pose_that_was_weighed():
    text = shown(registration_table(verified_result(), source="a", target="b"))
    rows = {row[:16].strip(): row[16:].strip() for row in text.splitlines()}
    lead = "log-odds 5.2 lower (about 181 to 1)"
    assert rows["overlap"] == "0.5200 of the points have a partner"
    loosest = "held 3.2 times less firmly in its loosest direction than in its firmest, which is usual"
    assert rows["strength"] == f"0.310 of 1: {loosest}"
    assert rows["runner-up"] == "turned by 90 degrees, the middle of the overlap moved by 5 m; " + lead
    assert rows["probability"] == "0.998 that the pose is right"
    assert "0.070 that the pose" in shown(registration_table(failed_result("sliding"), source="a", target="b"))


def test_the_errors_of_a_refused_pose_are_called_that():
    truth = PoseErrors(0.5, 0.0123, 0.02)
    text = shown(registration_table(failed_result("sliding"), source="a", target="b", truth=truth))
    assert "the likeliest pose, which was refused: RRE 0.5 degrees, RTE 12 mm" in text
    assert "refused" not in shown(registration_table(verified_result(), source="a", target="b", truth=truth))


def test_titles_of_pictures():
    good, refused = verified_result(), failed_result("ambiguous", "ambiguous: two poses, and figures")
    assert picture_title("a to b", good) == "a to b: registered, probability 0.998"
    refined, unrefined = (verified_result(residual_median=number(value)) for value in (0.0123, math.nan))
    assert picture_title("a to b", refined) == "a to b: registered, probability 0.998, residual 12 mm"
    assert picture_title("a to b", unrefined) == picture_title("a to b", good)
    assert picture_title("a to b", refused) == "a to b: not registered (ambiguous), probability 0.070"
    assert picture_title("a to b", bare_result()) == "a to b: registered"


def test_registration_table_of_a_solver_alone():
    text = shown(registration_table(bare_result(), source="a", target="b"))
    for name in ("overlap", "strength", "runner-up", "probability"):
        assert name not in text


def test_tables_fold_and_never_cut(result):
    name = "a_very_long_name" * 10 + ".ply"
    narrow = shown(registration_table(result, source=name, target="b"), width=60)
    assert name in "".join(line.strip().removeprefix("source").strip() for line in narrow.splitlines())
    assert max(map(len, narrow.splitlines()[:1])) <= 60


def test_matrix_text():
    T = rigid(torch.eye(3, dtype=torch.float64), torch.tensor([4512345.123456789, -2.5, 0], dtype=torch.float64))
    lines = matrix_text(T).splitlines()
    assert len({len(line) for line in lines}) == 1
    rows = [[float(word) for word in line.split()] for line in lines]
    torch.testing.assert_close(torch.tensor(rows, dtype=torch.float64), T, atol=5e-7, rtol=0)


@pytest.mark.parametrize("kilometers", [0.01, 6000])
def test_the_matrix_that_a_table_shows_puts_points_where_the_pose_does(kilometers):
    zero = torch.full((3, 1), 1000.0 * kilometers, dtype=torch.float64)
    R = turned(33, axis=(1.0, 2.0, 3.0))[:3, :3]
    T = rigid(R, (zero - R @ zero)[:, 0])
    rows = [[float(word) for word in line.split()] for line in matrix_text(T).splitlines()]
    off = torch.tensor(rows, dtype=torch.float64) - T
    away = off[:3, :3] @ zero + off[:3, 3:]
    assert float(away.abs().max()) < 1e-4


def test_cloud_table(tmp_path):
    cloud = room_pair(2000, seed=2).source
    tr.write_cloud(tmp_path / "a.ply", cloud)
    file = read_cloud_report(tmp_path / "a.ply")
    text = shown(cloud_table(file, 0.123, tr.derive_options(cloud, cloud)[0], ""))
    assert "0.123 m (median" in text
    assert f"{len(cloud.points):,} in the file" in text
    assert "cannot be registered" not in text
    assert "cannot be registered  flat" in shown(cloud_table(file, 0.0, None, "flat"))


def a_row(method="m", right=True, ratio=0.1, degrees=0.1, success=True):
    return DemoRow(
        method=method,
        points=(9000, 12345),
        inlier_ratio=ratio,
        errors=PoseErrors(degrees, 0.5, 0.25),
        seconds=1.26,
        success=success,
        right=right,
        T_target_source=torch.eye(4),
    )


def test_demo_table():
    text = shown(demo_table([a_row("one"), a_row("two", right=False), a_row("three", right=False, success=False)]), 80)
    assert text.splitlines()[2].split() == ["one", "12,345", "10.00", "%", "0.100", "0.5000", "0.2500", "1.3", "right"]
    assert text.splitlines()[3].split()[-1] == "wrong"
    assert text.splitlines()[4].split()[-5:] == ["-", "-", "-", "1.3", "refused"]


@pytest.mark.parametrize(
    ("plain", "fused", "words"),
    [
        (a_row(right=False, degrees=179.7), a_row(ratio=0.3), ("turned by 180 degrees", "wall on wall", "30.0 %")),
        (a_row(right=False, degrees=12), a_row(), ("turned by 12 degrees and moved by 0.5 m; by default all",)),
        (a_row(), a_row(), ("by default and without color",)),
        (
            a_row(),
            a_row(right=False),
            (
                "do not lie on each other",
                "without color they do",
            ),
        ),
        (a_row(right=False), a_row(right=False), ("nor by the plain procedure",)),
    ],
)
def test_demo_sentence(plain, fused, words):
    sentence = demo_sentence(plain, fused)
    assert sentence.count(". ") == 0
    assert sentence.endswith(".")
    for word in words:
        assert word in sentence


def test_legible_and_share():
    assert legible("a\x1b[1mb\udcff\nñ") == "a\\x1b[1mb\\udcff\nñ"
    assert share(1234, 5000) == "1,234 of 5,000 (24.7 %)"
