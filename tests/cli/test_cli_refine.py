"""``--refine`` and ``--refine-points`` of ``register``, ``verify`` and ``batch``, and what they write."""

import json
from shutil import copy

import pytest
import torch
from projects import lines_of, write_table

import torchreg as tr
from torchreg.io import read_transform_text
from torchreg.io.result_json import plain_data

FIGURES = ("residual_median", "residual_rms", "residual_95", "covariance", "center", "axis_strength")


@pytest.fixture
def registered(run, room):
    def registered(*words):
        result = run("register", room.source, room.target, "--json", "-", "--truth", room.truth, *words)
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout, parse_constant=pytest.fail)

    return registered


@pytest.mark.parametrize("mode", ["none", pytest.param("coarse", marks=pytest.mark.slow), "full"])
def test_refine(registered, room, mode):
    found = registered("--refine", mode)
    assert found["options"]["refine"] == mode
    result = tr.register(tr.read_cloud(room.source), tr.read_cloud(room.target), refine=mode)
    assert found["T_target_source"] == plain_data(result.T_target_source[0])
    for name in FIGURES:
        assert (found[name] is None) == (mode == "none")
        assert mode == "none" or found[name] == plain_data(getattr(result, name)[0])
    assert {"surfels", "refinement"}.isdisjoint(found["seconds"]) == (mode == "none")


def test_refined_to_the_full_is_what_there_is_by_default_and_better(registered):
    default, full, none = registered(), registered("--refine", "full"), registered("--refine", "none")
    assert default["T_target_source"] == full["T_target_source"]
    assert full["truth"]["rmse_meters"] < 0.5 * none["truth"]["rmse_meters"]
    assert torch.tensor(full["covariance"]).shape == (6, 6)
    assert (len(full["center"]), len(full["axis_strength"])) == (3, 6)
    for words in (["--effort", "plain"], ["--preset", "paper", "--feature-radius", "0.6"]):
        assert registered(*words)["options"]["refine"] == "none"


@pytest.mark.slow
def test_refine_points(registered):
    few, many = registered("--refine-points", "300"), registered("--refine-points", "9000")
    assert (few["options"]["refine_points"], many["options"]["refine_points"]) == (300, 9000)
    assert few["T_target_source"] != many["T_target_source"]


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["--refine", "fine"], ["--refine", "none", "coarse", "full"]),
        (["--refine-points", "99"], ["--refine-points", "100"]),
    ],
)
def test_what_does_not_fit_is_refused(run, room, words, parts):
    result = run("register", room.source, room.target, *words)
    assert result.exit_code == 2
    for part in parts:
        assert part in result.stderr


def test_the_tables_tell_residuals_and_deviations(run, room):
    shown = run("register", room.source, room.target).stdout
    for part in ("residuals", "strength by axis"):
        assert part in shown
    assert "residuals" not in run("register", room.source, room.target, "--refine", "none").stdout


def test_verify(run, room):
    def verified(*words):
        result = run("verify", room.source, room.target, room.truth, "--json", "-", *words)
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout, parse_constant=pytest.fail)

    full, none = verified(), verified("--refine", "none")
    assert full["residual_median"] < full["residual_rms"] < full["residual_95"] < 0.05
    assert [none[name] for name in FIGURES[:3]] == [None] * 3
    assert full["search"]["options"]["refine"] == "full"
    assert none["search"]["options"]["refine"] == "none"


def test_a_batch_has_residuals_and_a_column_for_each_setting(run, room, tmp_path):
    rows = [
        {"name": mode, "source": copy(room.source, tmp_path / f"{mode}.ply"), "target": room.target, "refine": mode}
        for mode in ("full", "none", "coarse")
    ]
    rows[0]["refine_points"] = "2000"
    result = run("batch", write_table(tmp_path / "pairs.csv", rows), "--out", tmp_path / "out", "--workers", "0")
    assert result.exit_code == 0, result.output
    lines = {line["name"]: line for line in lines_of(tmp_path / "out")}
    records = {mode: json.loads((tmp_path / "out" / "pairs" / f"{mode}.json").read_text()) for mode in lines}
    for mode, line in lines.items():
        assert records[mode]["options"]["refine"] == mode
        for name in FIGURES[:3]:
            assert line[name] == ("" if mode == "none" else repr(records[mode][name]))
    assert records["full"]["options"]["refine_points"] == 2000
    truth = read_transform_text(room.truth)
    off = {
        mode: float((torch.tensor(record["T_target_source"]).double() - truth)[:3, 3].norm())
        for mode, record in records.items()
    }
    assert off["full"] < off["none"]


def test_a_batch_refines_by_default(run, room, tmp_path):
    table = write_table(tmp_path / "p.csv", [{"name": "a", "source": room.source, "target": room.target}])
    assert run("batch", table, "--out", tmp_path / "out", "--workers", "0", "--effort", "fast").exit_code == 0
    record = json.loads((tmp_path / "out" / "pairs" / "a.json").read_text())
    assert record["options"]["refine"] == "full"
    assert record["residual_median"] > 0
