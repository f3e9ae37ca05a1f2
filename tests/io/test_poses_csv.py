"""Poses of a site as CSV: every bit comes back, and what is not placed is empty."""

import csv

import pytest
import torch
from problems import random_transform, seeded
from refusals import refuses

from torchreg.io.poses_csv import COLUMNS, write_poses_csv


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


@pytest.mark.parametrize("name", ["=cmd", "+1", "-x.ply", "@a"])
def test_a_name_that_is_a_formula_is_none_in_the_table(tmp_path, name):
    write_poses_csv(tmp_path / "poses.csv", [name], torch.tensor([0]), torch.eye(4).double()[None])
    assert rows_of(tmp_path / "poses.csv")[1][0] == f"'{name}"


def test_numbers_of_scans_that_differ_are_refused(tmp_path):
    with refuses("group", "(2,)", "(1,)"):
        write_poses_csv(tmp_path / "a.csv", ["a", "b"], torch.tensor([0]), torch.eye(4).double()[None])
    with refuses("T_world_scan", "(2, 4, 4)"):
        write_poses_csv(tmp_path / "a.csv", ["a", "b"], torch.tensor([0, 0]), torch.eye(4).double()[None])
    assert list(tmp_path.iterdir()) == []
