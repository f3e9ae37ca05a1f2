"""What a file holds arrives, whatever its encoding, types and names."""

import numpy as np
import pytest
import torch
from hand_made_files import PCD_ENCODINGS, PLY_ENCODINGS, named, pack_rgb, write_pcd, write_ply
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from torchreg.io import read_cloud, read_cloud_report

XYZ, RGB = ("x", "y", "z"), ("red", "green", "blue")
POINTS = np.array([[1.5, 2.25, 3.125], [4.0, -5.0, 6.0], [7.1, 8.2, 9.3]])
COLORS = np.array([[255, 128, 0], [1, 2, 3], [4, 5, 6]])

quick = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
rows = st.integers(1, 20)


@st.composite
def clouds(draw):
    """Points of float32 or float64 within 1 km, colors of a depth, and what they should become."""
    count = draw(rows)
    dtype = draw(st.sampled_from(["f4", "f8"]))
    points = draw(arrays(dtype, (count, 3), elements=st.floats(-999, 999, width=32)))
    depth, scale = draw(st.sampled_from([("u1", 255), ("u2", 65535), ("f4", 1)]))
    numbers = st.floats(0, 1, width=32) if scale == 1 else st.integers(0, scale)
    colors = draw(arrays(depth, (count, 3), elements=numbers))
    return points, colors, colors.astype(np.float64) / scale


def assert_colors(cloud, unit):
    """The colors arrive, or where several points have the same one, none do."""
    if len(unit) > 1 and (unit == unit[0]).all():
        assert cloud.colors is None
    else:
        np.testing.assert_array_equal(cloud.colors.numpy(), unit)


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
@quick
@given(cloud=clouds())
def test_ply_round_trip(tmp_path, encoding, cloud):
    points, colors, unit = cloud
    columns = named(XYZ, points, points.dtype) | named(RGB, colors, colors.dtype)
    path = write_ply(tmp_path / "a.ply", columns, encoding)
    report = read_cloud_report(path, dtype=torch.float64)
    np.testing.assert_array_equal(report.cloud.points.numpy() + report.cloud.origin.numpy(), points)
    assert_colors(report.cloud, unit)
    depth = {"u1": "uint8", "u2": "uint16", "f4": "float"}[colors.dtype.str[1:]]
    assert report.color_depth == (depth if report.has_colors else None)
    assert report.format == f"ply {encoding}"
    assert (report.points_in_file, report.dropped_non_finite) == (len(points), 0)


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
@pytest.mark.parametrize("names", [("r", "g", "b"), RGB])
@quick
@given(cloud=clouds())
def test_pcd_round_trip(tmp_path, encoding, names, cloud):
    points, colors, unit = cloud
    columns = named(XYZ, points, points.dtype) | named(names, colors, colors.dtype)
    path = write_pcd(tmp_path / "a.pcd", columns, encoding)
    cloud = read_cloud(path, dtype=torch.float64)
    np.testing.assert_array_equal(cloud.points.numpy() + cloud.origin.numpy(), points)
    assert_colors(cloud, unit)


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
@pytest.mark.parametrize("field", ["rgb", "rgba"])
@pytest.mark.parametrize("dtype", ["u4", "f4"])
def test_pcd_packed_colors(tmp_path, encoding, field, dtype):
    columns = named(XYZ, POINTS, "f4") | {field: pack_rgb(COLORS).view(dtype)}
    cloud = read_cloud(write_pcd(tmp_path / "a.pcd", columns, encoding), dtype=torch.float64)
    np.testing.assert_array_equal(cloud.colors.numpy(), COLORS / 255)


def test_packed_colors_lost_in_text_are_black_and_noted(tmp_path):
    columns = named(XYZ, POINTS, "f4") | {"rgb": pack_rgb(COLORS).view("f4")}
    columns["rgb"][1] = np.nan
    report = read_cloud_report(write_pcd(tmp_path / "a.pcd", columns, "ascii"))
    assert report.cloud.colors[1].tolist() == [0, 0, 0]
    assert "1 packed colors" in report.notes[0]


@pytest.mark.parametrize("names", [("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue")])
@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
def test_other_color_names(tmp_path, names, encoding):
    columns = named(XYZ, POINTS, "f4") | named(names, COLORS, "u2")
    cloud = read_cloud(write_ply(tmp_path / "a.ply", columns, encoding), dtype=torch.float64)
    np.testing.assert_array_equal(cloud.colors.numpy(), COLORS / 65535)


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
def test_mixed_coordinate_types_and_unknown_properties(tmp_path, encoding):
    columns = {
        "intensity": np.arange(3, dtype="u2"),
        "x": POINTS[:, 0].astype("f8"),
        "z": POINTS[:, 2].astype("f4"),
        "Y": np.array([2, -5, 8], dtype="i4"),
        "alpha": np.full(3, 7, dtype="u1"),
    }
    report = read_cloud_report(write_ply(tmp_path / "a.ply", columns, encoding))
    expected = np.stack([POINTS[:, 0], [2, -5, 8], POINTS[:, 2]], axis=1).astype("f4")
    np.testing.assert_array_equal(report.cloud.points.numpy(), expected)
    assert not report.has_colors
    assert report.color_depth is None


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
def test_mixed_coordinate_types_in_pcd(tmp_path, encoding):
    columns = {"x": POINTS[:, 0], "label": np.arange(3, dtype="u2"), "y": POINTS[:, 1].astype("f4")}
    columns["z"] = np.array([1, 2, 3], dtype="i2")
    cloud = read_cloud(write_pcd(tmp_path / "a.pcd", columns, encoding))
    np.testing.assert_array_equal(cloud.points.numpy()[:, :2], POINTS[:, :2].astype("f4"))
    assert cloud.points[:, 2].tolist() == [1, 2, 3]


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("ascii_text", [False, True])
def test_pcd_of_open3d(tmp_path, compressed, ascii_text):
    from torchreg.open3d_loader import load_open3d

    o3d = load_open3d()
    steps = np.arange(3000)
    points = np.stack([steps % 7, steps // 100, np.sin(steps)], axis=1).astype("f4")  # both runs and references
    colors = np.stack([steps % 256, steps // 12, steps * 0], axis=1).astype("u1")
    pcd = o3d.t.geometry.PointCloud(o3d.core.Tensor(points))
    pcd.point.colors = o3d.core.Tensor(colors)
    path = tmp_path / "a.pcd"
    o3d.t.io.write_point_cloud(str(path), pcd, write_ascii=ascii_text, compressed=compressed)
    report = read_cloud_report(path, dtype=torch.float64)
    assert report.format == "pcd " + ("ascii" if ascii_text else "binary_compressed" if compressed else "binary")
    atol = 1e-5 if ascii_text else 0  # Open3D writes text with few digits
    np.testing.assert_allclose(report.cloud.points.numpy(), points, atol=atol, rtol=0)
    np.testing.assert_array_equal(report.cloud.colors.numpy(), colors / 255)


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
def test_elements_around_the_vertices(tmp_path, encoding):
    path = write_ply(
        tmp_path / "a.ply",
        named(XYZ, POINTS, "f4"),
        encoding,
        before="comment of anyone\nelement camera 2\nproperty float f\nobj_info none",
        before_bytes=b"1.0\n2.0\n" if encoding == "ascii" else b"\0" * 8,
        extra="element face 0\nproperty list uchar int vertex_indices",
    )
    report = read_cloud_report(path)
    np.testing.assert_array_equal(report.cloud.points.numpy(), POINTS.astype("f4"))
    assert report.notes == ()


def test_text_with_crlf_blank_lines_and_without_a_last_line_end(tmp_path):
    path = write_ply(tmp_path / "a.ply", named(XYZ, POINTS, "f4"), "ascii")
    content = path.read_bytes().replace(b"end_header\n", b"end_header\n\n")
    path.write_bytes(content.replace(b"\n", b"\r\n").rstrip())
    np.testing.assert_array_equal(read_cloud(path).points.numpy(), POINTS.astype("f4"))


def test_pcd_without_count_points_or_viewpoint_and_with_wide_fields(tmp_path):
    header = "FIELDS x h y z\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 2\nHEIGHT 1\n"
    path = tmp_path / "a.pcd"
    old = "VERSION .6\nCOLUMNS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nDATA ascii\n"
    path.write_text(f"{old}1 2 3\n4 5 6\n")
    assert read_cloud(path).points.tolist() == [[1, 2, 3], [4, 5, 6]]
    path.write_text(f"{header}COUNT 1 2 1 1\nDATA ascii\n1 9 9 2 3\n4 9 9 5 6\n")
    assert read_cloud(path).points.tolist() == [[1, 2, 3], [4, 5, 6]]
    body = np.array([1, 9, 9, 2, 3, 4, 9, 9, 5, 6], dtype="<f4").tobytes()
    path.write_bytes(f"{header}COUNT 1 2 1 1\nDATA binary\n".encode() + body)
    assert read_cloud(path).points.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize("write", [write_ply, write_pcd])
@pytest.mark.parametrize("encoding", ["ascii", None])
def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path, write, encoding):
    points = np.concatenate([POINTS, POINTS]).astype("f4")
    points[1, 0], points[4, 2] = np.nan, np.inf
    columns = named(XYZ, points, "f4") | named(RGB, np.concatenate([COLORS, COLORS]), "u1")
    encoding = {"encoding": encoding} if encoding else {}
    path = write(tmp_path / ("a.ply" if write is write_ply else "a.pcd"), columns, **encoding)
    report = read_cloud_report(path, dtype=torch.float64)
    keep = [0, 2, 3, 5]
    assert (report.points_in_file, report.dropped_non_finite) == (6, 2)
    np.testing.assert_array_equal(report.cloud.points.numpy(), points[keep])
    expected = np.concatenate([COLORS, COLORS])[keep] / 255
    np.testing.assert_array_equal(report.cloud.colors.numpy(), expected)


@pytest.mark.parametrize("names", [("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")])
@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
def test_normals_get_length_one(tmp_path, names, encoding):
    normals = np.array([[0, 0, 2], [3, 4, 0], [-1, 0, 0]])
    columns = named(XYZ, POINTS, "f4") | named(names, normals, "f4")
    cloud = read_cloud(write_pcd(tmp_path / "a.pcd", columns, encoding))
    expected = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(cloud.normals.numpy(), expected, atol=1e-7)


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_normals_without_direction_are_left_out(tmp_path, bad):
    normals = np.array([[0, 0, 1], [bad, 0, 0], [0, 1, 0]])
    columns = named(XYZ, POINTS, "f4") | named(("nx", "ny", "nz"), normals, "f4")
    report = read_cloud_report(write_ply(tmp_path / "a.ply", columns))
    assert not report.has_normals
    assert report.cloud.normals is None
    assert report.notes == ("read without normals: 1 of 3 have no direction",)


def test_one_point_is_a_cloud(tmp_path):
    report = read_cloud_report(write_ply(tmp_path / "a.PLY", named(XYZ, POINTS[:1], "f4")))
    assert report.cloud.lengths == [1]
    assert report.extent == (0, 0, 0)


def test_npz_of_bare_arrays(tmp_path):
    points, colors = POINTS.astype("f4"), COLORS.astype("u1")
    np.savez_compressed(tmp_path / "a.npz", points=points, colors=colors, other=np.eye(2))
    report = read_cloud_report(tmp_path / "a.npz", dtype=torch.float64)
    np.testing.assert_array_equal(report.cloud.points.numpy(), POINTS.astype("f4"))
    np.testing.assert_array_equal(report.cloud.colors.numpy(), COLORS / 255)
    assert report.color_depth == "uint8"


def test_report_names_the_extent(tmp_path):
    report = read_cloud_report(write_ply(tmp_path / "a.ply", named(XYZ, POINTS, "f8")))
    assert report.extent == pytest.approx((5.6, 13.2, 6.175))
    assert report.path == str(tmp_path / "a.ply")


def test_arguments(tmp_path):
    path = write_ply(tmp_path / "a.ply", named(XYZ, POINTS, "f4"))
    with pytest.raises(ValueError, match=r"^dtype: expected .*float64, got torch.float16"):
        read_cloud(path, dtype=torch.float16)
    for viewpoint in ("scanner", (1, 2), (1, 2, float("nan"))):
        with pytest.raises(ValueError, match=r"^viewpoint: expected 'auto', 'origin', None or three finite"):
            read_cloud(path, viewpoint=viewpoint)
    for viewpoint in (5, ("a", "b", "c")):
        with pytest.raises(ValueError, match=r"^viewpoint: expected "):
            read_cloud(path, viewpoint=viewpoint)
