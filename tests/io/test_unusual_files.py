"""What programs write beyond the letter of a format is read for what it plainly says, and notes say where not."""

import struct

import numpy as np
import pytest
import torch
from hand_made_files import PCD_ENCODINGS, PLY_ENCODINGS, compressed, named, pack_rgb, write_pcd, write_ply

from torchreg.io import read_cloud, read_cloud_report

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


def with_line_ends(path, end, header_end=b"end_header\n"):
    head, body = path.read_bytes().split(header_end)
    path.write_bytes((head + header_end).replace(b"\n", end) + body)
    return path


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
@pytest.mark.parametrize("end", [b"\r", b"\r\n", b"\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_line_ends_and_byte_order_mark_of_ply(tmp_path, encoding, end, mark):
    columns = COLUMNS | {"x": POINTS[:, 0].astype("f4")}
    path = with_line_ends(write_ply(tmp_path / "a.ply", columns, encoding), end)
    path.write_bytes(mark + path.read_bytes())
    assert_whole(read(path))


def test_a_body_that_starts_like_a_line_end(tmp_path):
    first = struct.unpack("<f", b"\n\r\n\x40")[0]
    for end in (b"\r", b"\n", b"\r\n"):
        path = with_line_ends(write_ply(tmp_path / "a.ply", named(XYZ, [[first, 1, 2]], "f4")), end)
        assert read(path).cloud.points[0, 0].item() == first


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
@pytest.mark.parametrize("end", [b"\r", b"\r\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_line_ends_and_byte_order_mark_of_pcd(tmp_path, encoding, end, mark):
    path = write_pcd(tmp_path / "a.pcd", COLUMNS, encoding)
    with_line_ends(path, end, f"DATA {encoding}\n".encode())
    path.write_bytes(mark + path.read_bytes())
    assert_whole(read(path))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("TYPE F F F", "TYPE f f f"),
        ("DATA ascii", "DATA ASCII"),
        ("DATA ascii", "data Ascii"),
        ("WIDTH", "INTRINSICS 1 2 3\nWIDTH"),
        ("SIZE 4 4 4\n", ""),
        ("TYPE F F F\n", ""),
        ("SIZE 4 4 4\nTYPE F F F\n", ""),
        ("COUNT 1 1 1\n", ""),
        ("VERSION .7\n", ""),
    ],
)
def test_pcd_headers_as_pcl_reads_them(tmp_path, old, new):
    assert old in PCD
    assert_whole(read(made(tmp_path, "a.pcd", PCD.replace(old, new) + PCD_LINES)), colors=False)


@pytest.mark.parametrize("words", ["0 0 0", "a 0 0 1 0 0 0", "", "1 2 3 1"])
def test_a_viewpoint_that_is_none_is_ignored_and_noted(tmp_path, words):
    report = read(made(tmp_path, "a.pcd", PCD.replace("POINTS", f"VIEWPOINT {words}\nPOINTS") + PCD_LINES))
    assert_whole(report, colors=False, notes=["the header's VIEWPOINT is no seven numbers"])
    assert report.cloud.viewpoint_assumed.tolist() == [True]


@pytest.mark.parametrize("where", ["nan nan nan nan nan nan nan", "1e39 0 0 1 0 0 0", "0 -inf 0 1 0 0 0"])
def test_a_viewpoint_where_nothing_stands_is_not_known(tmp_path, where):
    pcd = read(made(tmp_path, "a.pcd", PCD.replace("POINTS", f"VIEWPOINT {where}\nPOINTS") + PCD_LINES))
    position = " ".join(where.split()[:3])
    path = write_ply(tmp_path / "a.ply", COLUMNS)
    ply = read(changed(path, (b"element", f"comment viewpoint {position}\nelement".encode())))
    np.savez(tmp_path / "a.npz", points=POINTS, viewpoint=[float(word) for word in position.split()])
    for report in (pcd, ply, read(tmp_path / "a.npz")):
        assert report.cloud.viewpoint is None
        assert report.viewpoint_source.startswith("none: ")


def lists(row, order):
    """Two lists, whose lengths differ from row to row."""
    count = row % 3 + 1
    return struct.pack(f"{order}B{count}I", count, *range(count)) + struct.pack(
        f"{order}H{count}d", count, *[1.5] * count
    )


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("place", ["after", "among"])
@pytest.mark.parametrize("equal", [True, False])
def test_lists_on_every_vertex_are_skipped(tmp_path, order, place, equal):
    encoding = f"binary_{'little' if order == '<' else 'big'}_endian"
    listed = "property list uchar uint ids\nproperty list ushort double weights\n"
    xyz, rgb = "".join(f"property float {x}\n" for x in XYZ), "".join(f"property uchar {c}\n" for c in RGB)
    head = f"ply\nformat {encoding} 1.0\nelement vertex 4\n"
    head += (xyz + rgb + listed if place == "after" else xyz + listed + rgb) + "end_header\n"
    body = b""
    for row, (point, color) in enumerate(zip(POINTS, COLORS, strict=True)):
        numbers = struct.pack(f"{order}3f", *point), lists(1 if equal else row, order), struct.pack("3B", *color)
        body += b"".join(numbers if place == "among" else (numbers[0], numbers[2], numbers[1]))
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    assert_whole(read(tmp_path / "a.ply"))
    (tmp_path / "a.ply").write_bytes(head.encode() + body[:-1])
    with pytest.raises(ValueError, match=r"a\.ply: expected 4 rows of the element 'vertex'"):
        read(tmp_path / "a.ply")


def test_lists_in_lines_of_text(tmp_path):
    columns = "".join(f"property float {x}\n" for x in XYZ) + "property list uchar int ids\n"
    columns += "".join(f"property uchar {c}\n" for c in RGB)
    rows = [
        f"{x} {y} {z} {k} {'9 ' * k}{r} {g} {b}"
        for k, ((x, y, z), (r, g, b)) in enumerate(zip(POINTS, COLORS, strict=True))
    ]
    head = f"ply\nformat ascii 1.0\nelement vertex 4\n{columns}end_header\n"
    assert_whole(read(made(tmp_path, "a.ply", head + "\n".join(rows))))


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
@pytest.mark.parametrize("lengths", [(3, 3, 3), (3, 4, 0), ()])
def test_lists_before_the_vertices(tmp_path, encoding, lengths):
    order = ">" if "big" in encoding else "<"
    if encoding == "ascii":
        faces = "".join(f"{n} {'1 ' * n}\n" for n in lengths).encode()
    else:
        faces = b"".join(struct.pack(f"{order}b{n}i", n, *[1] * n) for n in lengths)
    before = f"element face {len(lengths)}\nproperty list char int vertex_indices"
    assert_whole(read(write_ply(tmp_path / "a.ply", COLUMNS, encoding, before=before, before_bytes=faces)))


@pytest.mark.parametrize(("kind", "size"), [("b", -1), ("B", 200), ("q", 2**62), ("Q", 2**64 - 1)])
@pytest.mark.parametrize("rows", [1, 2])
def test_lists_of_a_length_that_is_none(tmp_path, kind, size, rows):
    word = {"b": "char", "B": "uchar", "q": "int64", "Q": "uint64"}[kind]
    faces = b"".join(struct.pack(f"<{kind}", n) for n in (0, size)[2 - rows :])
    before = f"element face {rows}\nproperty list {word} int ids\nproperty list {word} int more"
    faces += struct.pack(f"<{kind}", 0) * rows
    path = write_ply(tmp_path / "a.ply", COLUMNS, before=before, before_bytes=faces)
    with pytest.raises(ValueError, match=r"a\.ply: expected \d rows of the element '(face|vertex)'"):
        read(path)


NAN_WORDS = ["nan", "-nan", "-nan(ind)", "nan(snan)", "1.#QNAN", "-1.#IND", "-1.#IND00", "1.#INF", "inf", "1.#J"]


@pytest.mark.parametrize("word", NAN_WORDS)
@pytest.mark.parametrize("write", [write_ply, write_pcd])
def test_nan_in_all_spellings(tmp_path, word, write):
    columns = named(XYZ, np.concatenate([POINTS, [[77] * 3] * 2]), "f4")
    path = write(tmp_path / f"a.{write.__name__[-3:]}", columns, "ascii")
    report = read(changed(path, (b"77.0", word.encode())))
    assert_whole(report, colors=False)
    assert report.dropped_non_finite == 2


def test_decimal_commas_are_noted(tmp_path):
    path = made(tmp_path, "a.pcd", PCD + PCD_LINES.replace(".", ","))
    assert_whole(read(path), colors=False, notes=["commas in its numbers were read as decimal points"])


def test_commas_between_numbers_are_no_decimals(tmp_path):
    path = made(tmp_path, "a.pcd", PCD + PCD_LINES.replace(" ", ","))
    with pytest.raises(ValueError, match="3 numbers in every line"):
        read(path)


def test_comments_among_the_lines_of_points(tmp_path):
    path = write_ply(tmp_path / "a.ply", COLUMNS, "ascii")
    assert_whole(read(changed(path, (b"end_header\n", b"end_header\ncomment hi\n# there\n"))))


@pytest.mark.parametrize("word", ["int64", "uint64", "half"])
def test_types_beyond_the_standard(tmp_path, word):
    path = write_ply(tmp_path / "a.ply", COLUMNS | {"id": np.arange(4, dtype="f8")}, "ascii")
    assert_whole(read(changed(path, (b"double id", f"{word} id".encode()))))


def test_an_element_of_another_name_with_coordinates(tmp_path):
    path = write_ply(tmp_path / "a.ply", COLUMNS, before="element camera 0\nproperty float f")
    path = changed(path, (b"element vertex", b"element vertices"))
    assert_whole(read(path), notes=["no element 'vertex': the points are those of 'vertices'"])


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
