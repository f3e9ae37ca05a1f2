"""``torchreg bench paper``: quick runs from end to end, resumed and refused."""

import json
import re

import pytest

from torchreg.cli import app as app_module


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """One quick run of Experiment 2: its output and its folder."""
    from typer.testing import CliRunner

    folder = tmp_path_factory.mktemp("paper") / "out"
    words = ["bench", "paper", "--quick", "--experiment", "2", "--out", str(folder)]
    return CliRunner().invoke(app_module.app, words, catch_exceptions=False), folder


def test_a_quick_run_of_one_experiment(results):
    result, folder = results
    assert result.exit_code == 0, result.output
    names = {path.name for path in folder.iterdir()}
    assert names == {
        *("paper.md", "paper.json", "rows.jsonl", "table6.csv", "intervals.csv"),
        *("figure4_mall.png", "chart_experiment2.png", "differences.png"),
    }
    assert "12k / 4k" in result.stdout
    assert "paper.md" in result.stdout.replace("\n", "")
    text = (folder / "paper.md").read_text()
    assert "not comparable" in text
    for file in re.findall(r"\]\((\S+)\)", text):
        assert (folder / file).stat().st_size > 10_000


def test_json_says_what_the_numbers_depend_on(results):
    found = json.loads((results[1] / "paper.json").read_text(), parse_constant=pytest.fail)
    assert {"torch", "torchreg", "processor", "threads"} <= found["machine"].keys()
    assert found["run"]["quick"] is True
    assert found["run"]["experiments"] == [2]
    assert len(found["errors"]) == 3 * 2
    assert all(row["points"] == [3000, 1000] for row in found["errors"])


def test_a_finished_run_measures_nothing_again(results, run):
    _, folder = results
    rows, text = (folder / "rows.jsonl").read_bytes(), (folder / "table6.csv").read_bytes()
    (folder / "paper.md").unlink()
    result = run("bench", "paper", "--quick", "--experiment", "2", "--out", folder)
    assert result.exit_code == 0
    assert "mall-0" not in result.stderr
    assert (folder / "rows.jsonl").read_bytes() == rows
    assert (folder / "table6.csv").read_bytes() == text
    assert (folder / "paper.md").exists()


def test_a_killed_run_goes_on_and_ends_in_the_same_bytes(results, run, tmp_path):
    _, folder = results
    rows = (folder / "rows.jsonl").read_bytes()
    half = rows[: len(rows) // 2]
    assert 1 < half.count(b"\n") < rows.count(b"\n") - 1
    (tmp_path / "rows.jsonl").write_bytes(half)
    result = run("bench", "paper", "--quick", "--experiment", "2", "--out", tmp_path)
    assert result.exit_code == 0
    assert (tmp_path / "rows.jsonl").read_bytes() == rows
    for name in ("table6.csv", "intervals.csv", "paper.md"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name


def test_a_folder_of_another_run_is_refused(results, run):
    result = run("bench", "paper", "--quick", "--seed", "7", "--experiment", "2", "--out", results[1])
    assert result.exit_code == 2
    assert "--out: expected a folder without measurements, or with seed 7, got" in result.stderr


@pytest.mark.slow
def test_a_quick_run_of_everything(run, tmp_path):
    result = run("bench", "paper", "--quick", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    names = {path.name for path in tmp_path.iterdir()}
    assert {f"table{n}.csv" for n in (5, 6, 7, 8, 9)} < names
    assert {"figure3_mall.png", "figure4_mall.png", "figure5_mall.png", "figure6_road.png"} < names
    assert {"differences.png", *(f"chart_experiment{n}.png" for n in (1, 2, 3, 4, 5))} < names
    text = (tmp_path / "paper.md").read_text()
    for number in (5, 6, 7, 8, 9):
        assert f"## Table {number}" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--experiment", "6"], "'--experiment'"),
        (["--seeds", "0"], "'--seeds'"),
        (["--real", "nowhere"], "nowhere: expected a list of pairs"),
        (["--out", "nowhere/deep"], "--out: expected a folder"),
    ],
)
def test_bad_usage(run, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    result = run("bench", "paper", "--quick", *words)
    assert result.exit_code == 2
    assert said in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_names_the_exit_codes(run):
    shown = run("bench", "paper", "--help").stdout
    assert re.search(r"Exit code\W+0", shown)
    assert "meters" in shown
    assert "paper" in run("bench", "--help").stdout
