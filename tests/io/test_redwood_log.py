"""Logs of true motions: what is written comes back, and what is cut or altered is refused by its line."""

import numpy as np
import pytest
import torch
from problems import random_transform, seeded

from torchreg.errors import CloudFileError
from torchreg.io.redwood_log import read_redwood_info, read_redwood_log, write_redwood_trajectory

TURN = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]


def block(i, j, n, matrix, between="\t"):
    rows = [between.join(f"{value:.8e}" for value in row) for row in matrix]
    return between.join(map(str, (i, j, n))) + between + "\n" + "".join(f"{row} \n" for row in rows)


def refused(path, read=read_redwood_log):
    with pytest.raises(CloudFileError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert ", got " in message
    return message.removeprefix(str(path))


def made(tmp_path, content):
    path = tmp_path / "gt.log"
    path.write_text(content, newline="")
    return path


@pytest.mark.parametrize("between", ["\t", " ", "   "])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\n\n"])
def test_blocks_come_back_in_their_order(tmp_path, between, end):
    text = block(0, 2, 4, TURN, between) + block(3, 1, 4, np.eye(4), between)
    entries = read_redwood_log(made(tmp_path, text.replace("\n", end)))
    assert [(entry.i, entry.j) for entry in entries] == [(0, 2), (3, 1)]
    assert [entry.T_i_j.tolist() for entry in entries] == [TURN, np.eye(4).tolist()]
    assert entries[0].T_i_j.dtype == torch.float64
    assert entries[1].line == (6 if end != "\n\n" else 11)


def test_information(tmp_path):
    matrix = np.arange(36.0).reshape(6, 6)
    found = read_redwood_info(made(tmp_path, block(0, 1, 3, matrix) + block(1, 2, 3, -matrix)))
    assert {pair: one.tolist() for pair, one in found.items()} == {(0, 1): matrix.tolist(), (1, 2): (-matrix).tolist()}


GOOD = block(0, 1, 3, TURN)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", ": expected a file with content"),
        ("\n \n", ": expected a header i j n, got nothing but blank lines"),
        (GOOD + "1\t2\t3\n1 0 0 0\n0 1 0 0\n", ", line 6: expected 4 lines of numbers below it, got 2 before the file"),
        (GOOD + "1\t2\t3\n", ", line 6: expected 4 lines of numbers below it, got 0"),
        (GOOD + "1\t2\n" + GOOD, ", line 6: expected a header i j n, got '1 2'"),
        ("a b c\n" + GOOD, ", line 1: expected each of i j n as a whole number"),
        ("-1 0 3\n" + GOOD, ", line 1: expected each of i j n as a whole number"),
        (GOOD.replace("\n0.0", "\nx", 1), ", line 2: expected 4 numbers, got 'x"),
        ("0 1 3\n1 0 0 0\n0 1 0 0\n0 0 1\n0 0 0 1\n", ", line 4: expected 4 numbers, got '0 0 1'"),
        (block(0, 1, 3, 2 * np.eye(4)), ", line 1: expected a rigid transform, got the matrix: expected a last row"),
        (block(0, 1, 3, np.diag([1, 1, -1, 1])), "a reflection"),
        (block(0, 1, 3, np.full((4, 4), np.nan)), "finite numbers"),
        (GOOD + GOOD, ", line 6: expected a pair not listed before, got 0 1 as in line 1"),
        (block(1, 1, 2, TURN), ", line 1: expected two different fragments i j n, got 1 1 2, as a trajectory"),
        (block(0, 3, 3, TURN), ", line 1: expected fragments below the number n = 3 of them, got 0 3"),
        ("\0\1\2", ", line 1: expected a header i j n"),
    ],
)
def test_refused(tmp_path, content, message):
    assert message in refused(made(tmp_path, content))


def test_information_refused(tmp_path):
    assert "line 1: expected 6 lines" in refused(made(tmp_path, GOOD), read_redwood_info)
    infinite = np.full((6, 6), np.inf)
    assert "line 1: expected finite numbers" in refused(made(tmp_path, block(0, 1, 2, infinite)), read_redwood_info)


def test_missing(tmp_path):
    assert refused(tmp_path / "gt.log") == ": expected a file, got nothing of this name"


def test_open3d_reads_a_trajectory(tmp_path):
    from torchreg.open3d_loader import load_open3d

    poses = torch.stack([random_transform(seeded(seed)) for seed in range(3)])
    write_redwood_trajectory(tmp_path / "a.log", [0, 2, 5], poses)
    found = load_open3d().io.read_pinhole_camera_trajectory(str(tmp_path / "a.log")).parameters
    assert len(found) == 3
    for one, pose in zip(found, poses, strict=True):
        assert abs(torch.linalg.inv(pose) - torch.tensor(one.extrinsic)).max() < 1e-9  # from the world to the camera
    lines = (tmp_path / "a.log").read_text().splitlines()
    assert lines[5] == "2 2 3"
    with pytest.raises(ValueError, match="T_world_scan"):
        write_redwood_trajectory(tmp_path / "a.log", [0, 2], poses)
