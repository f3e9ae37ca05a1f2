"""Settings of all pairs, and cells of one row in their place."""

import pytest
import torch
from refusals import refuses

import torchreg as tr
from torchreg.batch import Pair, PairSettings, pairs_of_glob
from torchreg.registration.overrides import OptionOverrides


def test_cells_take_the_place_of_their_setting():
    settings = PairSettings(seed=2, overrides=OptionOverrides(voxel=0.1))
    changed = settings.with_columns({"voxel": "0.2", "seed": "7", "no_color": "yes", "scene": "hall"}, "t.csv, line 3")
    assert changed.flat() == {**settings.flat(), "voxel": 0.2, "seed": 7, "no_color": True}
    assert settings.with_columns({}, "t.csv, line 3") == settings


@pytest.mark.parametrize(
    ("columns", "named"),
    [
        ({"voxel": "wide"}, "column voxel: expected a number"),
        ({"seed": "1.5"}, "column seed: expected a whole number"),
        ({"no_color": "perhaps"}, "column no_color: expected true or false"),
        ({"efort": "fast"}, "column efort"),
        ({"voxel": "-1"}, "voxel_size"),
        ({"confidence": "2"}, "confidence"),
        ({"solver": "luck"}, "solver"),
        ({"viewpoint": "1,2"}, "viewpoint"),
        ({"seed": "-1"}, "seed"),
    ],
)
def test_cells_that_mean_nothing_are_refused_with_their_line(columns, named):
    with pytest.raises(ValueError, match=r"^t\.csv, line 3") as caught:
        PairSettings().with_columns(columns, "t.csv, line 3")
    assert named in str(caught.value)


@pytest.mark.parametrize(
    "bad", [{"preset": "best"}, {"effort": "huge"}, {"points": 0}, {"seed": -1}, {"viewpoint": "there"}]
)
def test_settings_that_mean_nothing_are_refused(bad):
    with refuses(next(iter(bad))):
        PairSettings(**bad)


def pair(name):
    return Pair(name=name, source="a", target="b", source_text="a", target_text="b", settings=PairSettings())


def test_names_of_files_differ_whatever_the_pairs_are_called():
    names = ["a__b", "a/b", "a_b-82badf67", "a\\b", "a b", "a_b", "..", "." * 200, "é" * 300, "é" * 301, "-", ""]
    files = [pair(name).file_name for name in names]
    assert len(set(files)) == len(names)
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
