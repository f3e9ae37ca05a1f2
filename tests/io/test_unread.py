"""What a file holds beside what is read from it is named."""

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr
from made_e57 import write_e57
from test_round_trips import survey

from torchreg.io import PointFields, write_cloud
from torchreg.io.formats import READERS, UNREAD


def test_properties_and_elements_of_ply(tmp_path):
    path = tmp_path / "a.ply"
    write_cloud(path, survey())
    assert UNREAD[".ply"](path) == ()
    write_cloud(path, survey(), fields=PointFields(intensity=survey().points[:, 0]))
    assert UNREAD[".ply"](path) == ("left out, by property: intensity",)
    header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    path.write_text(header + "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n3 0 0 0\n")
    assert UNREAD[".ply"](path) == ("left out, by element: face",)


def test_fields_and_coordinate_system_of_e57(tmp_path):
    points = np.random.default_rng(0).normal(size=(10, 3))
    fields = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), points.T, strict=True))
    path = write_e57(tmp_path / "a.e57", [{"fields": fields}])
    assert UNREAD[".e57"](path) == ()
    write_e57(path, [{"fields": fields}, {"fields": {**fields, "rowIndex": np.arange(10), "timeStamp": np.ones(10)}}])
    assert UNREAD[".e57"](path) == ("left out, by field: rowIndex, timeStamp",)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_the_coordinate_system_of_las(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_cloud(path, survey())
    assert not any("coordinate system" in words for words in UNREAD[suffix](path))
    cloud = laspy.read(path)
    cloud.header.vlrs.append(WktCoordinateSystemVlr('PROJCS["somewhere"]'))
    cloud.write(path)
    assert "the coordinate system is left out" in UNREAD[suffix](path)


def test_every_row_with_more_can_be_read():
    assert set(UNREAD) <= set(READERS)
