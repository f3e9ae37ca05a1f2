"""Colors that are packed, wide or misspelled: read for what they plainly say, else left out, and a note says so."""

import numpy as np
import pytest
from hand_made_files import PCD_ENCODINGS, compressed, named, pack_rgb, write_pcd, write_ply
from unusual import COLORS, COLUMNS, PCD, PCD_LINES, POINTS, RGB, XYZ, assert_whole, changed, made, read

from torchreg.io import read_cloud


def with_rgb(values):
    return named(XYZ, POINTS, "f4") | {"rgb": values}


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_packed_colors_written_as_their_number(tmp_path, encoding, dtype):
    path = write_pcd(tmp_path / "a.pcd", with_rgb(pack_rgb(COLORS).astype(dtype)), encoding)
    assert_whole(read(path), notes=["rgb holds whole numbers"])


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
def test_black_alone_among_packed_floats_is_black(tmp_path, encoding):
    bits = pack_rgb(np.concatenate([COLORS[:3], [[0, 0, 0]]])).view("f4")
    report = read(write_pcd(tmp_path / "a.pcd", with_rgb(bits), encoding))
    assert (report.cloud.colors[:, 2] * 255).round().tolist() == [123, 112, 3, 0]
    assert report.notes == ()


def test_the_rounded_number_of_the_documentation(tmp_path):
    head = PCD.replace("x y z", "x y z rgb").replace("4 4 4", "4 4 4 4").replace("F F F", "F F F F")
    lines = PCD_LINES.replace("\n", " 4.2108e+06\n").replace("4.2108e+06", "1", 1)
    report = read(made(tmp_path, "a.pcd", head.replace("COUNT 1 1 1", "COUNT 1 1 1 1") + lines))
    assert (report.cloud.colors[1:] * 255).round().tolist() == [[64, 64, 112]] * 3


@pytest.mark.parametrize("alpha", [0, 255])
@pytest.mark.parametrize("dtype", ["u4", "i4", "u8", "i8", "f8"])
def test_packed_numbers_with_and_without_alpha(tmp_path, alpha, dtype):
    numbers = pack_rgb(COLORS).astype("u8") | alpha << 24
    numbers = numbers.astype("u4").view("i4") if dtype == "i4" else numbers.astype(dtype)
    assert_whole(read(write_pcd(tmp_path / "a.pcd", with_rgb(numbers))), notes=["rgb holds"] * (dtype == "f8"))


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
def test_packed_colors_of_three_numbers(tmp_path, encoding):
    plain = write_pcd(tmp_path / "a.pcd", COLUMNS, encoding)
    old = [(b"x y z red green blue", b"x y z rgb"), (b"4 4 4 1 1 1", b"4 4 4 1"), (b"F F F U U U", b"F F F U")]
    path = changed(plain, *old, (b"COUNT 1 1 1 1 1 1", b"COUNT 1 1 1 3"))
    if encoding == "binary_compressed":  # the numbers of a field lie side by side there
        columns = named(XYZ, POINTS, "f4") | {"rgb": COLORS.astype("u1").reshape(-1)}
        head = path.read_bytes().split(b"compressed\n")[0] + b"compressed\n"
        path.write_bytes(head + compressed(columns))
    assert_whole(read(path))


@pytest.mark.parametrize(
    ("columns", "note"),
    [
        (COLUMNS | {"green": np.arange(4, dtype="u2")}, "read without colors: red, green, blue are of several types"),
        (named(XYZ, POINTS, "f4") | named(RGB, COLORS - 5, "f4"), "read without colors: expected floats"),
        (named(XYZ, POINTS, "f4") | named(RGB, COLORS * 1e30, "f4"), "read without colors: expected floats"),
        (named(XYZ, POINTS, "f4") | named(RGB, COLORS * 1000, "i4"), "read without colors: expected integers"),
        (
            named(XYZ, POINTS, "f4") | named(RGB, COLORS * 0 + 7, "u1"),
            "read without colors: every point has the same, 7 7",
        ),
        (
            named(XYZ, POINTS, "f4") | named(("red", "greeb", "blue"), COLORS, "u1"),
            "read without colors: there are red",
        ),
        (with_rgb(pack_rgb(COLORS).astype("u2")), "read without colors: rgb needs four bytes, it has 2"),
        (with_rgb(pack_rgb(COLORS) + 0.5), "read without colors: rgb holds 1.3303e+06"),
        (with_rgb(np.full(4, 1e300)), "read without colors: rgb holds 1e+300"),
    ],
)
@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
def test_colors_that_cannot_be_used_never_cost_the_points(tmp_path, columns, note, encoding):
    assert_whole(read(write_pcd(tmp_path / "a.pcd", columns, encoding)), colors=False, notes=[note])


def test_doubles_of_sixteen_bits_are_scaled_and_noted(tmp_path):
    columns = named(("X", "Y", "Z"), POINTS, "f8") | named(("Red", "Green", "Blue"), COLORS * 257, "f8")
    report = read(write_pcd(tmp_path / "a.pcd", columns))
    assert_whole(report, notes=["float colors up to 65535 were taken for 16-bit values"])


@pytest.mark.parametrize("word", ["300", "-1", "1.5", "nan"])
def test_text_that_is_not_the_integer_that_is_declared_costs_the_colors_alone(tmp_path, word):
    path = write_ply(tmp_path / "a.ply", COLUMNS | {"intensity": np.full(4, 250, "u1")}, "ascii")
    path = changed(path, (b" 123 ", f" {word} ".encode()), (b" 250\n", f" {word}\n".encode()))
    assert_whole(read(path), colors=False, notes=["read without colors: red, green, blue are of several types"])


def test_a_cloud_of_one_point_keeps_its_color(tmp_path):
    columns = named(XYZ, POINTS[:1], "f4") | named(RGB, COLORS[:1], "u1")
    assert read_cloud(write_ply(tmp_path / "a.ply", columns)).colors is not None
