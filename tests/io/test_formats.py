"""One row per format: reading, writing, messages and help follow from it."""

from pathlib import Path

import numpy as np
import pytest
import torch

from torchreg.errors import CloudFileError
from torchreg.io import CLOUD_SUFFIXES, read_cloud, read_cloud_report, read_scans, write_cloud
from torchreg.io import formats as formats_module
from torchreg.io.assemble import RawCloud
from torchreg.io.formats import FORMATS, READERS, WRITERS, CloudFormat, alternatives, formats_in_words
from torchreg.types import Clouds


def read_numbers(path: Path):
    """Scans of three numbers a line, a blank line between two of them."""
    for part in path.read_text().split("\n\n"):
        points = np.array([[float(word) for word in line.split()] for line in part.splitlines()])
        yield RawCloud(name=str(path), format="numbers", points=points)


def write_numbers(file, cloud, dtype):
    assert cloud.points.dtype == torch.float64
    np.savetxt(file, cloud.points.to(dtype).numpy())


@pytest.fixture
def numbers(monkeypatch):
    """One more row in the table, as it would stand there."""
    row = CloudFormat(suffixes=(".num", ".numbers"), words="numbers as text", read=read_numbers, write=write_numbers)
    monkeypatch.setattr(formats_module, "FORMATS", (*FORMATS, row))
    for suffix in row.suffixes:
        monkeypatch.setitem(READERS, suffix, row.read)
        monkeypatch.setitem(WRITERS, suffix, row.write)


@pytest.mark.parametrize("name", ["a.num", "a.NUMBERS"])
def test_a_row_more_is_a_format_more(numbers, tmp_path, name):
    cloud = Clouds(torch.rand(5, 3))
    write_cloud(tmp_path / name, cloud)
    report = read_cloud_report(tmp_path / name)
    assert torch.equal(report.cloud.points, cloud.points)
    assert (report.format, report.points_in_file, report.has_colors) == ("numbers", 5, False)
    assert ".num or .numbers (numbers as text)" in formats_in_words()
    (tmp_path / "a.cloud").write_text("cloud")
    with pytest.raises(CloudFileError, match=r"ends in .*\.num, \.numbers, got '\.cloud'"):
        read_cloud(tmp_path / "a.cloud")
    with pytest.raises(ValueError, match=r"ends in .* or \.numbers, got "):
        write_cloud(tmp_path / "a.cloud", cloud)


def test_a_file_of_several_scans_is_no_cloud(numbers, tmp_path):
    (tmp_path / "a.num").write_text("1 2 3\n4 5 6\n\n7 8 9\n")
    with pytest.raises(CloudFileError, match=r"a\.num: expected one scan, or scan= .*, got a file of 2 scans \(0, 1\)"):
        read_cloud(tmp_path / "a.num")
    assert read_cloud(tmp_path / "a.num", scan=1).points.tolist() == [[7, 8, 9]]
    assert [len(file.cloud.points) for file in read_scans(tmp_path / "a.num")] == [2, 1]
    for scan in (2, "2", "hall", -1):
        with pytest.raises(CloudFileError, match=r"expected a scan .*, got a file of 2 scans"):
            read_cloud(tmp_path / "a.num", scan=scan)
    with pytest.raises(ValueError, match=r"^scan: expected an integer or a string or None"):
        read_cloud(tmp_path / "a.num", scan=1.5)


@pytest.mark.parametrize("row", FORMATS, ids=lambda row: row.suffixes[0])
def test_every_row_is_whole(row):
    assert row.suffixes
    assert all(suffix == suffix.lower() and suffix.startswith(".") for suffix in row.suffixes)
    assert row.read or row.write
    assert set(row.suffixes) <= set(CLOUD_SUFFIXES) or row.read is None
    assert row.words in formats_in_words() or row.read is None


def test_suffixes_in_words():
    assert alternatives([".a"]) == ".a"
    assert alternatives([".a", ".b"]) == ".a or .b"
    assert alternatives([".a", ".b", ".c"]) == ".a, .b or .c"
