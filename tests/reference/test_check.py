"""``torchreg check``: its table, its JSON and its exit codes."""

import json
from importlib import import_module

import pytest
import torch
import typer
from problems import room_pair
from typer.testing import CliRunner

import torchreg as tr
from torchreg.cli.check import check
from torchreg.cli.guard import GuardedGroup
from torchreg.io import write_transform_text

VOXEL = ("--voxel", "0.2")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    pair = room_pair(4000, seed=1)
    tr.write_cloud(folder / "source.ply", pair.source)
    tr.write_cloud(folder / "target.ply", pair.target)
    write_transform_text(folder / "truth.txt", pair.T_target_source[0])
    return folder


@pytest.fixture
def run(monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.delenv("TORCHREG_DEBUG", raising=False)
    app = typer.Typer(cls=GuardedGroup)
    app.command()(check)
    app.callback()(lambda: None)

    def run(*words):
        result = CliRunner().invoke(app, ["check", *map(str, words)], catch_exceptions=False)
        assert "Traceback" not in result.output
        return result

    return run


def test_a_good_pair_in_a_table(run, files):
    result = run(files / "source.ply", files / "target.ply", *VOXEL, "--truth", files / "truth.txt")
    assert result.exit_code == 0, result.output
    named = ("torchreg", "Open3D", "shared", "RRE", "fitness", "hypotheses (s)", "source, float64", "target, float32")
    for words in named:
        assert words in result.stdout
    assert result.stdout.count("0.000000000") >= 6  # two transforms
    assert "FPFH agree; torchreg registered, its pose turned by" in " ".join(result.stdout.split())
    assert all("registering" in line for line in result.stderr.splitlines())  # how it goes, where it takes long


def test_json_on_standard_output_stands_alone(run, files):
    words = (*VOXEL, "--features", "fpfh", "--hypotheses", "20000", "--seed", "3", "--json", "-")
    result = run(files / "source.ply", files / "target.ply", *words)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout, parse_constant=pytest.fail)
    assert found["agree"] is True
    assert found["features"] == "fpfh"
    assert found["run"]["seed"] == 3
    assert found["options"]["voxel_size"] == 0.2
    assert found["options"]["solver"]["hypotheses"] == 20000
    assert found["options"]["solver"]["confidence"] < 1
    assert found["torchreg"]["truth"] is None
    assert found["versions"]["open3d"]
    assert result.stderr.splitlines()[-1].startswith("torchreg: FPFH agree; torchreg registered, its pose turned by")


def test_json_to_a_file_comes_beside_the_table(run, files, tmp_path):
    result = run(files / "source.ply", files / "target.ply", *VOXEL, "--json", tmp_path / "check.json")
    assert json.loads((tmp_path / "check.json").read_text())["agree"] is True
    assert "Open3D" in result.stdout


def test_paper_lengths_are_in_meters(run, files):
    result = run(files / "source.ply", files / "target.ply", "--preset", "paper", "--points", "1000", "--json", "-")
    found = json.loads(result.stdout)
    assert found["options"]["descriptors"][0]["radius"] == tr.PAPER.feature_radius
    assert found["points"] == {"source": 1000, "target": 1000}


def test_descriptors_that_differ_are_exit_code_3(run, files, monkeypatch):
    module = import_module("torchreg.descriptors.fpfh")
    right = module.unit_bins
    monkeypatch.setattr(module, "unit_bins", lambda value: right(value + 1e-3))
    result = run(files / "source.ply", files / "target.ply", *VOXEL)
    assert result.exit_code == 3
    assert "rows without a tie" in result.stdout


def test_a_registration_that_fails_is_exit_code_3(run, files, tmp_path):
    tr.write_cloud(tmp_path / "line.ply", tr.Clouds(points=torch.linspace(0, 5, 200)[:, None] * torch.ones(3)))
    result = run(tmp_path / "line.ply", files / "target.ply")
    assert result.exit_code == 3
    assert "on one line" in result.stdout
    assert "FPFH not compared" in result.stdout


@pytest.mark.parametrize("words", [("--voxel", "-1"), ("--truth", "nowhere.txt"), ("--json", "no/such/folder.json")])
def test_bad_usage_is_exit_code_2(run, files, words):
    result = run(files / "source.ply", files / "target.ply", *words)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr


def test_an_unreadable_file_is_exit_code_2(run, files, tmp_path):
    (tmp_path / "bad.ply").write_bytes(b"no cloud at all")
    result = run(files / "source.ply", tmp_path / "bad.ply")
    assert result.exit_code == 2
    assert "bad.ply" in result.stderr
