"""Scans of one file, columns, units, intensity and thinning at the command line."""

import json

import numpy as np
import pytest
import torch
from made_e57 import write_e57

import torchreg as tr
from torchreg.cli.progress import points_rate, reading_bar
from torchreg.cli.wording import by_options


def fields(cloud):
    points, colors = cloud.points.double().numpy(), (cloud.colors * 255).round().int().numpy()
    names = ("cartesianX", "cartesianY", "cartesianZ", "colorRed", "colorGreen", "colorBlue")
    return dict(zip(names, (*points.T, *colors.T), strict=True))


@pytest.fixture(scope="module")
def project(room, tmp_path_factory):
    """Both scans of the room in one E57 file."""
    clouds = [tr.read_cloud(path) for path in (room.source, room.target)]
    path = tmp_path_factory.mktemp("project") / "room.e57"
    names = ("first", "second")
    return write_e57(path, [{"fields": fields(cloud), "name": name} for cloud, name in zip(clouds, names, strict=True)])


def result_of(run, *words):
    ended = run("register", *words, "--json", "-")
    assert ended.exit_code == 0, ended.output
    return json.loads(ended.stdout)


def test_two_scans_of_one_file_are_registered(run, project, room):
    for scans in (("0", "1"), ("first", "second")):
        result = result_of(run, project, project, "--scan", scans[0], "--target-scan", scans[1], "--truth", room.truth)
        assert result["truth"]["rre_degrees"] < 2
    ended = run("register", project, project)
    assert ended.exit_code == 2
    assert "expected one scan, or --scan to choose one, got a file of 2 scans (0 'first', 1 'second')" in ended.stderr


def test_info_of_a_scan(run, project):
    shown = json.loads(run("info", project, "--scan", "second", "--json", "-").stdout)
    assert (shown["scan"], shown["pose"], shown["has_intensity"], shown["unit"]) == ("second", None, False, None)
    assert "second" in run("info", project, "--scan", "1").stdout


def test_info_of_a_file_of_several_scans_shows_them_all(run, project, tmp_path):
    ended = run("info", project, "--json", tmp_path / "scans.json")
    assert ended.exit_code == 0
    shown = json.loads((tmp_path / "scans.json").read_text())["scans"]
    for number, (name, one) in enumerate(zip(("first", "second"), shown, strict=True)):
        count = json.loads(run("info", project, "--scan", name, "--json", "-").stdout)["points_in_file"]
        assert (one["number"], one["scan"], one["points_in_file"]) == (number, name, count)
        assert (one["has_colors"], one["pose"], one["scanner"]) == (True, None, None)
        row = next(line for line in ended.stdout.splitlines() if name in line)
        assert f"{count:,}" in row
        assert "not known" in row
    assert json.loads(run("info", project, "--json", "-").stdout)["scans"] == shown


def test_info_of_several_scans_shows_poses_and_scanners(run, tmp_path):
    T = torch.eye(4, dtype=torch.float64)
    T[:3, 3] = torch.tensor([1.0, -2.0, 0.5])
    scans = [tr.io.posed_scan(tr.Clouds(torch.rand(9, 3)), T, name=name) for name in "ab"]
    tr.io.write_scans(tmp_path / "project.ptx", scans)
    shown = json.loads(run("info", tmp_path / "project.ptx", "--json", "-").stdout)["scans"]
    assert [one["scanner"] for one in shown] == [[1.0, -2.0, 0.5]] * 2
    assert [one["pose"] for one in shown] == [T.tolist()] * 2
    assert [one["has_colors"] for one in shown] == [False] * 2
    assert "1.000, -2.000, 0.500" in run("info", tmp_path / "project.ptx").stdout


def test_columns_and_units_of_text(run, tmp_path):
    points = np.random.default_rng(0).uniform(0, 3000, (300, 3))
    np.savetxt(tmp_path / "a.txt", np.concatenate([points[:, ::-1], np.full((300, 1), 7)], axis=1))
    words = ("info", tmp_path / "a.txt", "--columns", "zyx_", "--units", "mm", "--json", "-")
    shown = json.loads(run(*words).stdout)
    np.testing.assert_allclose(shown["extent"], np.ptp(points, axis=0) / 1000, rtol=1e-12)
    assert run("info", tmp_path / "a.txt", "--units", "mile").exit_code == 2


def test_notes_and_errors_name_options_and_no_arguments_of_python(run, room, tmp_path):
    rng = np.random.default_rng(0)
    rows = np.concatenate((rng.uniform(0, 5, (300, 3)), rng.integers(256, size=(300, 3))), axis=1)
    np.savetxt(tmp_path / "a.txt", rows, fmt=["%.4f"] * 3 + ["%d"] * 3)
    for words in (("info", tmp_path / "a.txt"), ("register", tmp_path / "a.txt", tmp_path / "a.txt")):
        shown = " ".join(run(*words).stdout.split())
        assert "(--columns names others)" in shown
        assert "columns=" not in shown
    assert "no --columns for a file that" in run("info", room.source, "--columns", "x y z").stderr
    assert "expected --columns of x, y, z" in run("info", tmp_path / "a.txt", "--columns", "x y q").stderr


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scan= to choose one", "--scan to choose one"),
        ("units='file' makes them meters", "--units file makes them meters"),
        ("target_scan=", "--target-scan"),
        ("a scan, columns, x=3 and rescan= stay", "a scan, columns, x=3 and rescan= stay"),
    ],
)
def test_arguments_become_options(text, words):
    assert by_options(text) == words


def test_large_files_are_thinned_while_they_are_read_and_the_result_says_so(run, project, room, monkeypatch):
    monkeypatch.setattr("torchreg.settings.LARGEST_READ", 4000)
    result = result_of(run, project, project, "--scan", "0", "--target-scan", "1", "--truth", room.truth)
    assert result["truth"]["rre_degrees"] < 2
    assert all(any("thinned while it was read" in note for note in notes) for notes in result["file_notes"].values())
    assert all(count["used"] <= 4000 < count["in_file"] for count in result["points"].values())
    assert "thinned while it was read" in run("register", room.source, room.target).stdout


def test_intensity_as_gray(run, tmp_path):
    points = np.random.default_rng(0).uniform(0, 5, (300, 4))
    np.savetxt(tmp_path / "a.xyz", points)
    for words, noted in (((), False), (("--intensity",), True)):
        ended = run("register", tmp_path / "a.xyz", tmp_path / "a.xyz", "--json", "-", *words)
        notes = json.loads(ended.stdout)["file_notes"]["source"]
        assert any("is used as gray colors" in note for note in notes) == noted


def test_the_pace_of_reading_in_words(monkeypatch):
    assert points_rate(3_200_000, 2.0) == "3.2 million points, 1.6 million/s"
    assert points_rate(5000, 0.0) == "5,000 points"
    with reading_bar("a.e57") as progress:
        assert progress is None
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with reading_bar("a.e57") as progress:
        progress(10, None)
        progress(20, 30)
