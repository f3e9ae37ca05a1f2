"""``torchreg site``: files in, poses, JSON, a merged cloud and a page out, and what it says of scans that fail."""

import csv
import json

import pytest
import torch
from problems import room_site, sphere_cloud
from sites import errors

import torchreg as tr


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """Three scans of a room as files of three formats, and their true poses."""
    folder = tmp_path_factory.mktemp("site")
    site = room_site(3)
    paths = [folder / name for name in ("a.ply", "b.npz", "c.pcd")]
    for path, scan in zip(paths, site.scans, strict=True):
        tr.write_cloud(path, scan)
    return paths, site.T_world_scan


def poses_of(folder):
    """Names, groups and poses of poses.csv; NaN where a pose is empty."""
    with open(folder / "poses.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    numbers = [[float(row[f"m{i}{j}"] or "nan") for i in range(4) for j in range(4)] for row in rows]
    poses = torch.tensor(numbers, dtype=torch.float64).view(-1, 4, 4)
    return [row["scan"] for row in rows], [row["group"] for row in rows], poses


def test_scans_of_a_room_become_poses_a_cloud_and_a_page(run, rooms, tmp_path):
    paths, truth = rooms
    merged, page = tmp_path / "whole.ply", tmp_path / "site.html"
    result = run("site", *paths, "--out", tmp_path / "out", "--merged", merged, "--spacing", "0.1", "--report", page)
    assert result.exit_code == 0, result.output
    assert "all 3 scans are placed in one frame" in result.stdout
    names, groups, poses = poses_of(tmp_path / "out")
    assert names == list(map(str, paths))
    assert groups == ["0", "0", "0"]
    meters, _ = errors(poses, truth)
    assert meters.max() < 0.01

    content = json.loads((tmp_path / "out" / "site.json").read_text())
    assert [scan["group"] for scan in content["scans"]] == [0, 0, 0]
    assert torch.equal(torch.tensor([scan["T_world_scan"] for scan in content["scans"]], dtype=torch.float64), poses)
    used = [link for link in content["links"] if link["used"]]
    assert sorted(sorted((link["source"], link["target"])) for link in used) == [[0, 1], [0, 2], [1, 2]]

    whole = tr.read_cloud(merged)
    assert whole.colors is not None
    low, high = whole.points.amin(dim=0), whole.points.amax(dim=0)
    assert float((high - low).amax()) < 9.0  # one room, its diagonal 8 m, not three side by side
    assert 500 < len(whole.points) < 8000
    text = page.read_text(encoding="utf-8")
    assert "All 3 scans are placed in one frame." in text
    assert "b.npz" in text


def test_files_that_fail_are_named_and_the_rest_goes_on(run, rooms, tmp_path):
    paths, _ = rooms
    broken, other = tmp_path / "broken.ply", tmp_path / "other.ply"
    broken.write_text("no cloud")
    tr.write_cloud(other, sphere_cloud(1500, dtype=torch.float32))
    result = run("site", *paths[:2], broken, tmp_path / "missing.ply", other, "--out", tmp_path / "out")
    assert result.exit_code == 3
    assert "2 of 5 scans are placed in one frame" in result.stdout
    assert str(broken) in result.stderr
    _, groups, poses = poses_of(tmp_path / "out")
    assert groups == ["0", "0", "", "", ""]
    assert poses[2:].isnan().all()
    scans = json.loads((tmp_path / "out" / "site.json").read_text())["scans"]
    assert "missing.ply" in scans[3]["reason"]
    assert scans[4]["reason"]


def test_a_file_of_several_scans_gives_them_all(run, tmp_path, rooms):
    paths, truth = rooms
    lines = []
    for path in paths:
        cloud = tr.read_cloud(path)
        header = [str(len(cloud.points)), "1", "0 0 0", "1 0 0", "0 1 0", "0 0 1"]
        header += ["1 0 0 0", "0 1 0 0", "0 0 1 0", "0 0 0 1"]
        colors = (255 * cloud.colors).round().int().tolist()
        rows = [
            f"{x} {y} {z} 0.5 {r} {g} {b}" for (x, y, z), (r, g, b) in zip(cloud.points.tolist(), colors, strict=True)
        ]
        lines += [*header, *rows]
    project = tmp_path / "project.ptx"
    project.write_text("\n".join(lines) + "\n")
    result = run("site", project, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    names, _, poses = poses_of(tmp_path / "out")
    assert names == [f"{project} [{number}]" for number in range(3)]
    meters, _ = errors(poses, truth)
    assert meters.max() < 0.01


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--out", "no/such/folder"), "--out: expected a folder"),
        (("--out", "out", "--report", "page.txt"), "--report: expected a name that ends in"),
        (("--out", "out", "--merged", "whole.stl"), "--merged: expected a name that ends in"),
        (("--out", "out", "--spacing", "0"), "--spacing: expected"),
        (("--out", "out", "--effort", "plain"), "--effort: expected"),
    ],
)
def test_usage_is_checked_before_anything_is_read(run, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    result = run("site", "missing.ply", *words)
    assert result.exit_code == 2
    assert message in result.stderr


def test_no_scan_that_can_be_read_is_an_error(run, tmp_path):
    result = run("site", tmp_path / "missing.ply", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "SCANS: expected files of scans" in result.stderr
    assert not (tmp_path / "out" / "poses.csv").exists()
