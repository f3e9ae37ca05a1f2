"""Small real files of many formats, which are not part of this repository."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2].parent / "shared" / "data" / "formats"


def real_files(*suffixes):
    """The files that end so; a mark to skip, saying so, where the folder is absent."""
    files = sorted(path for path in FOLDER.glob("*") if path.suffix in suffixes) if FOLDER.is_dir() else []
    if not files:
        return [pytest.param(None, marks=[pytest.mark.real, pytest.mark.skip(reason=f"{FOLDER} is absent")], id="none")]
    return [pytest.param(path, marks=pytest.mark.real, id=path.name) for path in files]
