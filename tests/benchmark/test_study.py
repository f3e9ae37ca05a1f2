"""The one runner: rows are measured once, a cut-off run is resumed, and all files follow from the rows."""

import json

import pytest
from refusals import refuses

from torchreg.benchmark.core.study import Cell, Picture, Study, run_study
from torchreg.benchmark.core.tables import Table


def study(measured, *, fails=(), absent=(), **settings):
    """A study of three rows; ``measured`` notes which were measured."""

    def measure(key):
        if key in fails:
            raise KeyboardInterrupt
        measured.append(key)
        return {"value": len(key)}

    def cell(key):
        return Cell(key, f"the {key}", None if key in absent else lambda: measure(key))

    def draw(rows, folder):
        (folder / "a.png").write_bytes(b"a picture")
        yield Picture(1, "a.png", "a picture")

    return Study(
        name="made_up",
        cells=[cell(key) for key in ("a", "bb", "ccc")],
        settings=settings,
        run={"more": 1},
        document=lambda rows, pictures, machine: f"{len(rows)} rows, {pictures[0].file}, {machine}",
        csv=lambda rows: {"made_up.csv": "".join(f"{row['value']}\n" for row in rows)},
        draw=draw,
        shown=lambda rows: [Table("all", ["value"], [[str(row["value"])] for row in rows])],
        remarks=["a remark"],
    )


def test_a_run_writes_all_files_and_reports_its_progress(tmp_path):
    measured, reported = [], []
    rows = run_study(study(measured, seed=0), tmp_path / "out", reported.append)
    assert rows == [{"key": key, "value": len(key)} for key in ("a", "bb", "ccc")]
    assert reported == ["a remark", "1 of 3: the a", "2 of 3: the bb", "3 of 3: the ccc"]
    whole = json.loads((tmp_path / "out" / "made_up.json").read_text())
    assert whole["rows"] == rows
    assert whole["run"].items() >= {"seed": 0, "more": 1}.items()
    assert {"torchreg", "torch", "open3d"} < whole["run"].keys()
    assert (tmp_path / "out" / "made_up.md").read_text().startswith("3 rows, a.png, ")
    assert (tmp_path / "out" / "made_up.csv").read_text() == "1\n2\n3\n"


def test_a_cut_off_run_is_resumed_and_nothing_is_measured_twice(tmp_path):
    measured = []
    with pytest.raises(KeyboardInterrupt):
        run_study(study(measured, fails=("bb",)), tmp_path)
    assert not (tmp_path / "made_up.md").exists()
    run_study(study(measured), tmp_path)
    before = (tmp_path / "rows.jsonl").read_bytes()
    run_study(study(measured), tmp_path)
    assert measured == ["a", "bb", "ccc"]
    assert (tmp_path / "rows.jsonl").read_bytes() == before


def test_rows_of_other_settings_are_refused(tmp_path):
    run_study(study([], seed=0), tmp_path)
    with refuses("--out", "seed 1"):
        run_study(study([], seed=1), tmp_path)


def test_what_cannot_be_measured_here_is_left_out_unless_it_was_before(tmp_path):
    assert [row["key"] for row in run_study(study([], absent=("bb",)), tmp_path / "new")] == ["a", "ccc"]
    run_study(study([]), tmp_path / "old")
    assert len(run_study(study([], absent=("bb",)), tmp_path / "old")) == 3
