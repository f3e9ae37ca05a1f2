"""Files and a runner for the command line."""

import os
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
from problems import room_pair
from typer.testing import CliRunner

import torchreg as tr
from torchreg.io import write_transform_text


class RoomFiles(NamedTuple):
    source: str
    target: str
    truth: str
    folder: str


@pytest.fixture(scope="session")
def room(tmp_path_factory):
    """Two scans of a room and their true transform, as files."""
    folder = tmp_path_factory.mktemp("room")
    pair = room_pair(6000, seed=1)
    tr.write_cloud(folder / "source.ply", pair.source)
    tr.write_cloud(folder / "target.ply", pair.target)
    write_transform_text(folder / "truth.txt", pair.T_target_source[0])
    return RoomFiles(*(str(folder / name) for name in ("source.ply", "target.ply", "truth.txt")), str(folder))


@pytest.fixture
def run(monkeypatch):
    """Run a command line in this process: ``run("info", path)`` gives exit_code, stdout and stderr."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("TORCHREG_DEBUG", raising=False)
    from torchreg.cli.app import app

    def run(*words):
        result = CliRunner().invoke(app, [os.fspath(word) for word in words], catch_exceptions=False)
        assert "Traceback" not in result.output
        return result

    return run


@pytest.fixture
def plain(tmp_path):
    """Copy a PLY file without its comments, so that it says nothing of its scanner, and return the path."""

    def copy(path):
        header, rows = Path(path).read_bytes().split(b"end_header\n", 1)
        lines = [line for line in header.splitlines(keepends=True) if not line.startswith(b"comment")]
        bare = tmp_path / f"plain_{Path(path).name}"
        bare.write_bytes(b"".join([*lines, b"end_header\n", rows]))
        return bare

    return copy


@pytest.fixture
def cloud_file(tmp_path):
    """Write points (and colors) to a PLY file of this name and return its path."""

    def write(name, points, colors=None, viewpoint=None):
        path = tmp_path / name
        points = torch.as_tensor(points, dtype=torch.float32)
        tr.write_cloud(path, tr.Clouds(points=points, colors=colors, viewpoint=viewpoint))
        return path

    return write
