"""``torchreg bench``: its commands end to end on made-up scans."""

import json
import re

import pytest
import torch
import typer
from folders import block
from problems import room_pair
from real_folders import project

import torchreg as tr
from torchreg.benchmark.peers import METHODS
from torchreg.benchmark.site import registry as site_registry
from torchreg.benchmark.site.method import SiteAnswer, SiteMethod
from torchreg.cli import app as app_module

UNITS = "METERS|MODULE|COUNT|NAME|PATH|FOLDER|NUMBER|from 1 to 5|Where to compute"


@pytest.mark.parametrize("name", ["field", "3dmatch", "features", "site", "paper", "speed", "family"])
def test_every_option_names_its_unit(run, name):
    command = typer.main.get_command(app_module.app).commands["bench"].commands[name]
    for parameter in command.params:
        if parameter.name != "help":
            switch = getattr(parameter, "is_flag", False)
            assert switch or re.search(UNITS, f"{parameter.metavar} {parameter.help}"), parameter.name
    shown = run("bench", name, "--help").stdout
    assert "Exit code 0" in shown


def test_every_method_is_named_in_the_help(run):
    shown = "".join(run("bench", "field", "--help").stdout.split())
    assert all(name in shown for name in METHODS)


def test_field(run, tmp_path):
    (tmp_path / "data").mkdir()
    data = project(tmp_path / "data")
    out = tmp_path / "out"
    result = run(
        "bench", "field", "--data", data / "pairs.json", "--out", out, "--methods", "fpfh,open3d-100k", "--quick"
    )
    assert result.exit_code == 0, result.output
    assert "Open3D RANSAC, 100,000" in result.stdout
    assert "4 of 4: pair_2, torchreg, FPFH alone" in result.stderr
    text = (out / "field.md").read_text()
    assert "torchreg, FPFH alone (`fpfh`)" in text
    again = run("bench", "field", "--data", data, "--out", out, "--methods", "fpfh,open3d-100k", "--quick")
    assert "pair_2" not in again.stderr
    assert (out / "field.md").read_text() == text
    unknown = run("bench", "field", "--data", data, "--out", out, "--methods", "best")
    assert unknown.exit_code == 2
    assert "kiss-matcher" in unknown.stderr
    assert run("bench", "field", "--data", tmp_path / "no.json", "--out", out).exit_code == 2


def test_3dmatch(run, tmp_path):
    scene = tmp_path / "data" / "hall"
    scene.mkdir(parents=True)
    pair = room_pair(1500, seed=3)
    tr.write_cloud(scene / "cloud_bin_0.ply", pair.target)
    tr.write_cloud(scene / "cloud_bin_2.ply", pair.source)
    (scene / "gt.log").write_text(block(0, 2, 3, pair.T_target_source[0]))
    out = tmp_path / "out"
    words = ("bench", "3dmatch", tmp_path / "data", "--out", out, "--methods", "fpfh", "--voxel", "0.15")
    result = run(*words)
    assert result.exit_code == 0, result.output
    assert "Registration recall" in result.stdout
    assert "hall (1)" in result.stdout
    text = (out / "3dmatch.md").read_text()
    assert "torchreg, FPFH alone (`fpfh`)" in text
    assert "voxels of 0.15 m" in text
    assert run(*words, "--seed", "1").exit_code == 2
    assert run(*words, "--log", "no.log").exit_code == 2
    assert run("bench", "3dmatch", tmp_path / "nowhere", "--out", out).exit_code == 2


def test_features(run, tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    data = project(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "heights_of_points.py").write_text("def heights(cloud):\n    return cloud.points\n")
    words = ("--data", data, "--out", tmp_path / "out", "--methods", "fpfh", "--quick")
    result = run("bench", "features", "heights_of_points:heights", *words)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "out" / "features.md").read_text()
    assert "heights_of_points:heights, matches alone" in text
    assert "FPFH as given features" in text
    unknown = run("bench", "features", "heights_of_points:nothing", *words)
    assert unknown.exit_code == 2
    assert "adapter: expected a callable that can be imported" in unknown.stderr


def test_family(run, tmp_path):
    (tmp_path / "data").mkdir()
    data = project(tmp_path / "data")
    words = ("bench", "family", "--real", data, "--out", tmp_path / "out", "--fusions", "contrast", "--quick")
    result = run(*words)
    assert result.exit_code == 0, result.output
    assert "Pairs with colors: 1 of 1 scenes" in result.stdout
    assert "3 of 3: real/pair_0, fpfh+color" in result.stderr
    text = (tmp_path / "out" / "family.md").read_text()
    assert "| contrast | 1 |" in text
    assert "Found, real pairs: a hall (1)" in text
    assert "pair_0" not in run(*words).stderr
    assert run(*words, "--points", "500").exit_code == 0  # a quick run has its own number of points
    assert run(*words, "--seed", "1").exit_code == 2
    assert "fpfh+color/root" in run(*words[:-2], "best").stderr
    assert run(*words, "--hard", tmp_path / "no.json").exit_code == 2
    assert run("bench", "family", "--out", tmp_path / "out").exit_code == 2


@pytest.mark.parametrize("name", ["field", "3dmatch"])
def test_the_help_names_every_method(run, name):
    shown = " ".join(run("bench", name, "--help").stdout.replace("│", " ").split())
    assert all(method in shown for method in METHODS)


def test_sites_end_to_end(run, tmp_path, monkeypatch):
    """A method that leaves every scan where it is, on a real site of two clouds and on a building."""

    def stay(task):
        count = len(task.scans)
        T = torch.eye(4, dtype=torch.float64).repeat(count, 1, 1)
        return SiteAnswer(T_world_scan=T, group=torch.zeros(count, dtype=torch.int64), pairs_tried=1)

    made = SiteMethod(name="stay", title="as they are", statement="Nothing is moved.", run=stay)
    monkeypatch.setattr(site_registry, "SITE_METHODS", {"stay": made})
    still, out = tmp_path / "still", tmp_path / "out"
    still.mkdir()
    scans = []
    for k in range(2):
        tr.write_cloud(still / f"{k}.ply", tr.Clouds(points=torch.rand(20, 3)))
        scans.append({"file": f"{k}.ply", "T_world_scan": torch.eye(4).tolist()})
    (still / "site.json").write_text(json.dumps({"voxel_m": 0.1, "scans": scans}))
    words = ("bench", "site", "--quick", "--data", still, "--out", out)
    shown = run(*words)
    assert shown.exit_code == 0, shown.output
    assert "Real sites: 1 with 2 scans" in shown.stdout
    text = (out / "site.md").read_text()
    assert "| still | as they are | 2 | 1.000 | 0 | 0 |" in text
    assert re.search(r"building-0-of-5 \| as they are \| 5 \| 0.000 \| 4 ", text)
    rows = [row["key"] for row in json.loads((out / "site.json").read_text())["rows"]]
    assert rows == ["building-0-of-5/stay", "still/stay"]
    assert run(*words, "--methods", "best").exit_code == 2
    assert run(*words, "--sites", "nowhere").exit_code == 2
    assert run(*words, "--seed", "1").exit_code == 2
    assert run("bench", "site", "--scans", "3", "--out", out).exit_code == 2
    assert run("bench", "site", "--data", tmp_path / "nothing", "--out", out).exit_code == 2


def test_the_help_names_every_method_for_sites(run):
    shown = " ".join(run("bench", "site", "--help").stdout.replace("│", " ").split())
    assert all(method in shown for method in site_registry.SITE_METHODS)
