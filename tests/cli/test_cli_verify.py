"""``torchreg verify``: what it prints and writes, and its exit code."""

import json

import numpy as np
import pytest

from torchreg.io import read_transform_text


@pytest.fixture
def moved(room, tmp_path):
    """The true transform, its translation changed by meters, as a file."""

    def write(*meters):
        T = read_transform_text(room.truth).numpy().copy()
        T[:3, 3] += meters
        np.savetxt(tmp_path / "moved.txt", T)
        return tmp_path / "moved.txt"

    return write


def test_a_right_transform(run, room, tmp_path):
    words = ("verify", room.source, room.target, room.truth, "--json", tmp_path / "v.json", "--explain")
    result = run(*words)
    assert result.exit_code == 0, result.output
    for part in (room.truth, "inlier threshold", "settles", "probability", "Verdict", "May help"):
        assert part in result.stdout.replace("\n", "")
    content = json.loads((tmp_path / "v.json").read_text(), parse_constant=pytest.fail)
    assert (content["success"], content["transform"]) == (True, room.truth)
    assert content["T_target_source"] == read_transform_text(room.truth).tolist()
    assert content["deviation_meters"] < 0.05
    assert content["run"]["preset"] == "default"


def test_a_wrong_one_and_json_alone_on_standard_output(run, room, moved):
    result = run("verify", room.source, room.target, moved(0, 0, 8), "--json", "-", "--effort", "fast")
    assert result.exit_code == 3
    content = json.loads(result.stdout)
    assert content["failure"]["kind"] == "another pose is better"
    assert content["search"]["options"]["effort"] == "fast"
    assert f"torchreg: not right: {content['reason']}" in result.stderr


def test_the_json_of_register_is_a_transform(run, room, tmp_path):
    assert run("register", room.source, room.target, "--effort", "fast", "--json", tmp_path / "r.json").exit_code == 0
    result = run("verify", room.source, room.target, tmp_path / "r.json", "--effort", "fast")
    assert result.exit_code == 0, result.output
    assert result.stdout.rstrip().endswith("right")


def test_bad_usage(run, room, moved, tmp_path):
    assert run("verify", room.source, room.target).exit_code == 2
    plain = run("verify", room.source, room.target, room.truth, "--effort", "plain")
    assert plain.exit_code == 2
    assert "--effort: expected one of 'fast'" in plain.stderr
    (tmp_path / "mirrored.txt").write_text("-1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    mirrored = run("verify", room.source, room.target, tmp_path / "mirrored.txt")
    assert mirrored.exit_code == 2
    assert "a reflection" in mirrored.stderr
    given = moved(0, 0, 0)
    overwriting = run("verify", room.source, room.target, given, "--json", given)
    assert overwriting.exit_code == 2
    assert "an input" in overwriting.stderr
