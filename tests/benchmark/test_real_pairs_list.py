"""Lists of real pairs: what they give, and what is refused."""

import json

import pytest
import torch
from real_folders import project
from refusals import refuses

from torchreg.benchmark.core.real_pairs import read_real_pairs


@pytest.fixture
def data(tmp_path):
    (tmp_path / "data").mkdir()
    return project(tmp_path / "data")


def test_a_list_by_its_folder_or_its_file(data):
    listed = json.loads((data / "pairs.json").read_text())["pairs"]
    for path in (data, data / "pairs.json"):
        pairs = read_real_pairs(path)
        assert [pair.name for pair in pairs] == [entry["name"] for entry in listed]
        assert all(pair.source.is_file() and pair.target.is_file() for pair in pairs)
        assert torch.equal(pairs[1].T_target_source, torch.tensor(listed[1]["T"], dtype=torch.float64))


def test_lists_that_cannot_be_read(tmp_path, data):
    with refuses(str(tmp_path / "pairs.json"), "a list of pairs"):
        read_real_pairs(tmp_path)
    path = data / "pairs.json"
    whole = json.loads(path.read_text())
    for change, words in (
        (lambda p: p.pop("voxel_m"), "voxel_m"),
        (lambda p: p.update(T=[[1]]), "T"),
        (lambda p: p.update(name="pair_1"), "'pair_1' twice"),
    ):
        broken = json.loads(json.dumps(whole))
        change(broken["pairs"][0])
        path.write_text(json.dumps(broken))
        with refuses(str(path), words):
            read_real_pairs(data)
    path.write_text(json.dumps({"pairs": []}))
    with refuses(str(path), "got none"):
        read_real_pairs(path)
