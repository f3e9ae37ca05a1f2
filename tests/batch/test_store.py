"""The folder of a batch, damaged or set as a trap: what is wrong is named, what is lost is made again."""

import csv
import json
import os
import sqlite3

import pytest

from torchreg.batch import Bounds, Pair, PairSettings, Store, pairs_of_file, run
from torchreg.batch.local_engine import LocalEngine
from torchreg.batch.rows import Row, export
from torchreg.io.csv_cells import text_of_cell

TABLES = ("results.csv", "results.json", "results.parquet")
SHAPES = [
    None,
    5,
    2.5,
    "",
    "no json",
    "null",
    "[]",
    "{}",
    "7",
    '"text"',
    '[["a"]]',
    '{"a": 1}',
    b"\xff\xfe",
    "[" * 5000,
]
CELLS = [
    *(("pairs", column) for column in ("name", "state", "said", "digests", "line", "seconds", "record")),
    *(("clouds", column) for column in ("source", "asked", "stamp", "look")),
    *(("work", column) for column in ("stage", "seconds")),
]


def batch(project, out):
    """Run the batch of a project into a folder, in this process; returns what was done and what was damaged."""
    pairs = pairs_of_file(project.table, PairSettings(effort="fast", refine="none"))
    out.mkdir(exist_ok=True)
    (out.parent / "described").mkdir(exist_ok=True)
    with Store(out, {}) as store:
        done = run(pairs, store, LocalEngine(0), described=out.parent / "described", bounds=Bounds(15.0, None))
        store.mend_records(pairs)
        rows = store.finished()
        export(out, [rows[pair.name].line for pair in pairs], [rows[pair.name].seconds for pair in pairs])
        store.work()
        return done, store.damaged


@pytest.fixture(scope="module")
def whole(project, tmp_path_factory):
    """The folder of a batch that nobody touched."""
    out = tmp_path_factory.mktemp("whole") / "out"
    batch(project, out)
    return out


def copy_of(whole, folder):
    """A copy of it in a new folder."""
    (folder / "out" / "pairs").mkdir(parents=True)
    for path in [*whole.glob("[!.]*.*"), *(whole / "pairs").iterdir()]:
        (folder / "out" / path.relative_to(whole)).write_bytes(path.read_bytes())
    (folder / "described").symlink_to(whole.parent / "described")
    return folder / "out"


@pytest.fixture
def out(whole, tmp_path):
    """A copy of the folder that may be spoiled."""
    return copy_of(whole, tmp_path)


def spoil(out, table, column, value):
    """Put a value into one cell of the last row of a table, past the promises of its columns."""
    database = sqlite3.connect(out / "batch.sqlite")
    database.execute("PRAGMA writable_schema = ON")
    database.execute("UPDATE sqlite_master SET sql = replace(replace(sql, ' NOT NULL', ''), ' REAL', '')")
    database.commit()
    database.close()
    database = sqlite3.connect(out / "batch.sqlite")
    cell = "CAST(? AS TEXT)" if isinstance(value, bytes) else "?"
    last = f"rowid = (SELECT max(rowid) FROM {table})"
    database.execute(f"UPDATE {table} SET {column} = {cell} WHERE {last}", (value,))
    database.commit()
    database.close()


@pytest.mark.parametrize(("table", "column"), CELLS)
def test_a_cell_that_holds_anything_is_named_and_its_row_is_made_again(table, column, whole, tmp_path, project):
    for place, value in enumerate(SHAPES):
        out = copy_of(whole, tmp_path / str(place))
        spoil(out, table, column, value)
        if column == "said" and value in ("{}", '{"a": 1}'):  # the right shape, and another pair
            with pytest.raises(ValueError, match="expected what it was when it was finished"):
                batch(project, out)
            continue
        _, damaged = batch(project, out)
        for name in TABLES:
            assert (out / name).read_bytes() == (whole / name).read_bytes(), (value, name)
        assert sorted(os.listdir(out / "pairs")) == sorted(os.listdir(whole / "pairs"))
        assert len(damaged) == 1 or (not damaged and value is not None and not isinstance(value, bytes)), value
        for note in damaged:
            assert f"batch.sqlite, table {table}, " in note
            assert ": expected " in note
        again, left = batch(project, out)
        assert again == (6, 0, 0, 0, 0)
        stays = column in ("name", "source", "asked") or table == "work"  # nothing writes that row again
        assert left == [] or stays


def test_a_line_whose_value_has_another_type_is_made_again(whole, out, project):
    with sqlite3.connect(out / "batch.sqlite") as database:
        (text,) = database.execute("SELECT line FROM pairs WHERE rowid = 1").fetchone()
    line = json.loads(text)
    for name, value in [("fitness", "much"), ("success", 1), ("inliers", 2.5), ("T_target_source", [1, "2"]), ("x", 3)]:
        spoil(out, "pairs", "line", json.dumps(line | {name: value}))
        _, (note,) = batch(project, out)
        assert f"line, column {name}: expected a" in note or "line: expected the name" in note
        assert (out / "results.json").read_bytes() == (whole / "results.json").read_bytes()


def test_what_links_point_to_is_never_written(whole, out, project, tmp_path):
    """Links that somebody planted under names that a batch writes."""
    victim = tmp_path / "victim"
    victim.write_text("precious")
    names = [path.relative_to(out) for path in [*out.glob("*.csv"), *out.glob("results.*"), *(out / "pairs").iterdir()]]
    assert len(names) >= 10
    for name in names:
        (out / name).unlink()
        (out / name).symlink_to(victim)
    batch(project, out)
    assert victim.read_text() == "precious"
    for name in names:
        assert not (out / name).is_symlink(), name
        if name.name != "times.csv":
            assert (out / name).read_bytes() == (whole / name).read_bytes(), name


def test_a_link_with_the_right_content_is_replaced_too(whole, out, project, tmp_path):
    (file, *_) = (out / "pairs").iterdir()
    victim = tmp_path / "victim"
    victim.write_bytes(file.read_bytes())
    file.unlink()
    file.symlink_to(victim)
    batch(project, out)
    assert not file.is_symlink()


@pytest.mark.parametrize("name", [".lock", "run.json", "batch.sqlite", "pairs", "described"])
def test_a_link_in_place_of_what_a_batch_holds_open_is_refused(name, out, project, tmp_path):
    victim = tmp_path / "victim"
    victim.mkdir() if name in ("pairs", "described") else victim.write_text("{}")
    if (out / name).exists():
        (out / name).rename(tmp_path / "before")
    (out / name).symlink_to(victim)
    with pytest.raises(ValueError, match=rf"{name}: expected a file or folder of the run itself, got a link"):
        batch(project, out)
    assert victim.is_dir() or victim.read_text() == "{}"


def test_no_cell_is_a_formula_and_every_name_is_found_again(tmp_path):
    names = ["=cmd|' /C calc'!A0", "+1+1", "-2", "@x", "'=1", "hall"]
    pairs = [
        Pair(name=name, source=name, target="b", source_text=name, target_text="b", settings=PairSettings(),
             extra=(("=cost", name),))
        for name in names
    ]  # fmt: skip
    rows = [Row.failed(pair, "no such file", expected=True) for pair in pairs]
    (tmp_path / "out").mkdir()
    with Store(tmp_path / "out", {}) as store:
        for pair, row in zip(pairs, rows, strict=True):
            store.finish(pair, row, "")
        finished = store.finished()
        assert list(finished) == names
        assert store.damaged == []
    export(tmp_path, [finished[name].line for name in names], [{"matching": 1.0}] * len(names))
    for file in ("results.csv", "times.csv"):
        with (tmp_path / file).open(newline="") as table:
            header, *cells = csv.reader(table)
        assert [text_of_cell(row[0]) for row in cells] == names
        found = [cell for row in [header, *cells] for cell in row if cell.startswith(("=", "+", "-", "@"))]
        assert set(found) <= {"-2"}
    assert [line["name"] for line in json.loads((tmp_path / "results.json").read_text())] == names
