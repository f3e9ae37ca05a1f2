"""Poses of a site as CSV: every bit comes back, and what is not placed is empty."""

import csv

import pytest
import torch
from problems import random_transform, seeded
from refusals import refuses

from torchreg.errors import CloudFileError
from torchreg.io.poses_csv import COLUMNS, read_poses_csv, write_poses_csv


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.reader(file))


def test_every_bit_comes_back(tmp_path):
    poses = torch.stack([random_transform(seeded(seed), 1e6) for seed in range(3)])
    poses[1] = torch.nan
    names = ["a.ply", "b, the second.ply", 'c "third".e57']
    write_poses_csv(tmp_path / "poses.csv", names, torch.tensor([0, -1, 2]), poses)
    head, *rows = rows_of(tmp_path / "poses.csv")
    assert head[:6] == ["scan", "group", "m00", "m01", "m02", "m03"]
    assert head[-1] == "m33"
    assert [row[:2] for row in rows] == [[names[0], "0"], [names[1], ""], [names[2], "2"]]
    for row in (0, 2):
        assert [float(cell) for cell in rows[row][2:]] == poses[row].flatten().tolist()
    assert rows[1][1:] == [""] * (len(COLUMNS) - 1)


@pytest.mark.parametrize("name", ["=cmd", "+1+1", "-x.ply", "@a"])
def test_a_name_that_is_a_formula_is_none_in_the_table(tmp_path, name):
    write_poses_csv(tmp_path / "poses.csv", [name], torch.tensor([0]), torch.eye(4).double()[None])
    assert rows_of(tmp_path / "poses.csv")[1][0] == f"'{name}"


def test_numbers_of_scans_that_differ_are_refused(tmp_path):
    with refuses("group", "(2,)", "(1,)"):
        write_poses_csv(tmp_path / "a.csv", ["a", "b"], torch.tensor([0]), torch.eye(4).double()[None])
    with refuses("T_world_scan", "(2, 4, 4)"):
        write_poses_csv(tmp_path / "a.csv", ["a", "b"], torch.tensor([0, 0]), torch.eye(4).double()[None])
    assert list(tmp_path.iterdir()) == []


def test_what_was_written_is_read_for_scans_in_another_order(tmp_path):
    poses = torch.stack([random_transform(seeded(seed), 1e6) for seed in range(4)])
    poses[1] = torch.nan
    names = ["x/a.ply", "x/b.ply", "=c.e57 [1]", "x/d.las"]
    write_poses_csv(tmp_path / "poses.csv", names, torch.tensor([0, -1, 2, 0]), poses)
    read = read_poses_csv(tmp_path / "poses.csv", [names[scan] for scan in (3, 2, 1, 0)])
    assert [each.scan for each in read] == [3, 1, 0]
    assert torch.equal(torch.stack([each.T_world_scan for each in read]), poses[[0, 2, 3]])


def test_a_table_that_is_none_of_poses_is_refused(tmp_path):
    path, eye = tmp_path / "p.csv", torch.eye(4).double()[None]
    write_poses_csv(path, ["a"], torch.tensor([0]), eye)
    with pytest.raises(CloudFileError, match="line 2: expected the name of a scan or a number from 0 to 0, got 'a'"):
        read_poses_csv(path, ["b"])
    write_poses_csv(path, ["a", "a"], torch.tensor([0, 0]), eye.repeat(2, 1, 1))
    with pytest.raises(CloudFileError, match="line 3: expected one pose of a scan, got another of a"):
        read_poses_csv(path, ["a"])
    write_poses_csv(path, ["a"], torch.tensor([0]), 2 * eye)
    with pytest.raises(ValueError, match="line 2: expected a last row 0 0 0 1"):
        read_poses_csv(path, ["a"])
    write_poses_csv(path, ["a"], torch.tensor([-1]), eye)
    with pytest.raises(CloudFileError, match="at least one pose"):
        read_poses_csv(path, ["a"])
