"""A small cloud as unusual files hold it, and the check that it arrives."""

import numpy as np
import torch
from hand_made_files import named

from torchreg.io import read_cloud_report

XYZ, RGB = ("x", "y", "z"), ("red", "green", "blue")
POINTS = np.array([[0.5, 0.25, 0.125], [4, -5, 6], [7, 8, 9], [1, 2, 4]])
COLORS = np.array([[20, 76, 123], [64, 64, 112], [1, 2, 3], [255, 0, 9]])
COLUMNS = named(XYZ, POINTS, "f4") | named(RGB, COLORS, "u1")
PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\nPOINTS 4\nDATA ascii\n"
PCD_LINES = "".join("{:g} {:g} {:g}\n".format(*point) for point in POINTS)


def read(path):
    return read_cloud_report(path, dtype=torch.float64)


def assert_whole(report, *, colors=True, notes=()):
    """All points, and all colors or none, are there, and these are the notes."""
    assert report.cloud.points.tolist() == POINTS.tolist()
    if colors:
        np.testing.assert_allclose(report.cloud.colors.numpy(), COLORS / 255, atol=1e-6)
    else:
        assert not report.has_colors
    assert len(report.notes) == len(notes), report.notes
    for note, start in zip(report.notes, notes, strict=True):
        assert note.startswith(start)


def changed(path, *pairs):
    """The file with bytes replaced, each of which must be there."""
    content = path.read_bytes()
    for old, new in pairs:
        assert old in content
        content = content.replace(old, new)
    path.write_bytes(content)
    return path


def made(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    return tmp_path / name
