"""Every convention of the table is read by a parser of its own and gives the transform back, at coordinates of UTM."""

import json
import math
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from made_e57 import write_e57

from torchreg.io import TRANSFORM_FORMATS, read_scans, read_transform_text, write_transform_text

FAR = np.array([[500000.0, 5400000.0, 100.0], [500080.0, 5399950.0, 130.0], [0.0, 0.0, 0.0]])


def about(axis, angle):
    """Rotation about one axis: the two others turn from the next to the one after it."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = math.cos(angle)
    R[j, i], R[i, j] = math.sin(angle), -math.sin(angle)
    return R


def made(R, t):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def hamilton(p, q):
    """The product of two quaternions, real parts first."""
    w, v, a, u = p[0], np.array(p[1:]), q[0], np.array(q[1:])
    return [w * a - v @ u, *(w * u + a * v + np.cross(v, u))]


def rotation_of(w, x, y, z):
    """By the definition: each axis turned as q p q*."""
    columns = [hamilton(hamilton([w, x, y, z], [0.0, *axis]), [w, -x, -y, -z])[1:] for axis in np.eye(3)]
    return np.array(columns).T


def numbers(text):
    return [[float(word) for word in line.split()] for line in text.splitlines() if not line.startswith("#")]


def from_rows(text):
    return np.array(numbers(text))


def from_wxyz(text):
    q, t = numbers(text)
    return made(rotation_of(*q), t)


def from_xyzw(text):
    (x, y, z, w), t = numbers(text)
    return made(rotation_of(w, x, y, z), t)


def from_euler(text):
    (yaw, pitch, roll), t = numbers(text)
    return made(about(2, math.radians(yaw)) @ about(1, math.radians(pitch)) @ about(0, math.radians(roll)), t)


def from_e57(text):
    pose = ElementTree.fromstring(text)
    assert {node.get("type") for node in pose.iter() if len(node)} == {"Structure"}
    q, t = ([float(pose.find(f"{part}/{key}").text) for key in keys] for part, keys in PARTS)
    return made(rotation_of(*q), t)


PARTS = (("rotation", "wxyz"), ("translation", "xyz"))


def from_ptx(text):
    rows = numbers(text)
    assert [len(row) for row in rows] == [3, 3, 3, 3, 4, 4, 4, 4]
    T = np.array(rows[4:]).T
    np.testing.assert_array_equal(np.array(rows[1:4]).T, T[:3, :3])
    np.testing.assert_array_equal(rows[0], T[:3, 3])
    return T


def from_pdal(text):
    (stage,) = json.loads(text)
    assert stage["type"] == "filters.transformation"
    return np.array([float(word) for word in stage["matrix"].split()]).reshape(4, 4)


PARSERS = {
    **{"matrix": from_rows, "cloudcompare": from_rows, "ptx": from_ptx, "pdal": from_pdal, "e57": from_e57},
    **{"quaternion-wxyz": from_wxyz, "quaternion-xyzw": from_xyzw, "euler-zyx": from_euler},
}

angles = st.one_of(
    st.floats(-math.pi, math.pi), st.sampled_from([0, math.pi / 2, -math.pi / 2, math.pi, 1e-9, 1.5707963])
)
transforms = st.builds(
    lambda yaw, pitch, roll, *t: made(about(2, yaw) @ about(1, pitch) @ about(0, roll), t),
    *[angles] * 3,
    *[st.floats(-6e6, 6e6)] * 3,
)


def test_every_convention_has_a_parser():
    assert PARSERS.keys() == TRANSFORM_FORMATS.keys()


@pytest.mark.parametrize("name", TRANSFORM_FORMATS)
@settings(max_examples=100, deadline=None)
@given(T=transforms)
def test_a_convention_gives_the_transform_back(name, T):
    back = PARSERS[name](TRANSFORM_FORMATS[name](T))
    limit = 1e-5 if name == "cloudcompare" else 1e-7  # meters, at coordinates of UTM
    assert np.abs(FAR @ (back - T)[:3, :3].T + (back - T)[:3, 3]).max() < limit


def test_known_quarter_turns():
    """A quarter about z, then the translation: what the words mean, spelled out."""
    T = made([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3])
    h = math.sqrt(0.5)
    np.testing.assert_allclose(numbers(TRANSFORM_FORMATS["quaternion-wxyz"](T))[0], [h, 0, 0, h])
    np.testing.assert_allclose(numbers(TRANSFORM_FORMATS["quaternion-xyzw"](T))[0], [0, 0, h, h])
    np.testing.assert_allclose(numbers(TRANSFORM_FORMATS["euler-zyx"](T)), [[90, 0, 0], [1, 2, 3]])
    assert TRANSFORM_FORMATS["ptx"](T).splitlines()[4:] == ["0 1 0 0", "-1 0 0 0", "0 0 1 0", "1 2 3 1"]
    assert TRANSFORM_FORMATS["cloudcompare"](T).splitlines()[0].split()[1] == "-1.000000000000"


@pytest.mark.parametrize("name", TRANSFORM_FORMATS)
def test_files(tmp_path, name):
    T = torch.from_numpy(made(about(0, 0.3) @ about(1, -0.2), [1.5, 2, -3]))
    write_transform_text(tmp_path / "T.txt", T, form=name)
    np.testing.assert_allclose(PARSERS[name]((tmp_path / "T.txt").read_text()), T.numpy(), atol=1e-11)
    with pytest.raises(ValueError, match=r"^T: expected a rotation"):
        write_transform_text(tmp_path / "T.txt", T * torch.tensor([1, 1, -1, 1]), form=name)
    with pytest.raises(ValueError, match=r"^form: expected .*matrix.*, got 'euler'"):
        write_transform_text(tmp_path / "T.txt", T, form="euler")


def test_a_matrix_for_cloudcompare_is_read_back_here(tmp_path):
    T = torch.from_numpy(made(about(0, 0.3) @ about(1, -0.2), [1.5, 2, -3]))
    write_transform_text(tmp_path / "T.txt", T, form="cloudcompare")
    assert (read_transform_text(tmp_path / "T.txt") - T).abs().max() < 1e-11


def test_scans_with_these_poses_are_moved_by_them(tmp_path):
    """The readers of PTX and E57 understand what is written for them."""
    T = made(about(0, 0.3) @ about(1, -0.2) @ about(2, 2.5), [500000.25, 5400000.5, 100.125])
    local = np.random.default_rng(0).uniform(-9, 9, (20, 3))
    rows = "\n".join(" ".join(f"{value:.17g}" for value in (*point, 0.25)) for point in local)
    (tmp_path / "a.ptx").write_text(f"4\n5\n{TRANSFORM_FORMATS['ptx'](T)}{rows}\n")
    pose = ElementTree.fromstring(TRANSFORM_FORMATS["e57"](T))
    q, t = ([float(pose.find(f"{part}/{key}").text) for key in keys] for part, keys in PARTS)
    fields = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), local.T, strict=True))
    write_e57(tmp_path / "a.e57", [{"fields": fields, "rotation": q, "translation": t}])
    for name in ("a.ptx", "a.e57"):
        (file,) = read_scans(tmp_path / name, dtype=torch.float64)
        np.testing.assert_allclose(file.pose.numpy(), T, atol=1e-9)
        found = (file.cloud.points + file.cloud.origin).numpy()
        np.testing.assert_allclose(found, local @ T[:3, :3].T + T[:3, 3], atol=1e-7)
        np.testing.assert_allclose((file.cloud.viewpoint + file.cloud.origin)[0].numpy(), T[:3, 3], atol=1e-7)
