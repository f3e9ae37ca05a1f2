"""``torchreg train``: what it writes, resuming to the bit, held-out scenes, TensorBoard, and what it refuses."""

import csv
import json
import sys
from types import ModuleType

import pytest
import torch
from real_folders import project

from torchreg.cli import training_data as data_module
from torchreg.cli.training_folder import TrainingFolder
from torchreg.datasets import training_places
from torchreg.learning import load_network
from torchreg.learning.network_training import NetworkTraining

FILES = {"checkpoint.pt", "weights.pt", "log.csv", "held_out.csv", "held_out.json"}


@pytest.fixture
def train(run, tmp_path, monkeypatch):
    """Run ``torchreg train`` on rooms of two scenes, without simulated places and TensorBoard unless told otherwise."""
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    scenes = project(tmp_path)

    def train(out, *words, pairs=True, places=0):
        lists = ["--pairs", scenes] if pairs else []
        size = ["--steps", "4", "--points", "100", "--every", "2", "--places", f"{places}"]
        return run("train", "--out", tmp_path / out, *lists, *size, *words)

    return train


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def weights(folder):
    return torch.load(folder / "weights.pt", weights_only=True)["network"]


def alike(one, other):
    return all(torch.equal(one[name], other[name]) for name in one)


def test_it_trains_and_judges_by_scenes_that_it_never_saw(train, tmp_path):
    result = train("out", "--hold-out", "yard")
    assert result.exit_code == 0, result.output
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    log = rows(tmp_path / "out" / "log.csv")
    assert [row["step"] for row in log] == ["2", "4"]
    assert all(float(row["loss"]) > 0 and 0 <= float(row["inlier_ratio"]) <= 1 for row in log)
    held = rows(tmp_path / "out" / "held_out.csv")
    assert {row["group"] for row in held} == {"yard"}
    assert [row["features"] for row in held] == ["fpfh", "default", "LEARNED", "network", "default + network"]
    means = json.loads((tmp_path / "out" / "held_out.json").read_text(), parse_constant=pytest.fail)
    assert means["run"]["held_out"] == ["yard"]
    assert {row["group"] for row in means["groups"]} == {"yard", "all"}
    for words in ("yard", "inlier ratio", "default + network", "weights.pt"):
        assert words in result.stdout
    assert "training steps: 4 of 4" in result.stderr
    assert load_network(tmp_path / "out" / "weights.pt").sizes()["features"] == 32


def test_a_run_that_was_cut_off_goes_on_to_the_same_bits(train, tmp_path, monkeypatch):
    train("whole")
    step = NetworkTraining.step

    def cut(training):
        if training.done == 3:
            raise KeyboardInterrupt
        return step(training)

    monkeypatch.setattr(NetworkTraining, "step", cut)
    assert train("cut").exit_code == 130
    assert [row["step"] for row in rows(tmp_path / "cut" / "log.csv")] == ["2"]
    monkeypatch.setattr(NetworkTraining, "step", step)
    resumed = train("cut")
    assert resumed.exit_code == 0
    assert "resumed at step 2 of 4" in resumed.stderr
    assert alike(weights(tmp_path / "whole"), weights(tmp_path / "cut"))
    for name in ("log.csv", "held_out.csv"):
        assert (tmp_path / "whole" / name).read_text() == (tmp_path / "cut" / name).read_text()


def test_a_finished_run_is_judged_again_and_not_trained(train, tmp_path):
    train("out")
    before = weights(tmp_path / "out")
    (tmp_path / "out" / "held_out.csv").unlink()
    again = train("out")
    assert "resumed at step 4 of 4" in again.stderr
    assert alike(before, weights(tmp_path / "out"))
    assert rows(tmp_path / "out" / "held_out.csv")


def test_every_third_scene_is_held_out_by_default(train, tmp_path):
    train("out")
    assert {row["group"] for row in rows(tmp_path / "out" / "held_out.csv")} == {"hall"}


def test_without_held_out_scenes_nothing_is_judged(train, tmp_path):
    result = train("out", "--hold-out", "")
    assert result.exit_code == 0
    assert "nothing was judged" in result.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES - {"held_out.csv"}
    assert rows(tmp_path / "out" / "log.csv")[-1]["inlier_ratio"] == "nan"


@pytest.mark.slow
def test_simulated_places_are_enough(train, tmp_path, monkeypatch):
    monkeypatch.setattr(data_module, "_HELD_OUT_PLACES", 1)
    monkeypatch.setattr(training_places, "_STEP", 2.5)
    assert train("out", pairs=False, places=1).exit_code == 0
    assert {row["group"] for row in rows(tmp_path / "out" / "held_out.csv")} == {"malls", "roads", "buildings"}


def test_tensorboard_gets_the_log_where_it_is_installed(train, tmp_path, monkeypatch):
    seen = []

    class Writer:
        def __init__(self, folder):
            seen.append(folder)

        def add_scalar(self, name, value, step):
            seen.append((name, step))

        def flush(self):
            pass

    board = ModuleType("torch.utils.tensorboard")
    board.SummaryWriter = Writer
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", board)
    train("out")
    assert seen[0] == str(tmp_path / "out" / "tensorboard")
    assert seen[1:] == [(name, step) for step in (2, 4) for name in ("loss", "rate", "inlier_ratio")]


def test_another_run_does_not_take_up_the_folder(train, tmp_path):
    train("out")
    for words, expected in (
        (("--seed", "3"), "seed 3"),
        (("--hold-out", "yard"), "yard"),
        (("--steps", "9"), "steps 9"),
    ):
        result = train("out", *words)
        assert result.exit_code == 2
        assert "--out" in result.stderr
        assert expected in result.stderr


def test_what_does_not_fit_is_refused(train, run, tmp_path):
    cases = [
        (train("out", "--hold-out", "cellar"), "cellar", "hall, yard"),
        (train("out", "--hold-out", "hall,yard"), "--places", "held out"),
        (train("out", pairs=False), "--places", "at least 1"),
        (train("none/out"), "--out", "a folder"),
        (run("train", "--out", tmp_path / "out", "--pairs", tmp_path / "none.json"), "none.json", "list of pairs"),
    ]
    for result, *words in cases:
        assert result.exit_code == 2
        assert all(word in result.stderr for word in words), result.stderr
    assert not (tmp_path / "out").exists()


def test_a_checkpoint_of_another_kind_is_refused(train, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "checkpoint.pt").write_text("nothing")
    result = train("out")
    assert result.exit_code == 2
    assert "checkpoint of torchreg train" in result.stderr


def test_an_empty_folder_has_no_checkpoint(tmp_path):
    assert TrainingFolder(tmp_path / "out", {}).checkpoint() is None
