"""Measurements kept line by line: they survive a cut, and do not mix with those of another run."""

import pytest
from refusals import refuses

from torchreg.benchmark.core.rows import FILE, Rows
from torchreg.errors import CloudFileError


def test_rows_come_back_and_a_torn_last_line_is_dropped(tmp_path):
    rows = Rows(tmp_path, {"seed": 1})
    rows.add({"key": "a", "value": 1.5})
    rows.add({"key": "b", "value": 2.5})
    path = tmp_path / FILE
    path.write_bytes(path.read_bytes()[:-5])
    again = Rows(tmp_path, {"seed": 1})
    assert "a" in again
    assert "b" not in again
    again.add({"key": "b", "value": 3.5})
    assert Rows(tmp_path, {"seed": 1})["b"]["value"] == 3.5
    assert len(path.read_text().splitlines()) == 3


def test_rows_of_a_run_cut_off_in_its_first_line(tmp_path):
    (tmp_path / FILE).write_text('{"seed"')
    Rows(tmp_path, {"seed": 1}).add({"key": "a"})
    assert "a" in Rows(tmp_path, {"seed": 1})


def test_rows_of_another_run_are_refused(tmp_path):
    Rows(tmp_path, {"seed": 1, "quick": False})
    with refuses("--out", "quick True", "False"):
        Rows(tmp_path, {"seed": 1, "quick": True})


@pytest.mark.parametrize("content", ["hello\n", "[1]\n", '{"seed": 1}\n{"value": 2}\n'])
def test_a_file_that_holds_no_rows_is_left_alone(tmp_path, content):
    (tmp_path / FILE).write_text(content)
    with pytest.raises(CloudFileError, match="expected measurements"):
        Rows(tmp_path, {"seed": 1})
    assert (tmp_path / FILE).read_text() == content
