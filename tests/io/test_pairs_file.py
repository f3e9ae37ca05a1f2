"""Tables of pairs: every way to write one reads the same, and what cannot be meant is refused by its line."""

import csv
import io
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchreg.errors import CloudFileError
from torchreg.io import read_pairs_file, write_transform_text

T = np.eye(4)
T[:3] = [[0, -1, 0, 0.5], [1, 0, 0, -2], [0, 0, 1, 3e5]]
SIXTEEN = " ".join(map(repr, T.ravel().tolist()))
TABLE = f'source,target,truth,name,place\na.ply,b.ply,,,\nsub/c.pcd,a.ply,"{SIXTEEN}",third,a hall\n'

patient = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def made(tmp_path, content):
    path = tmp_path / "pairs.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def refused(path, root=None):
    """The message with which a table is refused, behind the name of the file."""
    with pytest.raises(CloudFileError) as caught:
        read_pairs_file(path, root)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "expected " in message
    assert ", got " in message
    return message.removeprefix(str(path))


def plain(rows):
    """What rows hold, but for the lines they stand in, in a form that compares."""
    return [
        (
            row.name,
            row.source,
            row.target,
            row.source_text,
            row.target_text,
            None if row.T_target_source is None else row.T_target_source.tolist(),
            row.extra,
        )
        for row in rows
    ]


def test_what_a_row_says(tmp_path):
    first, second = read_pairs_file(made(tmp_path, TABLE))
    assert (first.line, first.name, first.T_target_source, first.extra) == (2, "a__b", None, {})
    assert (first.source, first.target) == (tmp_path / "a.ply", tmp_path / "b.ply")
    assert (second.line, second.name, second.extra) == (3, "third", {"place": "a hall"})
    assert (second.source, second.source_text) == (tmp_path / "sub" / "c.pcd", "sub/c.pcd")
    assert second.T_target_source.dtype == torch.float64
    assert second.T_target_source.tolist() == T.tolist()


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace(",", ";"),
        lambda text: text.replace(",", "\t"),
        lambda text: text.removesuffix("\n"),
        lambda text: '\n# a comment, with "quotes"\n' + text.replace("\n", "\n\n  \n #x\n"),
        lambda text: text.replace(",", " , ").replace('"', ""),
        lambda text: text.replace("source,target,truth", "Source,TARGET,Truth"),
    ],
    ids=["mark", "crlf", "cr", "semicolon", "tab", "no last end", "comments", "spaces", "case"],
)
def test_ways_to_write_the_same(tmp_path, change):
    expected = plain(read_pairs_file(made(tmp_path, TABLE)))
    assert plain(read_pairs_file(made(tmp_path, change(TABLE)))) == expected


words = st.text(st.characters(codec="utf-8", exclude_characters="\0\r"), min_size=1, max_size=12)


@patient
@given(
    cells=st.lists(st.tuples(words, words, words), min_size=1, max_size=5),
    mark=st.sampled_from(",;\t"),
    quoting=st.sampled_from([csv.QUOTE_MINIMAL, csv.QUOTE_ALL]),
)
def test_what_the_csv_module_writes_comes_back(tmp_path, cells, mark, quoting):
    stripped = [tuple(cell.strip() for cell in row) for row in cells]
    pairs = [row[:2] for row in stripped]
    usable = all(source and target and not source.startswith("#") for source, target in pairs)
    if not usable or any("\0" in str(tmp_path / cell) for row in pairs for cell in row):
        return
    normal = {(str(Path(source)), str(Path(target))) for source, target in pairs}
    text = io.StringIO(newline="")
    writer = csv.writer(text, delimiter=mark, quoting=quoting)
    writer.writerows([("source", "target", "note"), *cells])
    path = tmp_path / "pairs.csv"
    path.write_text(text.getvalue(), encoding="utf-8", newline="")
    try:
        rows = read_pairs_file(path)
    except CloudFileError as error:
        assert "listed before" in str(error)  # noqa: PT017
        assert len(normal) < len(pairs) or any(".." in cell or "/" in cell for pair in pairs for cell in pair)
        return
    assert [(row.source_text, row.target_text, row.extra.get("note", "")) for row in rows] == stripped
    assert len({row.name for row in rows}) == len(rows)


@patient
@given(content=st.binary(max_size=200) | st.text('source,target\n\r;"# a.', max_size=60).map(str.encode))
def test_any_bytes_are_read_or_refused(tmp_path, content):
    path = made(tmp_path, content)
    try:
        assert read_pairs_file(path)
    except CloudFileError as error:
        assert str(error).startswith(str(path))  # noqa: PT017


def test_line_counts_what_an_editor_shows(tmp_path):
    path = made(tmp_path, '# one\n\nsource,target,note\r\na,b,"two\nlines, # no comment\n"\r\n\n#x\nb,c,\n')
    assert [(row.line, row.extra) for row in read_pairs_file(path)] == [
        (4, {"note": "two\nlines, # no comment"}),
        (9, {}),
    ]


@pytest.mark.parametrize("between", [" ", ", ", "; ", "\n"])
def test_truth_in_the_cell_or_in_a_file(tmp_path, between):
    (tmp_path / "truths").mkdir()
    write_transform_text(tmp_path / "truths" / "T.txt", torch.from_numpy(T))
    cells = [between.join(map(repr, T.ravel().tolist())), str(T.tolist()), "truths/T.txt"]
    table = "".join(f'a{i}.ply,b.ply,"{cell}"\n' for i, cell in enumerate(cells))
    rows = read_pairs_file(made(tmp_path, "source,target,truth\n" + table))
    assert [row.T_target_source.tolist() for row in rows] == [T.tolist()] * 3


def test_root_and_absolute_paths(tmp_path):
    path = made(tmp_path, "source,target\na.ply,/data/b.ply\n")
    root = tmp_path / "clouds"
    with pytest.raises(ValueError, match="root: expected a folder that exists, got "):
        read_pairs_file(path, root)
    root.mkdir()
    (row,) = read_pairs_file(path, root)
    assert (row.source, row.target) == (root / "a.ply", Path("/data/b.ply"))


def test_names_are_made_unique_in_the_order_of_the_rows(tmp_path):
    table = "source,target,name\ne,f,x__y__2\na/x.ply,y.ply,\nb/x.ply,y.ply,\ng,h,hall\n"
    names = [row.name for row in read_pairs_file(made(tmp_path, table))]
    assert names == ["x__y__2", "x__y", "x__y__3", "hall"]


def test_a_name_that_is_given_twice_is_refused(tmp_path):
    with pytest.raises(ValueError, match="line 3: expected a name that no pair before it has"):
        read_pairs_file(made(tmp_path, "source,target,name\na,b,hall\nc,d,hall\n"))


def test_both_directions_of_a_pair_are_two_pairs(tmp_path):
    assert len(read_pairs_file(made(tmp_path, "source,target\na,b\nb,a\n"))) == 2


def test_rows_go_through_pickle(tmp_path):
    rows = read_pairs_file(made(tmp_path, TABLE))
    assert plain(pickle.loads(pickle.dumps(rows))) == plain(rows)


HEAD = "source,target,truth,name\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", ": expected a file with content, got an empty one (0 bytes)"),
        ("\n\n# x\n", ": expected a header line, got nothing but blank lines and comments"),
        (HEAD, ": expected at least one pair below the header, got none"),
        ("a,b\nc,d\n", ", line 1: expected the columns source and target, got a, b"),
        ("#\nsource;goal\n", ", line 2: expected the columns source and target, got source, goal"),
        ("source,target,source\n", ", line 1: expected every column once, got 'source' 2 times"),
        ("source,target,x,X\n", ", line 1: expected every column once, got 'x' 2 times"),
        ("source,target,\n", ", line 1: expected a name for every column, got none for column 3"),
        (HEAD + "a,b,,\n\nc,d\n", ", line 4: expected 4 cells, as the header has, got 2"),
        (HEAD + "a,b,,,,\n", ", line 2: expected 4 cells, as the header has, got 6"),
        (HEAD + "a, ,,\n", ", line 2: expected a file in the column target, got an empty cell"),
        (HEAD + ",b,,\n", ", line 2: expected a file in the column source, got an empty cell"),
        (HEAD + "a,b,,\nc,d,,\na,./b,,\n", ", line 4: expected a pair not listed before, got a, ./b as in line 2"),
        (HEAD + "a,b,1 0 0 0,\n", ", line 2: expected a truth of sixteen numbers, got 4: '1 0 0 0'"),
        (HEAD + "a,b," + "1 " * 16 + ",\n", ", line 2: expected a truth that is a rigid transform, got truth: "),
        (HEAD + "a,b,none.txt,\n", "none.txt: expected a file, got nothing of this name"),
        (HEAD + "a,b,pairs.csv,\n", "4 lines of 4 numbers"),
        (HEAD + 'a,b,,"never closed\nc,d,,\n', ", line 2: expected cells without quotes or within a pair of them"),
        (HEAD + 'a,"b"c,,\n', ", line 2: expected cells without quotes or within a pair of them"),
        (HEAD.encode() + b"a,b,,\nc,d\0,,\n", ", line 3: expected text in UTF-8, got a NUL byte"),
        (HEAD.encode() + b"a,b,,\nc\xff,d,,\n", ", line 3: expected text in UTF-8, got the byte 0xff"),
        (HEAD.encode("utf-16"), ", line 1: expected text in UTF-8, got a NUL byte"),
    ],
)
def test_refused(tmp_path, content, message):
    assert message in refused(made(tmp_path, content))


def test_missing_and_folder(tmp_path):
    assert refused(tmp_path / "none.csv") == ": expected a file, got nothing of this name"
    assert refused(tmp_path) == ": expected a file, got a folder"
