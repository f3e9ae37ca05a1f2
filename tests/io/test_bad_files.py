"""Every bad file is refused with its name, what was expected and what came."""

import os
import re
import struct

import numpy as np
import pytest
from hand_made_files import PCD_ENCODINGS, PLY_ENCODINGS, compressed, named, write_pcd, write_ply
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchreg.errors import CloudFileError
from torchreg.io import read_cloud

XYZ, RGB = ("x", "y", "z"), ("red", "green", "blue")
POINTS = np.arange(30.0).reshape(10, 3)
COLUMNS = named(XYZ, POINTS, "f4") | named(RGB, np.arange(30).reshape(10, 3), "u1")
PLY_HEAD = "ply\nformat ascii 1.0\nelement vertex 1\n"
PLY_XYZ = "property float x\nproperty float y\nproperty float z\n"
PCD = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3\n"

patient = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def refused(path):
    """The message with which a file is refused, checked for its form."""
    with pytest.raises(CloudFileError) as caught:
        read_cloud(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: expected ")
    assert ", got " in message
    assert "\x1b" not in message
    return message


def made(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def test_missing_folder_empty_and_unknown(tmp_path):
    assert refused(tmp_path / "a.ply").endswith("expected a file, got nothing of this name")
    (tmp_path / "b.ply").mkdir()
    assert refused(tmp_path / "b.ply").endswith("expected a file, got a folder")
    assert "empty" in refused(made(tmp_path, "c.ply", ""))
    assert "ends in .ply, .pcd, " in refused(made(tmp_path, "d.jpg", "JPEG"))
    assert "Autodesk ReCap's own: export" in refused(made(tmp_path, "d.RCP", "RCP"))
    if hasattr(os, "mkfifo"):  # not on Windows
        os.mkfifo(tmp_path / "e.ply")
        assert "a device or pipe" in refused(tmp_path / "e.ply")
    assert refused(tmp_path / ("x" * 300 + ".ply"))


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz"])
@pytest.mark.parametrize(
    "content",
    [
        b"\x89PNG\r\n\x1a\n" + bytes(200),
        b"ply",
        b"plyo\nformat ascii 1.0\n",
        b"\0" * 5000,
        b"PK\x03\x04" + bytes(100),
        b"1 2 3\n4 5 6\n",
        b"\n" * 100_000,
    ],
)
def test_wrong_bytes_behind_the_right_name(tmp_path, suffix, content):
    refused(made(tmp_path, f"a{suffix}", content))


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
@pytest.mark.parametrize("declared", [11, 10**6, 10**14])
def test_ply_that_declares_more_than_it_holds(tmp_path, encoding, declared):
    path = write_ply(tmp_path / "a.ply", COLUMNS, encoding, declared=declared)
    assert f"expected {declared} " in refused(path)


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
@pytest.mark.parametrize("declared", [11, 10**6, 10**14])
def test_pcd_that_declares_more_than_it_holds(tmp_path, encoding, declared):
    refused(write_pcd(tmp_path / "a.pcd", COLUMNS, encoding, declared=declared))


@pytest.mark.parametrize("declared", ["-1", "1e3", "0x10", "9" * 40, "nan"])
def test_counts_that_are_no_counts(tmp_path, declared):
    assert "whole number" in refused(write_ply(tmp_path / "a.ply", COLUMNS, declared=declared))
    assert "whole number" in refused(write_pcd(tmp_path / "a.pcd", COLUMNS, declared=declared))


def test_zero_points(tmp_path):
    none = named(XYZ, np.empty((0, 3)), "f4")
    assert "at least one vertex, got 0" in refused(write_ply(tmp_path / "a.ply", none))
    for encoding in PCD_ENCODINGS:
        assert "at least one point, got 0" in refused(write_pcd(tmp_path / "a.pcd", none, encoding))


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
def test_ply_without_coordinates(tmp_path, encoding):
    path = write_ply(tmp_path / "a.ply", named(RGB, POINTS, "u1"), encoding)
    assert "expected the properties x, y, z, got red, green, blue" in refused(path)


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
def test_pcd_without_coordinates(tmp_path, encoding):
    refused(write_pcd(tmp_path / "a.pcd", named(("x", "y"), POINTS[:, :2], "f4"), encoding))


@pytest.mark.parametrize("write", [write_ply, write_pcd])
def test_not_one_finite_point(tmp_path, write):
    path = write(tmp_path / f"a.{write.__name__[-3:]}", named(XYZ, np.full((2, 3), np.nan), "f4"))
    assert "at least one finite point" in refused(path)


def test_coordinates_that_no_survey_has(tmp_path):
    path = write_ply(tmp_path / "a.ply", named(XYZ, [[0, 0, 0], [0, 0, 1e300], [0, 0, 1]], "f8"))
    assert "expected coordinates up to 1e+12 m, got 1e+300" in refused(path)


@pytest.mark.parametrize("word", ["a", "1,5", "", "1 2"])
def test_text_that_is_no_row_of_numbers(tmp_path, word):
    path = write_ply(tmp_path / "a.ply", COLUMNS, "ascii")
    path.write_bytes(path.read_bytes().replace(b" 12 13 14", f" 12 {word} 14".encode()))
    refused(path)


@pytest.mark.parametrize("word", ["1.5", "nan", "40000"])
def test_coordinates_that_are_not_what_the_header_declares(tmp_path, word):
    path = write_ply(tmp_path / "a.ply", named(XYZ, POINTS, "i2"), "ascii")
    path.write_bytes(path.read_bytes().replace(b"\n12 13 14", f"\n12 {word} 14".encode()))
    assert f"expected y of type int16, as its header declares, got {word} at point 4" in refused(path)


@pytest.mark.parametrize(
    "header",
    [
        f"{PLY_HEAD}{PLY_XYZ}",
        f"ply\nelement vertex 1\n{PLY_XYZ}end_header\n1 2 3\n",
        f"{PLY_HEAD}{PLY_XYZ}property list uchar int ids\nend_header\n1 2 3 2 1\n",
        f"{PLY_HEAD}{PLY_XYZ}property list float int ids\nend_header\n1 2 3 1 1\n",
        f"{PLY_HEAD}format ascii 1.0\n{PLY_XYZ}end_header\n1 2 3\n",
        f"{PLY_HEAD}property quad x\n{PLY_XYZ}end_header\n1 2 3 4\n",
        f"{PLY_HEAD.replace('ascii', 'binary_middle_endian')}{PLY_XYZ}end_header\n1 2 3\n",
        f"{PLY_HEAD.replace('1.0', '2.0')}{PLY_XYZ}end_header\n1 2 3\n",
        f"{PLY_HEAD.replace('vertex', 'point')}{PLY_XYZ.replace('z', 'w')}end_header\n1 2 3\n",
        "ply\nformat ascii 1.0\n"
        + "element face 999999999999999\n" * 9300
        + f"element vertex 1\n{PLY_XYZ}end_header\n",
        f"ply\nformat ascii 1.0\n{PLY_XYZ}end_header\n1 2 3\n",
        f"{PLY_HEAD}end_header\n1 2 3\n",
        f"{PLY_HEAD}{PLY_XYZ}nonsense\nend_header\n1 2 3\n",
        "ply\nformat ascii 1.0\n" + "comment x\n" * 200_000,
        "ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uchar int ids\n"
        f"element vertex 1\n{PLY_XYZ}end_header\n" + "\3" * 16,
    ],
)
def test_ply_headers(tmp_path, header):
    refused(made(tmp_path, "a.ply", header))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("SIZE 4 4 4", "SIZE 4 4"),
        ("SIZE 4 4 4", "SIZE 4 4 3"),
        ("TYPE F F F", "TYPE F F Q"),
        ("COUNT 1 1 1", "COUNT 1 1 0"),
        ("COUNT 1 1 1", "COUNT 1 1 99999999"),
        ("POINTS 1", "POINTS 2"),
        ("WIDTH 1\nHEIGHT 1\nPOINTS 1\n", ""),
        ("HEIGHT 1", "HEIGHT 1\nHEIGHT 1"),
        ("DATA ascii", "DATA zip"),
        ("DATA ascii\n1 2 3\n", ""),
        ("FIELDS x y z\n", ""),
        ("FIELDS x y z", "FIELDS x y y"),
    ],
)
def test_pcd_headers(tmp_path, old, new):
    assert read_cloud(made(tmp_path, "a.pcd", PCD)).points.tolist() == [[1, 2, 3]]
    assert old in PCD
    refused(made(tmp_path, "a.pcd", PCD.replace(old, new)))


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
@pytest.mark.parametrize("fields", [511, 512, 513])
def test_pcd_records_whose_size_wraps_in_32_bits(tmp_path, encoding, fields):
    names = " ".join(["x", "y", "z", *["_"] * (fields - 3)])
    words = {"SIZE": "8", "TYPE": "F", "COUNT": str(1 << 20)}
    header = f"FIELDS {names}\n" + "".join(f"{key} {f'{word} ' * fields}\n" for key, word in words.items())
    path = made(tmp_path, "a.pcd", f"{header}WIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA {encoding}\n1 2 3\n" + "0" * 80)
    assert re.search(r"at most 1073741824 bytes, got|numbers in every line", refused(path))


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"\x01\x02",
        struct.pack("<II", 0, 150),
        struct.pack("<II", 155, 150) + b"\xff" * 155,
        struct.pack("<II", 4_000_000_000, 150) + b"\0" * 155,
        struct.pack("<II", 155, 4_000_000_000) + b"\0" * 155,
        compressed(COLUMNS)[:-1],
        compressed(COLUMNS)[:8] + b"\x20\xff" + compressed(COLUMNS)[10:],
        struct.pack("<II", 1, 150) + b"\x20",
        struct.pack("<II", 2, 150) + b"\xe0\x01",
    ],
)
def test_pcd_compressed_bodies(tmp_path, body):
    refused(write_pcd(tmp_path / "a.pcd", COLUMNS, "binary_compressed", body=body))


def npz(tmp_path, **arrays):
    np.savez(tmp_path / "a.npz", **arrays)
    return tmp_path / "a.npz"


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"pts": POINTS}, "expected an array 'points', got 'pts'"),
        ({"points": POINTS[:, :2]}, "points of shape (N, 3), N at least 1, got (10, 2)"),
        ({"points": POINTS[:0]}, "got (0, 3)"),
        ({"points": POINTS[0]}, "got (3,)"),
        ({"points": POINTS + 1j}, "points of real numbers, got complex128"),
        ({"points": POINTS.astype(str)}, "points of real numbers"),
        ({"points": POINTS.astype(object)}, "points of real numbers, got object"),
        ({"points": POINTS > 1}, "points of real numbers, got bool"),
        ({"points": POINTS, "colors": POINTS[:5]}, "colors of the shape of points, (10, 3), got (5, 3)"),
        ({"points": POINTS, "normals": POINTS[:, 0]}, "normals of the shape of points"),
        ({"points": POINTS, "origin": np.zeros(4)}, "origin of shape (3,), got (4,)"),
        ({"points": POINTS, "origin": np.full(3, np.nan)}, "a finite origin"),
        ({"points": POINTS, "viewpoint": np.zeros((2, 3))}, "viewpoint of shape (3,), got (2, 3)"),
        ({"points": POINTS, "viewpoint_known": np.array(1.0)}, "viewpoint_known of true or false, got float64"),
        ({"points": POINTS, "viewpoint_known": np.array([True] * 2)}, "viewpoint_known of shape (), got (2,)"),
    ],
)
def test_npz_arrays(tmp_path, arrays, message):
    assert message in refused(npz(tmp_path, **arrays))


def whole(tmp_path, kind):
    if kind == "npz":
        return npz(tmp_path, points=POINTS, colors=POINTS / 30)
    write = write_ply if kind in PLY_ENCODINGS[1:] else write_pcd
    return write(tmp_path / f"a.{write.__name__[-3:]}", COLUMNS, kind)


KINDS = [*PLY_ENCODINGS[1:], *PCD_ENCODINGS[1:], "npz"]


@pytest.mark.parametrize("kind", KINDS)
@patient
@given(data=st.data())
def test_a_binary_file_cut_anywhere_is_refused(tmp_path, kind, data):
    path = whole(tmp_path, kind)
    content = path.read_bytes()
    path.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    refused(path)


@pytest.mark.parametrize("kind", ["ascii", *KINDS])
@patient
@given(data=st.data())
def test_damaged_bytes_give_a_cloud_or_a_refusal(tmp_path, kind, data):
    path = whole(tmp_path, kind)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    message = ""
    try:
        assert len(read_cloud(path)) == 1
    except CloudFileError as error:
        message = str(error)
    assert message == "" or message.startswith(f"{path}: expected ")
