"""What programs write beyond the letter of a format is read for what it plainly says, and notes say where not."""

import struct

import numpy as np
import pytest
from hand_made_files import PCD_ENCODINGS, PLY_ENCODINGS, named, write_pcd, write_ply
from unusual import COLORS, COLUMNS, PCD, PCD_LINES, POINTS, RGB, XYZ, assert_whole, changed, made, read


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
