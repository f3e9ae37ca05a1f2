"""``torchreg site``: files in, poses, JSON, a merged cloud and a page out, and what it says of scans that fail."""

import csv
import json

import pytest
import torch
from problems import room_site, sphere_cloud
from sites import errors

import torchreg as tr
from torchreg.cli.progress import batch_progress
from torchreg.geometry.se3 import rigid, transform
from torchreg.geometry.small_motions import rotation_of
from torchreg.io.poses_csv import write_poses_csv
from torchreg.site import SiteProgress


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
    lines = (
        "describing clouds: 3 of 3",
        "registering pairs: 0 of 3",
        "registering pairs: 3 of 3",
        "placing scans: 0 of 3",
    )
    places = [result.stderr.index(line) for line in (*lines, "refining pairs: ")]
    assert places == sorted(places)
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


def test_shards_and_a_last_run_find_what_one_run_does(run, rooms, tmp_path):
    paths, _ = rooms
    assert run("site", *paths, "--out", tmp_path / "one", "--workers", "0").exit_code == 0
    command = ("site", *paths, "--out", tmp_path / "out", "--workers", "0")
    for shard in ("2/2", "1/2"):
        result = run(*command, "--shard", shard)
        assert result.exit_code == 0, result.output
    result = run(*command)
    assert result.exit_code == 0, result.output
    for name in ("poses.csv", "site.json"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()


def test_a_shard_begins_nothing_in_a_folder_of_something_else(run, rooms, tmp_path):
    paths, _ = rooms
    (tmp_path / "notes.txt").write_text("mine")
    result = run("site", *paths, "--out", tmp_path, "--shard", "1/2")
    assert result.exit_code == 2
    assert "got one with notes.txt" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_residuals_of_an_earlier_run_do_not_stay_but_other_files_do(run, rooms, tmp_path):
    paths, truth = rooms
    lines = ["name,scan,x,y,z,X,Y,Z"]
    for here in ([1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.5]):
        there = truth[0, :3, :3] @ torch.tensor(here, dtype=torch.float64) + truth[0, :3, 3]
        lines.append(",".join(["P", paths[0].name, *map(repr, [*here, *there.tolist()])]))
    (tmp_path / "points.csv").write_text("\n".join(lines))
    command = ("site", *paths, "--out", tmp_path / "out", "--workers", "0")
    kept = tmp_path / "out" / "control.csv"
    assert run(*command, "--control", tmp_path / "points.csv").exit_code == 0
    assert kept.exists()
    assert run(*command).exit_code == 0
    assert not kept.exists()
    kept.write_text(lines[0])
    assert run(*command).exit_code == 0
    assert kept.read_text() == lines[0]


def test_a_damaged_database_is_named_with_the_way_out(run, rooms, tmp_path):
    paths, _ = rooms
    command = ("site", *paths, "--out", tmp_path / "out", "--workers", "0")
    assert run(*command).exit_code == 0
    database = tmp_path / "out" / "site.sqlite"
    database.write_bytes(b"no database" * 1000)
    result = run(*command)
    assert result.exit_code == 2
    assert "a damaged file: without it, the run begins anew" in " ".join(result.stderr.split())
    database.unlink()
    assert run(*command).exit_code == 0


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


def write_ptx(project, paths, poses):
    """The scans as one PTX file with a pose for each."""
    lines = []
    for path, T in zip(paths, poses, strict=True):
        cloud = tr.read_cloud(path)
        columns = [" ".join(map(repr, column)) for column in T.t().tolist()]
        place = columns[3].rsplit(" ", 1)[0]
        header = [str(len(cloud.points)), "1", place, *(column.rsplit(" ", 1)[0] for column in columns[:3]), *columns]
        colors = (255 * cloud.colors).round().int().tolist()
        rows = [
            f"{x} {y} {z} 0.5 {r} {g} {b}" for (x, y, z), (r, g, b) in zip(cloud.points.tolist(), colors, strict=True)
        ]
        lines += [*header, *rows]
    project.write_text("\n".join(lines) + "\n")


def test_a_file_of_several_scans_gives_them_all(run, tmp_path, rooms):
    paths, truth = rooms
    project = tmp_path / "project.ptx"
    write_ptx(project, paths, torch.eye(4).double().repeat(3, 1, 1))
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
        (("--out", "out", "--fix", "0", "--control", "p.csv"), "--control: expected neither --fix nor --poses"),
        (("--out", "out", "--poses", "p.csv", "--pose-sigma", "0"), "--pose-sigma: expected"),
        (("--out", "out", "--report", "p.html", "--control", "p.html"), "--report: expected a file of its own"),
    ],
)
def test_usage_is_checked_before_anything_is_read(run, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    result = run("site", "missing.ply", *words)
    assert result.exit_code == 2
    assert message in result.stderr


@pytest.mark.parametrize(
    ("option", "text", "message"),
    [
        ("--control", "name,scan,x,y,z\n", "expected a header with name, scan, x, y, z, X, Y, Z"),
        ("--control", "name,scan,x,y,z,X,Y,Z\nA,0,1,2,three,4,5,6\n", "line 2: expected a number in the column z"),
        ("--poses", "scan,m00\n", "expected a header with scan, m00, m01"),
    ],
)
def test_tables_are_checked_before_anything_is_read_or_begun(run, tmp_path, option, text, message):
    (tmp_path / "table.csv").write_text(text)
    result = run("site", tmp_path / "missing.ply", "--out", tmp_path / "out", option, tmp_path / "table.csv")
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


def test_an_interrupted_run_says_that_it_goes_on(run, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("torchreg.cli.site.run_site", interrupted)
    result = run("site", tmp_path / "a.ply", "--out", tmp_path / "out", "--workers", "0")
    assert result.exit_code == 130
    assert f"what was done is kept in {tmp_path / 'out'}; the same command resumes from there" in result.stderr


def test_a_line_is_said_where_a_stage_begins_and_ends(capsys):
    with batch_progress() as report:
        for stage, done in (("describe", 0), ("describe", 1), ("describe", 3), ("register", 0), ("register", 1)):
            report(SiteProgress(stage, done, 3))
    said = [line.split(",")[0] for line in capsys.readouterr().err.splitlines()]
    counts = ("describing clouds: 0 of 3", "describing clouds: 3 of 3", "registering pairs: 0 of 3")
    assert said == [f"torchreg: {words}" for words in counts]


def test_no_scan_that_can_be_read_is_an_error(run, tmp_path):
    result = run("site", tmp_path / "missing.ply", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "SCANS: expected files of scans" in result.stderr
    assert not (tmp_path / "out" / "poses.csv").exists()


def test_a_fixed_scan_is_the_frame_and_known_poses_are_met(run, rooms, tmp_path):
    paths, truth = rooms
    result = run("site", *paths, "--out", tmp_path / "fixed", "--fix", "b.npz")
    assert result.exit_code == 0, result.output
    _, _, poses = poses_of(tmp_path / "fixed")
    torch.testing.assert_close(poses[1], torch.eye(4, dtype=torch.float64), rtol=0, atol=1e-9)
    assert not torch.allclose(poses[0], poses[1], atol=0.1)

    write_poses_csv(tmp_path / "known.csv", ["c"], torch.tensor([0]), truth[2:])
    result = run("site", *paths, "--out", tmp_path / "known", "--poses", tmp_path / "known.csv")
    assert result.exit_code == 0, result.output
    _, _, poses = poses_of(tmp_path / "known")
    assert (poses - truth)[:, :3, 3].norm(dim=1).max() < 0.02


def test_control_points_give_the_world_and_a_wrong_one_is_named(run, rooms, tmp_path):
    paths, truth = rooms
    lines = ["name,scan,x,y,z,X,Y,Z"]
    for number, (scan, off) in enumerate(((0, 0.0), (1, 0.0), (2, 0.0), (0, 0.8), (1, 0.0))):
        here = torch.tensor([1.0 + number, -2.0 * number, 0.5 * number**2], dtype=torch.float64)
        there = truth[scan, :3, :3] @ here + truth[scan, :3, 3] + torch.tensor([500_000.0, 0.0, off])
        lines.append(",".join([f"P{number}", paths[scan].name, *map(repr, [*here.tolist(), *there.tolist()])]))
    (tmp_path / "points.csv").write_text("\n".join(lines))
    result = run("site", *paths, "--out", tmp_path / "out", "--control", tmp_path / "points.csv")
    assert result.exit_code == 0, result.output
    assert "4 of 5 agree" in result.stderr
    assert "control point P3 in" in result.stderr
    _, _, poses = poses_of(tmp_path / "out")
    off = (poses - truth)[:, :3, 3] - torch.tensor([500_000.0, 0.0, 0.0])
    assert off.norm(dim=1).max() < 0.02
    with open(tmp_path / "out" / "control.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["suspicious"] for row in rows] == ["0", "0", "0", "1", "0"]
    assert abs(float(rows[3]["meters"]) - 0.8) < 0.05


def test_frames_are_level_unless_asked_not_to(run, tmp_path):
    site = room_site(3)
    tilts = rotation_of(torch.tensor([[0.05, 0.0, 1.0], [-0.03, 0.04, 2.0], [0.0, 0.06, -1.0]]).double())
    stand = rigid(tilts @ site.T_world_scan[:, :3, :3], torch.zeros(3, 3).double())
    paths = [tmp_path / f"{number}.ply" for number in range(3)]
    for path, scan, T in zip(paths, site.scans, stand, strict=True):
        tr.write_cloud(path, transform(scan, T))
    leans = []
    for words in ((), ("--no-level",)):
        result = run("site", *paths, "--out", tmp_path / "out", *words)
        assert result.exit_code == 0, result.output
        _, _, poses = poses_of(tmp_path / "out")
        leans.append(torch.rad2deg(torch.acos((poses[:, :3, :3] @ tilts[:, :, 2, None])[:, 2, 0])))
    assert leans[0].max() < 1.0
    assert leans[1].min() > 2.0
    assert torch.equal(poses[0], torch.eye(4, dtype=torch.float64))


def test_poses_of_files_need_files_with_poses(run, rooms, tmp_path):
    paths, _ = rooms
    result = run("site", *paths, "--out", tmp_path / "out", "--poses", "files")
    assert result.exit_code == 2
    assert "--poses: expected files with poses" in result.stderr


def test_poses_of_files_are_kept_as_far_as_they_are_right(run, rooms, tmp_path):
    paths, truth = rooms
    rough = truth.clone()
    rough[2, :3, 3] += torch.tensor([0.04, 0.0, 0.0])
    project = tmp_path / "project.ptx"
    write_ptx(project, paths, rough)
    result = run("site", project, "--out", tmp_path / "out", "--poses", "files")
    assert result.exit_code == 0, result.output
    _, _, poses = poses_of(tmp_path / "out")
    off = poses - torch.eye(4, dtype=torch.float64)
    assert off[:2].abs().max() < 0.02
    mended = poses[2, :3, :3] @ rough[2, :3, 3] + poses[2, :3, 3]  # where the scanner is now
    assert (mended - truth[2, :3, 3]).norm() < 0.02
