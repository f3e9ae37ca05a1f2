"""Cells that no spreadsheet computes, and the texts that they stand for."""

import csv
import io

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchreg.io import read_pairs_file
from torchreg.io.csv_cells import cell_of_text, text_of_cell
from torchreg.io.poses_csv import write_poses_csv

SIGNS = "=+-@\t\r\n\uff1d\uff0b\uff0d\uff20"
TEXTS = st.text() | st.text("'=+-@1.e \t", max_size=6)


@given(TEXTS)
def test_a_cell_gives_its_text_back(text):
    assert text_of_cell(cell_of_text(text)) == text


@given(TEXTS)
def test_a_cell_begins_as_a_formula_only_where_it_is_a_number(text):
    cell = cell_of_text(text)
    if cell[:1] in tuple(SIGNS):
        assert float(cell) == float(text)


@given(TEXTS)
def test_a_text_that_is_no_formula_is_its_own_cell(text):
    if not text.lstrip("'").startswith(tuple(SIGNS)):
        assert cell_of_text(text) == text == text_of_cell(text)


@pytest.mark.parametrize("number", ["-1", "+2.5", "-.5e-3", "-1."])
def test_numbers_keep_their_signs(number):
    assert cell_of_text(number) == number


@pytest.mark.parametrize("text", ["=cmd|' /C calc'!A0", "-1+cmd", "+inf", "@SUM(A1)", "\t=1", "-\u0661"])
def test_formulas_get_an_apostrophe(text):
    assert cell_of_text(text) == f"'{text}"


def test_poses_name_scans_by_such_cells(tmp_path):
    names = ["=1+1", "'=1+1", "-3.5", "hall"]
    write_poses_csv(tmp_path / "p.csv", names, torch.full((4,), -1), torch.eye(4).double().expand(4, 4, 4))
    rows = list(csv.reader(io.StringIO((tmp_path / "p.csv").read_text())))[1:]
    assert [row[0] for row in rows] == ["'=1+1", "''=1+1", "-3.5", "hall"]
    assert [text_of_cell(row[0]) for row in rows] == names


def test_a_table_of_pairs_may_have_such_cells(tmp_path):
    (tmp_path / "pairs.csv").write_text("name,source,target,'=note\n'=x,'=a.ply,'b.ply,'@c\n")
    (row,) = read_pairs_file(tmp_path / "pairs.csv")
    assert (row.name, row.source_text, row.target_text, row.extra) == ("=x", "=a.ply", "'b.ply", {"=note": "@c"})
