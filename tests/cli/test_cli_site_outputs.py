"""What comes out of a site: projects with new poses, moved scans, merged clouds, trajectories, and what is said."""

import csv
import shutil

import laspy
import numpy as np
import pye57
import pytest
import torch
from made_e57 import write_e57
from problems import random_transform, room_site, seeded
from sites import site_of_poses

import torchreg as tr
from torchreg.cli.placed_scans import InputScan, placed_files
from torchreg.geometry.se3 import apply, compose, inverse, quaternion_wxyz
from torchreg.io import read_scans


@pytest.fixture(scope="module")
def rooms():
    return room_site(4, points=2500)


@pytest.fixture(scope="module")
def projects(rooms, tmp_path_factory):
    """Two E57 files of two scans each, with poses that have nothing to do with each other."""
    folder = tmp_path_factory.mktemp("projects")
    paths = []
    for number in range(2):
        scans = []
        for k in (2 * number, 2 * number + 1):
            points, colors = rooms.scans[k].points.double().numpy(), (255 * rooms.scans[k].colors).round().int().numpy()
            pose = random_transform(seeded(k))
            names = ("cartesianX", "cartesianY", "cartesianZ", "colorRed", "colorGreen", "colorBlue", "intensity")
            fields = dict(zip(names, [*points.T, *colors.T, np.linspace(0, 1, len(points))], strict=True))
            fields["rowIndex"] = np.arange(len(points)) % 1000
            words = {"rotation": quaternion_wxyz(pose[:3, :3]).tolist(), "translation": pose[:3, 3].tolist()}
            scans.append({"fields": fields, "name": f"setup {k}", "maximum": 255, **words})
        paths.append(write_e57(folder / f"project{number}.e57", scans))
    return paths


def poses_of(folder):
    with open(folder / "poses.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    numbers = [[float(row[f"m{i}{j}"] or "nan") for i in range(4) for j in range(4)] for row in rows]
    return torch.tensor(numbers, dtype=torch.float64).view(-1, 4, 4)


def read_by_pye57(path):
    """Points (N, 3) of every scan in the frame of the file, and its pose."""
    file = pye57.E57(str(path))
    scans = []
    for k in range(file.scan_count):
        data = file.read_scan(k, ignore_missing_fields=True, intensity=True, colors=True, transform=True)
        points = np.stack([data[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
        header = file.get_header(k)
        pose = torch.eye(4, dtype=torch.float64)
        pose[:3, :3], pose[:3, 3] = torch.from_numpy(header.rotation_matrix), torch.from_numpy(header.translation)
        scans.append((torch.from_numpy(points), header["name"].value(), data, pose))
    return scans


def test_two_projects_become_one_and_a_merged_cloud(run, rooms, projects, tmp_path):
    whole, merged, log = tmp_path / "site.e57", tmp_path / "whole.laz", tmp_path / "poses.log"
    words = ("--placed", whole, "--merged", merged, "--spacing", "0.05", "--redwood", log)
    result = run("site", *projects, "--out", tmp_path / "out", *words)
    assert result.exit_code == 0, result.output
    poses = poses_of(tmp_path / "out")
    scans = read_by_pye57(whole)
    assert [name for _, name, _, _ in scans] == [f"setup {k}" for k in range(4)]
    moved = []
    for k, (points, _, data, new) in enumerate(scans):
        room = rooms.scans[k]
        before = apply(random_transform(seeded(k)), room.points.double())
        assert (points - apply(poses[k], before)).abs().max() < 1e-6  # what poses.csv says, in the order of the file
        assert (new - compose(poses[k], random_transform(seeded(k)))).abs().max() < 1e-6
        assert np.abs(data["intensity"] - np.linspace(0, 1, len(points))).max() < 1e-6
        moved.append(compose(new, inverse(rooms.T_world_scan[k])))
    for other in moved[1:]:  # one motion from the truth to the file for all: the points of all scans coincide
        assert (other - moved[0]).abs().max() < 0.01
    assert "rowIndex" in result.stderr

    with laspy.open(merged) as file:
        rows = file.read()
    points = torch.from_numpy(np.stack([rows.x, rows.y, rows.z], axis=1).astype(float))
    every = torch.cat([one for one, _, _, _ in scans])
    assert torch.cdist(points, every).amin(dim=1).max() < 0.05  # the mean of a cube
    assert set(np.unique(rows.point_source_id)) == {0, 1, 2, 3}
    owner = torch.cdist(points, scans[0][0]).amin(dim=1)[torch.from_numpy(np.asarray(rows.point_source_id) == 0)]
    assert owner.max() < 0.05
    assert int(np.asarray(rows.red).max()) > 0
    lines = log.read_text().splitlines()
    assert [line for line in lines if len(line.split()) == 3] == ["0 0 1", "1 1 2", "2 2 3", "3 3 4"]


def test_a_folder_gets_each_file_as_what_it_came(run, rooms, projects, tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    tr.write_cloud(tmp_path / "a" / "scan.ply", rooms.scans[2])
    tr.write_cloud(tmp_path / "b" / "scan.ply", rooms.scans[3])
    shutil.copy(projects[0], tmp_path / "a" / "scan.e57")
    inputs = [tmp_path / "a" / "scan.e57", tmp_path / "a" / "scan.ply", tmp_path / "b" / "scan.ply"]
    before = [path.read_bytes() for path in inputs]
    result = run("site", *inputs, "--out", tmp_path / "out", "--placed", tmp_path / "placed")
    assert result.exit_code == 0, result.output
    files = sorted(path.relative_to(tmp_path / "placed").as_posix() for path in (tmp_path / "placed").rglob("*.*"))
    assert files == ["a/scan_e57.e57", "a/scan_ply.ply", "b/scan.ply"]
    poses = poses_of(tmp_path / "out")
    assert len(read_by_pye57(tmp_path / "placed" / "a" / "scan_e57.e57")) == 2
    for k, name in ((2, "a/scan_ply.ply"), (3, "b/scan.ply")):
        back = tr.read_cloud(tmp_path / "placed" / name)
        given = rooms.scans[k]
        assert (back.points.double() + back.origin - apply(poses[k], given.points.double())).abs().max() < 1e-4
        assert (back.colors - given.colors).abs().max() < 0.6 / 255
    assert [path.read_bytes() for path in inputs] == before

    again = run("site", *inputs, "--out", tmp_path / "out", "--placed", tmp_path / "p2", "--placed-format", "laz")
    assert again.exit_code == 0, again.output
    files = sorted(path.relative_to(tmp_path / "p2").as_posix() for path in (tmp_path / "p2").rglob("*.*"))
    assert files == ["a/scan_e57_00.laz", "a/scan_e57_01.laz", "a/scan_ply.laz", "b/scan.laz"]
    (scan, *_) = read_scans(tmp_path / "p2" / "a" / "scan_e57_01.laz")
    assert scan.intensity is not None
    assert "scaled to numbers from 0 to 65535" in again.stderr
    assert "the position of the scanner" in again.stderr


def test_scans_that_are_not_placed_are_not_written(run, rooms, tmp_path):
    for k in range(2):
        tr.write_cloud(tmp_path / f"{k}.ply", rooms.scans[k])
    (tmp_path / "2.ply").write_text("no cloud")
    inputs = [tmp_path / f"{k}.ply" for k in range(3)]
    result = run("site", *inputs, "--out", tmp_path / "out", "--placed", tmp_path / "placed", "--voxel", "0.1")
    assert result.exit_code == 3
    assert sorted(path.name for path in (tmp_path / "placed").iterdir()) == ["0.ply", "1.ply"]
    assert "1 scan not written" in result.stderr
    assert "thinned to cubes of 0.1 m (2 scans)" in result.stderr
    nothing = run("site", inputs[0], "--out", tmp_path / "other", "--placed", tmp_path / "none")
    assert f"{tmp_path / 'none'} not written: no scan is placed" in nothing.stderr
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--placed", "no/such/folder"), "--placed: expected a folder in one that exists"),
        (("--placed", "."), "--placed: expected a folder without scans that are read"),
        (("--placed", "new"), "--placed-format: expected .ply"),
        (("--placed", "new", "--placed-format", "stl"), "--placed-format: expected .ply"),
        (("--placed-format", "ply"), "--placed-format: expected --placed too"),
        (("--placed", "a.e57", "--placed-format", "ply"), "--placed-format: expected none beside the file"),
        (("--placed", "scan.ptx"), "--placed: expected a file of its own"),
        (("--placed", "a.e57", "--merged", "a.e57"), "a file of its own"),
        (("--redwood", "a.txt"), "--redwood: expected a name that ends in .log"),
    ],
)
def test_usage_is_checked_before_anything_is_read(run, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    result = run("site", "scan.pts", "scan.ptx", "--out", "out", *words)
    assert result.exit_code == 2
    assert message in result.stderr


def placed_site(group):
    return site_of_poses(torch.eye(4, dtype=torch.float64).expand(len(group), 4, 4), group)


def test_names_never_collide_and_groups_stay_apart(tmp_path):
    names = ("A.ply", "a.ply", "a.e57", "a.ply", "x/a_ply.ply", "a_ply.ply", "a_e57_00.ply", "b.copc.laz")
    scans = [InputScan(tmp_path / name, k) for k, name in enumerate(names)]
    scans[3:3] = [InputScan(tmp_path / "a.e57", 2)] * 2
    site = placed_site([0, 0, 0, 1, -1, 0, 0, 0, 0, 0])
    for suffix in (None, ".laz", ".e57"):
        files = placed_files(tmp_path / "out", suffix, scans, site, [tmp_path / "out" / "b.laz"])
        paths = [str(file.path).lower() for file in files]
        assert len(set(paths)) == len(paths)
        assert sorted(scan for file in files for scan in file.scans) == [0, 1, 2, 3, 5, 6, 7, 8, 9]
        for file in files:
            assert len({int(site.group[scan]) for scan in file.scans}) == 1
            assert ("group1" in file.path.parts) == (int(site.group[file.scans[0]]) == 1)
            assert file.path.parent.is_relative_to(tmp_path / "out")
        assert str(tmp_path / "out" / "b.laz").lower() not in paths
    (file,) = placed_files(tmp_path / "site.e57", None, scans, site)
    assert file.scans == (0, 1, 2, 5, 6, 7, 8, 9)
