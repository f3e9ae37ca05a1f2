"""A format that is not read is refused with what to do about it."""

import pytest

from torchreg.errors import CloudFileError
from torchreg.io import read_cloud
from torchreg.io.formats import READERS
from torchreg.io.unreadable import ADVICE

KINDS = [".rcp", ".rcs", ".fls", ".zfs", ".dwg", ".skp", ".obj", ".stl", ".gltf", ".potree", ".rxp", ".tzf", ".zip"]


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("spelling", [str.lower, str.upper])
def test_the_refusal_says_what_to_do(tmp_path, suffix, spelling):
    path = tmp_path / f"a{spelling(suffix)}"
    path.write_bytes(b"anything")
    with pytest.raises(CloudFileError) as caught:
        read_cloud(path)
    start = f"{path}: expected a name that ends in {', '.join(READERS)}, got '{spelling(suffix)}' ("
    assert str(caught.value).startswith(start)
    assert ADVICE[suffix] in str(caught.value)


def test_unknown_suffixes_get_no_advice(tmp_path):
    (tmp_path / "a.made_up").write_bytes(b"anything")
    with pytest.raises(CloudFileError, match=r"got '\.made_up'$"):
        read_cloud(tmp_path / "a.made_up")


@pytest.mark.parametrize("suffix", ADVICE)
def test_advice_is_for_files_that_are_not_read_and_fits_a_line(suffix):
    assert suffix not in READERS
    assert suffix == suffix.lower()
    assert suffix.startswith(".")
    assert len(ADVICE[suffix]) < 110
    assert any(word in ADVICE[suffix] for word in ("export", "save", "use", "unpack"))
