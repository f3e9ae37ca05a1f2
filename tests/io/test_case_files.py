"""Files of common programs, rebuilt from public reports, beside the checkout: read as each says, or refused."""

from pathlib import Path

import pytest
import torch

from torchreg.errors import CloudFileError
from torchreg.io import read_cloud_report

FILES = Path(__file__).resolve().parents[3] / "shared" / "cases" / "files"
FIRST, FIRST_COLOR = (0.636962, 0.269787, 0.040974), (20, 76, 123)
COLORED = [
    "big_endian.ply",
    "bom_ascii.ply",
    "comments_in_body.ply",
    "count_plus.ply",
    "crlf_ascii.ply",
    "crlf_binary.ply",
    "diffuse.ply",
    "double_faces.ply",
    "extra_elements_after.ply",
    "face_first.ply",
    "faces0.ply",
    "float_colors_255.ply",
    "format_1.1.ply",
    "format_missing_space.ply",
    "mvs_lists.ply",
    "no_last_newline.ply",
    "pad_underscore.pcd",
    "rgb_count3.pcd",
    "rgb_f8.pcd",
    "rgb_f_ascii.pcd",
    "rgb_f_said_but_int_ascii.pcd",
    "rgb_i_ascii.pcd",
    "rgb_u_ascii.pcd",
    "rgba.ply",
    "rhino_cr_only.ply",
    "tabs.ply",
    "pdal_f8_rgb16.pcd",
    "trailing_space_header.ply",
    "two_vertex_blocks.ply",
    "upper_names.ply",
    "ushort_list_after.ply",
]
PLAIN = [
    "bom.pcd",
    "crlf.pcd",
    "crlf_binary.pcd",
    "decl_uint8_float_text.pcd",
    "extra_ws.pcd",
    "f_unknown_key.pcd",
    "gauss.ply",
    "greeb.ply",
    "hash_in_mid.pcd",
    "longdouble_ulong.ply",
    "lower_type.pcd",
    "nan_viewpoint.pcd",
    "scalar_rgb_cc.ply",
    "u1_above_255.pcd",
    "u8_u64.pcd",
    "v05.pcd",
    "vp3.pcd",
]
OTHERS = {  # first point, and how many
    **dict.fromkeys(["msvc_nan.pcd", "nan_ind.pcd", "nan_organized.pcd", "nan_words.ply"], ((0, 0, 0), 4)),
    **dict.fromkeys(
        ["half_float.ply", "int64.ply", "pos_names.ply", "vertices_name.ply", "int32_xyz.ply"], ((0, 0, 0), 6)
    ),
    "comma_decimal.ply": ((0.5, 0.1, 0.2), 6),
    "intensity_only.ply": ((0, 1, 2), 6),
    "pcd_doc_example.pcd": ((0.93773, 0.33763, 0), 213),
    "short_mm.ply": ((-1, 2, 1500), 6),
}
REFUSED = {  # headers and bodies that contradict each other: what such a file says is not plain
    "count0.pcd": "a COUNT of x",
    "count_sci.ply": "a whole number",
    "fewer_lines.pcd": "10 lines of points",
    "points_mismatch.pcd": "POINTS equal to WIDTH times HEIGHT",
    "truncated.ply": "6 points of 15 bytes",
}
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not FILES.is_dir(), reason=f"no files of other programs at {FILES}"),
]


def read(name):
    return read_cloud_report(FILES / name, dtype=torch.float64)


def test_every_file_is_judged():
    judged = [*COLORED, *PLAIN, *OTHERS, *REFUSED]
    assert sorted(judged) == sorted(path.name for path in FILES.iterdir())


@pytest.mark.parametrize("name", [*COLORED, *PLAIN])
def test_the_six_points_and_their_colors(name):
    report = read(name)
    assert report.points_in_file == len(report.cloud.points) == 6
    assert report.cloud.points[0].tolist() == pytest.approx(FIRST, abs=1e-6)
    assert report.has_colors == (name in COLORED)
    if report.has_colors:
        assert (report.cloud.colors[0] * 255).tolist() == pytest.approx(FIRST_COLOR, abs=1e-3)


@pytest.mark.parametrize("name", OTHERS)
def test_other_points(name):
    report = read(name)
    first, count = OTHERS[name]
    assert report.cloud.points[0].tolist() == pytest.approx(first)
    assert len(report.cloud.points) == count
    assert report.dropped_non_finite == (2 if "nan" in name else 0)


def test_the_packed_number_of_the_documentation():
    colors = (read("pcd_doc_example.pcd").cloud.colors * 255).round().long()
    assert [64, 64, 112] in colors.tolist()


@pytest.mark.parametrize(
    ("name", "word"), [("greeb.ply", "no green"), ("int32_xyz.ply", "every point has the same, 1 2 3")]
)
def test_left_out_colors_are_noted(name, word):
    assert word in read(name).notes[0]


@pytest.mark.parametrize("name", REFUSED)
def test_contradictions_are_refused(name):
    with pytest.raises(CloudFileError, match=REFUSED[name]):
        read(name)
