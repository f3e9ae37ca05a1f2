"""The pairs of a batch: their names, and those of a pattern."""

import unicodedata

import torch

import torchreg as tr
from torchreg.batch import Pair, PairSettings, pairs_of_glob


def pair(name):
    return Pair(name=name, source="a", target="b", source_text="a", target_text="b", settings=PairSettings())


def test_names_of_files_differ_whatever_the_pairs_are_called():
    names = ["a__b", "a/b", "a\\b", "a b", "a_b", "..", "." * 200, "é" * 300, "é" * 301, "-", ""]
    names += ["a__B", "A__B", "e\u0301", "\u00e9", "K", "\u212a", "k", "ß", "ss", "nul", "Nul", "com1.x"]
    names.append(pair("a/b").file_name)
    files = [pair(name).file_name for name in names]
    folded = [unicodedata.normalize("NFKC", file).casefold() for file in files]
    assert len(set(folded)) == len(names)
    assert not {"", "nul", "com1.x"} & set(folded)
    assert files[0] == "a__b"
    assert all("/" not in file and not file.startswith(".") and len(file) < 140 for file in files)


def test_all_pairs_of_a_pattern_are_named_so_that_they_differ(tmp_path):
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        for name in ("a.ply", "b.ply"):
            tr.write_cloud(tmp_path / folder / name, tr.Clouds(points=torch.rand(5, 3)))
    pairs = pairs_of_glob(str(tmp_path / "*" / "*.ply"), PairSettings())
    assert len(pairs) == 6
    assert len({one.name for one in pairs}) == 6
    flat = pairs_of_glob(str(tmp_path / "x" / "*.ply"), PairSettings())
    assert [one.name for one in flat] == ["a__b"]
