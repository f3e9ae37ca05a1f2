"""Whatever comes: a message or a failed result with its reason, never a traceback, never a silent identity."""

import json

import pytest
import torch

import torchreg as tr


def random_points(count, seed=0, scale=1.0):
    return scale * torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))


# name -> (points or bytes, exit code as the source of a pair, words of the message or reason)
FILES = {
    "empty file": (b"", 2, "empty"),
    "not a cloud": (b"hello, this is a shopping list\n", 2, "ply"),
    "header alone": (b"ply\nformat ascii 1.0\nelement vertex 10\nproperty float x\n", 2, "header"),
    "lying header": (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999\nproperty float x\nproperty float y\n"
        b"property float z\nend_header\n" + bytes(120),
        2,
        "999999999",
    ),
    "one point": (random_points(1), 3, "too few points"),
    "two points": (random_points(2), 3, "too few points"),
    "all points equal": (torch.ones(50, 3), 3, "coincide"),
    "collinear": (torch.linspace(0, 1, 50)[:, None] * torch.ones(3), 3, "one line"),
}


@pytest.mark.parametrize("which", FILES)
@pytest.mark.parametrize("as_source", [True, False])
def test_bad_files(run, room, cloud_file, tmp_path, which, as_source):
    content, code, words = FILES[which]
    if isinstance(content, bytes):
        path = tmp_path / "bad.ply"
        path.write_bytes(content)
    else:
        path = cloud_file("bad.ply", content)
    pair = (path, room.target) if as_source else (room.source, path)
    result = run("register", *pair, "--json", "-")
    assert result.exit_code == code, result.output
    assert words in result.stderr
    if code == 2:
        assert "bad.ply" in result.stderr.replace("\n", "")
        assert result.stdout == ""
        assert run("info", path).exit_code == 2
    else:
        found = json.loads(result.stdout)
        assert found["success"] is False
        assert f"not registered: {found['reason']}\n" in result.stderr
        assert run("info", path).exit_code == 0


def test_a_truncated_file(run, room, tmp_path):
    with open(room.source, "rb") as file:
        (tmp_path / "cut.ply").write_bytes(file.read()[:5000])
    assert run("register", tmp_path / "cut.ply", room.target).exit_code == 2


def test_missing_folder_and_other_kinds(run, room, tmp_path):
    (tmp_path / "cloud.xyzw").write_text("1 2 3\n")
    for path, words in (
        (tmp_path / "nothing.ply", "nothing of this name"),
        (tmp_path, "a folder"),
        (tmp_path / "cloud.xyzw", ".xyzw"),
    ):
        result = run("register", path, room.target)
        assert result.exit_code == 2
        assert words in result.stderr.replace("\n", "")
        assert result.stdout == ""


ODD = ("coplanar", "duplicates", "far away", "with NaN", "gray", "no colors", "nothing shared")


@pytest.mark.parametrize("kind", ODD)
def test_odd_clouds_end_with_a_verdict(run, room, tmp_path, kind):
    """No crash and no silent identity: a registration, or a reason."""
    cloud = tr.read_cloud(room.source)
    points, colors, origin = cloud.points.clone(), cloud.colors.clone(), None
    if kind == "coplanar":
        points[:, 2] = 0
    elif kind == "duplicates":
        points, colors = points.repeat(3, 1), colors.repeat(3, 1)
    elif kind == "far away":
        origin = torch.full((1, 3), 1e7, dtype=torch.float64)
    elif kind == "with NaN":
        points[::7, 1] = float("nan")
        points[::11, 0] = float("inf")
    elif kind == "gray":
        colors[:] = 0.5
    elif kind == "no colors":
        colors = None
    elif kind == "nothing shared":
        points, colors = random_points(3000, scale=3.0), random_points(3000, seed=1)
    tr.write_cloud(tmp_path / "odd.npz", tr.Clouds(points=points, colors=colors, origin=origin))
    result = run("register", tmp_path / "odd.npz", room.target, "--json", "-")
    assert result.exit_code in (0, 3), result.stderr
    found = json.loads(result.stdout, parse_constant=pytest.fail)
    assert found["success"] == (result.exit_code == 0)
    assert bool(found["reason"]) == (result.exit_code == 3)
    if found["success"]:
        assert (torch.tensor(found["T_target_source"]) - torch.eye(4)).abs().max() > 0.01
    if kind in ("duplicates", "far away", "no colors"):
        assert found["success"]
    if kind == "nothing shared":
        assert not found["success"]


BAD_WORDS = {
    "no files": (["register"], "Missing argument"),
    "unknown command": (["registre"], "No such command"),
    "unknown option": (["register", "a.ply", "b.ply", "--voxels", "1"], "No such option"),
    "preset": (["register", "a.ply", "b.ply", "--preset", "thesis"], "paper"),
    "voxel": (["register", "a.ply", "b.ply", "--voxel", "-1"], "--voxel: expected"),
    "voxel not a number": (["register", "a.ply", "b.ply", "--voxel", "wide"], "--voxel"),
    "voxel nan": (["register", "a.ply", "b.ply", "--voxel", "nan"], "--voxel: expected"),
    "confidence": (["register", "a.ply", "b.ply", "--confidence", "2"], "confidence"),
    "points": (["register", "a.ply", "b.ply", "--points", "0"], "--points"),
    "seed": (["register", "a.ply", "b.ply", "--seed", "2.5"], "--seed"),
    "viewpoint": (["register", "a.ply", "b.ply", "--viewpoint", "1,2"], "--viewpoint"),
    "figure": (["register", "a.ply", "b.ply", "--figure", "p.gif"], "--figure"),
    "matches": (["register", "a.ply", "b.ply", "--matches", "m.bmp"], "--matches"),
    "report": (
        ["register", "a.ply", "b.ply", "--report", "r.pdf"],
        "--report: expected a name that ends in .html or .htm, got 'r.pdf'",
    ),
    "effort": (["register", "a.ply", "b.ply", "--effort", "heroic"], "thorough"),
    "solver": (["register", "a.ply", "b.ply", "--solver", "magic"], "compatibility"),
    "picture twice": (["register", "a.ply", "b.ply", "--figure", "p.png", "--matches", "p.png"], "--matches"),
    "check radius": (
        ["check", "a.ply", "b.ply", "--feature-radius", "-1"],
        "--feature-radius: expected a finite number above 0, got -1.0",
    ),
    "aligned": (["register", "a.ply", "b.ply", "--aligned", "a.ptx"], "--aligned"),
    "no folder": (["register", "a.ply", "b.ply", "--json", "no/such/folder/r.json"], "--json"),
    "no such convention": (["register", "a.ply", "b.ply", "--transform-format", "euler"], "--transform-format"),
    "a convention of nothing": (["register", "a.ply", "b.ply", "--transform-format", "pdal"], "--transform beside it"),
    "over an input": (["register", "a.ply", "b.ply", "--aligned", "./a.ply"], "--aligned"),
    "twice": (["register", "a.ply", "b.ply", "--json", "x", "--transform", "x"], "--transform"),
    "angle": (["demo", "--angular-step", "90"], "--angular-step"),
    "nothing to force": (["register", "a.ply", "b.ply", "--force"], "--transform or --aligned beside it"),
    "idle": (
        ["register", "a.ply", "b.ply", "--hypotheses", "9"],
        "got the solver compatibility and the effort balanced",
    ),
    "info over its input": (["info", "a.ply", "--json", "a.ply"], "--json"),
    "demo picture": (["demo", "--figure", "p.docx"], "--figure"),
}


@pytest.mark.parametrize("which", BAD_WORDS)
def test_bad_usage(run, tmp_path, monkeypatch, which):
    monkeypatch.chdir(tmp_path)
    words, message = BAD_WORDS[which]
    result = run(*words)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_cuda_where_there_is_none(run, room, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    result = run("register", room.source, room.target, "--device", "cuda")
    assert result.exit_code == 2
    assert "--device" in result.stderr


def test_truth_that_is_none(run, room):
    result = run("register", room.source, room.target, "--truth", room.source)
    assert result.exit_code == 2
    assert "4 lines of 4 numbers" in result.stderr
