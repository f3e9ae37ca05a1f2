"""A cloud whose file changed is noticed, however the change hides."""

import os

import pytest

from torchreg.batch import survey
from torchreg.batch.survey import _BLOCK, _PLACES, stamp_of


@pytest.fixture(params=[0, 1, 5000, _BLOCK, _PLACES * _BLOCK, _PLACES * _BLOCK + 1, 3 * _PLACES * _BLOCK + 77])
def file(request, tmp_path):
    """A file of so many bytes."""
    path = tmp_path / "a.ply"
    path.write_bytes(os.urandom(request.param))
    return path


def change(path, place):
    """Change one byte and set the time of modification back."""
    before, content = path.stat(), bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(bytes(content))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = path.stat()
    assert (after.st_size, after.st_mtime_ns) == (before.st_size, before.st_mtime_ns)


def test_a_file_that_stays_has_its_stamp(file):
    assert stamp_of(str(file)) == stamp_of(str(file))


def test_a_change_of_the_same_size_and_time_is_noticed(file):
    for place in {0, file.stat().st_size // 2, file.stat().st_size - 1} if file.stat().st_size else ():
        before = stamp_of(str(file))
        change(file, place)
        assert stamp_of(str(file)) != before


def test_the_content_counts_where_no_time_does(file):
    size = file.stat().st_size
    places = set(range(0, size, 997)) if size <= _PLACES * _BLOCK else {0, 1, size - _BLOCK, size - 1}
    for place in places:
        before = survey._content_digest(str(file), size)
        change(file, place)
        assert survey._content_digest(str(file), size) != before


def test_another_file_in_its_place_is_noticed(file, tmp_path):
    before, copy = stamp_of(str(file)), tmp_path / "copy.ply"
    copy.write_bytes(file.read_bytes())
    os.utime(copy, ns=(file.stat().st_atime_ns, file.stat().st_mtime_ns))
    os.replace(copy, file)
    assert stamp_of(str(file)) != before


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes of POSIX")
def test_what_is_no_file_has_a_stamp_and_keeps_nobody_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    assert stamp_of(str(tmp_path / "pipe.ply")) == stamp_of(str(tmp_path)) == "no file"
    assert stamp_of(str(tmp_path / "nothing.ply")) == "missing"
