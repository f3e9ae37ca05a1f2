"""The examples run as they stand, in an empty folder and without data, and end at the truth."""

import ast
import json
import runpy
from pathlib import Path

import pytest
import torch

import torchreg as tr

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(path.stem for path in FOLDER.glob("*.py"))


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Run an example in an empty folder; returns its names and that folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(FOLDER.parent))  # for the commands that it starts
    state = torch.random.get_rng_state()
    yield lambda name: (runpy.run_path(str(FOLDER / f"{name}.py")), tmp_path)
    torch.random.set_rng_state(state)


def degrees(T_true, T):
    return float(tr.metrics.rre(T_true.view(1, 4, 4), T.view(1, 4, 4)))


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_short_and_says_first_what_it_shows(name):
    text = (FOLDER / f"{name}.py").read_text()
    assert ast.get_docstring(ast.parse(text)).partition("\n")[0].endswith((".", "?"))
    assert len(text.splitlines()) <= 45


def test_every_example_is_run_below():
    own = Path(__file__).read_text()
    assert [name for name in EXAMPLES if f'run("{name}")' not in own] == []


def test_two_scans(run, capsys):
    names, folder = run("register_two_scans")
    assert degrees(names["hall"].T_target_source, names["T"]) < 0.3
    moved = tr.read_cloud(folder / "a_in_b.ply")
    expected = tr.transform(names["source"], names["T"])
    assert torch.allclose(moved.points + moved.origin, expected.points + expected.origin, atol=1e-4)
    assert "Verdict     registered" in capsys.readouterr().out


def test_a_site(run):
    names, folder = run("site_from_a_folder")
    assert names["site"].group.tolist() == [0, 0, 0, 0]
    source, target = names["site"].T_world_scan[1:3]
    assert degrees(names["near"].T_target_source, torch.linalg.inv(target) @ source) < 0.3
    assert "station_3" in (folder / "site.html").read_text(encoding="utf-8")


def test_placed_files(run):
    names, folder = run("place_e57_and_las")
    scans = tr.read_scans(folder / "placed.e57")
    assert [scan.scan for scan in scans] == ["mapped", "A", "B"]
    truth = names["T_map"] @ names["near"].T_target_source
    assert degrees(truth, scans[1].pose) < 0.3
    assert torch.allclose(scans[1].pose[:3, 3], truth[:3, 3], atol=0.05)
    alone = tr.read_cloud(folder / "A.las")
    assert len(alone.points) == len(names["near"].source.points)
    assert float((alone.origin + alone.points.double().mean(0) - truth[:3, 3]).norm()) < 20  # meters, of 5,335,000


def test_a_batch(run):
    _, folder = run("batch_with_resume")
    pairs = json.loads((folder / "results" / "results.json").read_text())
    assert [pair["success"] for pair in pairs] == [True, True]
    assert max(pair["rre_degrees"] for pair in pairs) < 0.5


def test_training_lowers_the_loss(run, capsys):
    run("train_through_the_pose")
    lines = capsys.readouterr().out.splitlines()
    losses = [float(line.split("loss ")[1].split(",")[0]) for line in lines]
    assert losses[-1] < 0.8 * losses[0]


def test_own_features_find_the_pose(run):
    names, _ = run("own_features")
    assert bool(names["result"].success)
    assert degrees(names["hall"].T_target_source, names["result"].T_target_source) < 0.3


def test_a_new_descriptor_takes_part(run):
    names, _ = run("new_descriptor")
    assert bool(names["result"].success)
    assert any("spread" in proposal.origin for proposal in names["result"].stages[0].proposals)
    assert degrees(names["hall"].T_target_source, names["result"].T_target_source) < 0.3


def test_a_right_and_a_wrong_transform(run, capsys):
    names, _ = run("verify_a_transform")
    assert "the truth: probability 0.9" in capsys.readouterr().out
    assert float(names["verdict"].probability) < 0.01


def test_options(run, capsys):
    run("choose_options")
    rows = {line[:20].strip(): line[20:].split() for line in capsys.readouterr().out.splitlines()}
    assert rows["default"][0] == rows["fast"][0] == "True"
    assert float(rows["default"][1]) < 0.3
