"""Lists of pairs as JSON read as tables do, and what cannot be meant is refused by its place."""

import csv
import json

import pytest
import torch
from test_pairs_file import SIXTEEN, T, plain

import torchreg as tr
from torchreg.batch import PairSettings, pairs_of_file
from torchreg.errors import CloudFileError
from torchreg.io import read_pairs_file

ENTRIES = [
    {"source": "a.ply", "target": "b.ply"},
    {"source": "sub/c.pcd", "target": "a.ply", "T": T.tolist(), "name": "third", "place": "a hall", "overlap": 0.25},
]


def written(tmp_path, content, name="pairs.json"):
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_a_list_reads_as_the_table_of_the_same_pairs(tmp_path):
    rows = read_pairs_file(written(tmp_path, {"convention": "x", "pairs": ENTRIES}))
    with (tmp_path / "pairs.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["source", "target", "truth", "name", "place", "overlap"])
        writer.writerow(["a.ply", "b.ply", "", "", "", ""])
        writer.writerow(["sub/c.pcd", "a.ply", SIXTEEN, "third", "a hall", "0.25"])
    assert plain(rows) == plain(read_pairs_file(tmp_path / "pairs.csv"))
    assert [row.line for row in rows] == [1, 2]
    assert rows[1].where == f"{tmp_path / 'pairs.json'}, pair 2"
    assert rows[1].extra == {"place": "a hall", "overlap": "0.25"}


def test_what_no_cell_can_hold_is_left_out(tmp_path):
    more = {"T": None, "check": {"a": 1}, "T_raw": [[1]], "note": None, "colour": True, "count": 3}
    (row,) = read_pairs_file(written(tmp_path, {"pairs": [ENTRIES[0] | more]}))
    assert row.extra == {"colour": "true", "count": "3"}
    assert row.T_target_source is None


@pytest.mark.parametrize("numbers", [T.tolist(), T.ravel().tolist()])
def test_a_truth_in_rows_or_in_one_counts_before_words_about_it(tmp_path, numbers):
    (row,) = read_pairs_file(written(tmp_path, {"pairs": [ENTRIES[0] | {"truth": "by hand", "T": numbers}]}))
    assert torch.equal(row.T_target_source, torch.from_numpy(T))


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("", "empty"),
        ("source,target\na,b\n", "JSON"),
        ("[" * 100_000, "JSON"),
        ([], "list under pairs"),
        ({"pairs": {}}, "list under pairs"),
        ({"pairs": []}, "at least one pair"),
        ({"pairs": [[]]}, "pair 1: expected an object"),
        ({"pairs": [{"source": "a"}]}, "pair 1: expected a file under target"),
        ({"pairs": [{"source": "a", "target": ["b"]}]}, "pair 1: expected a file in the column target"),
        ({"pairs": [ENTRIES[0], ENTRIES[0]]}, "as in pair 1"),
        ({"pairs": [ENTRIES[0] | {"T": [[1, 2], [3]]}]}, "pair 1, T: expected four rows"),
        ({"pairs": [ENTRIES[0] | {"T": [["1"] * 4] * 4}]}, "pair 1, T: expected four rows"),
        ({"pairs": [ENTRIES[0] | {"T": "file.txt"}]}, "pair 1, T: expected four rows"),
        ({"pairs": [ENTRIES[0] | {"T": [[2.0, 0, 0, 0]] * 4}]}, "pair 1: expected a truth that is a rigid"),
        ({"pairs": [ENTRIES[0] | {"T": [[10**400] * 4] * 4}]}, "pair 1: expected a truth that is a rigid"),
        ({"pairs": [ENTRIES[0] | {"T": [[float("nan")] * 4] * 4}]}, "pair 1: expected a truth that is a rigid"),
        ({"pairs": [ENTRIES[0] | {"": "x"}]}, "pair 1: expected a name for every value"),
        ({"pairs": [ENTRIES[0] | {"note": "\ud800"}]}, "pair 1, note: expected a text in Unicode"),
        ({"pairs": [ENTRIES[0] | {"name": "a\0b"}]}, "pair 1, name: expected a text in Unicode"),
    ],
)
def test_a_list_that_means_nothing_is_refused(tmp_path, content, named):
    path = written(tmp_path, content)
    with pytest.raises(CloudFileError) as caught:
        read_pairs_file(path)
    assert str(caught.value).startswith(str(path))
    assert named in str(caught.value)


def test_a_data_set_takes_a_list(tmp_path):
    for name in "ab":
        tr.write_cloud(tmp_path / f"{name}.ply", tr.Clouds(torch.rand(9, 3)))
    entry = ENTRIES[0] | {"T": T.tolist()}
    (pair,) = tr.datasets.ScanPairs(written(tmp_path, {"pairs": [entry]}))
    assert pair.T_target_source.dtype == torch.float64
    with pytest.raises(CloudFileError, match="pair 1: expected a target cloud that is there"):
        tr.datasets.ScanPairs(written(tmp_path, {"pairs": [entry | {"target": "c.ply"}]}))


def test_names_of_settings_change_a_pair_and_others_are_its_own(tmp_path):
    """A name that is nearly that of a setting is a slip in a table, and none in a list that a program wrote."""
    entry = ENTRIES[0] | {"voxel": 0.2, "no_color": True, "voxel_m": 0.1, "effort": "fast"}
    (pair,) = pairs_of_file(written(tmp_path, {"pairs": [entry]}), PairSettings())
    assert (pair.settings.voxel, pair.settings.no_color, pair.settings.effort) == (0.2, True, "fast")
    assert pair.extra == (("voxel_m", "0.1"),)
    with pytest.raises(ValueError, match="pair 1, column voxel: expected a number, got 'wide'"):
        pairs_of_file(written(tmp_path, {"pairs": [entry | {"voxel": "wide"}]}), PairSettings())
