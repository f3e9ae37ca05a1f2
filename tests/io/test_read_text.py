"""Text files of points: separators, headers, layouts, units, and what is refused."""

import numpy as np
import pytest
import torch

from torchreg.errors import CloudFileError
from torchreg.io import Reading, read_cloud, read_cloud_report

POINTS = [[1.5, -2.25, 3.125], [4.0, 5.5, -6.75], [7.0, 8.0, 9.5]]
COLORS = [[0, 128, 255], [10, 20, 30], [255, 0, 1]]


def made(folder, name, text, encoding="utf-8"):
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


def report(path, **options):
    return read_cloud_report(path, reading=Reading(dtype=torch.float64, **options))


def lines(separator=" ", *, decimal=".", columns=(POINTS, COLORS), end="\n"):
    rows = np.concatenate([np.array(one, dtype=object) for one in columns], axis=1)
    return end.join(separator.join(str(value).replace(".", decimal) for value in row) for row in rows) + end


@pytest.mark.parametrize("suffix", ["xyz", "txt", "csv", "asc", "pts", "XYZ"])
@pytest.mark.parametrize(
    "text",
    [
        lines(" "),
        lines("\t"),
        lines(","),
        lines(", "),
        lines(";"),
        lines("; "),
        lines(";", decimal=","),
        lines("\t", decimal=","),
        lines("  ", end=" \r\n"),
        lines(",", end=",\n"),
        lines(" ", end="\r"),
        "\ufeff" + lines(" "),
        "# a comment\n\n" + lines(" ") + "\n\n",
        "3\n" + lines(" "),
        "X;Y;Z;R;G;B\n" + lines(";"),
        "//X Y Z R G B\n" + lines(" "),
        '"x","y","z","red","green","blue"\n' + lines(","),
        "Easting\tNorthing\tElevation\tRed\tGreen\tBlue\n" + lines("\t"),
    ],
)
def test_every_separator_and_header_gives_the_same_cloud(tmp_path, suffix, text):
    file = report(made(tmp_path, f"a.{suffix}", text))
    assert file.cloud.points.tolist() == POINTS
    np.testing.assert_allclose(file.cloud.colors.numpy(), np.array(COLORS) / 255, rtol=0, atol=1e-15)
    assert (file.points_in_file, file.color_depth) == (3, "uint8")


def test_utf16_is_read(tmp_path):
    assert report(made(tmp_path, "a.txt", lines(" "), "utf-16")).cloud.points.tolist() == POINTS


def test_a_layout_that_was_guessed_is_said_and_one_that_is_named_is_not(tmp_path):
    path = made(tmp_path, "a.txt", lines(" "))
    assert report(path).notes == ("no header: columns are taken for x y z red green blue (columns= names others)",)
    assert report(path, columns="x y z red green blue").notes == ()
    assert report(made(tmp_path, "b.txt", "x y z r g b\n" + lines(" "))).notes == ()
    assert report(made(tmp_path, "c.txt", lines(" ", columns=(POINTS,)))).notes == ()


@pytest.mark.parametrize("columns", ["z _ x y red,green,blue", "z skip x y r g b", "z_xyrgb"])
def test_named_columns_are_taken_as_named(tmp_path, columns):
    path = made(tmp_path, "a.csv", "9,0,1,2,255,0,0\n8,0,3,4,0,255,0\n")
    cloud = read_cloud(path, columns=columns)
    assert cloud.points.tolist() == [[1, 2, 9], [3, 4, 8]]
    assert cloud.colors.tolist() == [[1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize("columns", ["x y", "x y z q", "x x y z", "", "xyzw"])
def test_columns_that_mean_nothing_are_refused(tmp_path, columns):
    with pytest.raises(CloudFileError, match=r"a\.csv: expected columns= of x, y, z"):
        read_cloud(made(tmp_path, "a.csv", "1,2,3,4\n"), columns=columns)


def test_named_columns_are_refused_by_formats_that_name_their_own(tmp_path):
    np.savez(tmp_path / "a.npz", points=np.zeros((2, 3)))
    with pytest.raises(CloudFileError, match="expected no columns="):
        read_cloud(tmp_path / "a.npz", columns="xyz")


@pytest.mark.parametrize(
    ("rest", "names"),
    [
        ([[0.5], [0.1], [0.2]], "x y z intensity"),
        ([[0, 0, 1], [0, 1, 0], [0.6, 0.8, 0]], "x y z nx ny nz"),
        ([[-1035, 1, 2, 3], [0.5, 4, 5, 6], [7, 8, 9, 255]], "x y z intensity red green blue"),
        ([[1, 2, 3, -1035], [4, 5, 6, 0.5], [7, 8, 9, 300]], "x y z red green blue intensity"),
        ([[1, 2, 3, 0, 0, 1], [4, 5, 6, 0, 1, 0], [7, 8, 9, 1, 0, 0]], "x y z red green blue nx ny nz"),
        ([[0, 0, 1, 1, 2, 3], [0, 1, 0, 4, 5, 6], [1, 0, 0, 7, 8, 9]], "x y z nx ny nz red green blue"),
        ([[0.5, 7.5], [1, 2], [3, 4]], "x y z"),
        ([[0.5, 7.5, -9], [1, 2, 3], [3, 4, 5]], "x y z"),
    ],
)
def test_layouts_of_files_without_a_header(tmp_path, rest, names):
    file = report(made(tmp_path, "a.txt", lines(" ", columns=(POINTS, rest))))
    assert file.notes[0].startswith(f"no header: columns are taken for {names}")
    assert file.cloud.points.tolist() == POINTS
    assert file.has_colors == ("red" in names)
    assert file.has_normals == ("nx" in names)
    if "intensity" in names:
        assert file.intensity.tolist() == [row[names.split().index("intensity") - 3] for row in rest]


def test_pts_has_its_intensity_before_the_colors_and_below_zero(tmp_path):
    text = "3\n1 2 3 120 1 2 3\n4 5 6 130 4 5 6\n7 8 9 200 7 8 9\n"
    file = report(made(tmp_path, "a.pts", text))
    assert file.intensity.tolist() == [120, 130, 200]
    assert (file.cloud.colors * 255).round().tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    assert report(made(tmp_path, "a.pts", text.replace("120", "-2048"))).intensity.tolist() == [-2048, 130, 200]


def test_pts_of_several_lists(tmp_path):
    file = report(made(tmp_path, "a.pts", "2\n1 2 3\n4 5 6\n1\n7 8 9\n"))
    assert file.cloud.points.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    assert "2 lists of points were joined" in file.notes


def test_control_characters_beside_a_count_do_no_harm(tmp_path):
    assert len(read_cloud(made(tmp_path, "a.pts", "1\x1e\n1 2 3\n")).points) == 1


def test_pts_that_is_cut_short_is_refused_and_one_that_is_longer_read(tmp_path):
    with pytest.raises(CloudFileError, match=r"a\.pts: expected 4 points, as it declares, got 2"):
        read_cloud(made(tmp_path, "a.pts", "4\n1 2 3\n4 5 6\n"))
    file = report(made(tmp_path, "a.pts", "1\n1 2 3\n4 5 6\n"))
    assert file.points_in_file == 2
    assert file.notes == ("the file declares 1 points and holds 2: all were read",)


def test_millimeters_are_meters_where_the_caller_or_the_header_says_so(tmp_path):
    path = made(tmp_path, "a.pts", "2\n1000 2000 3000\n4000 5000 6000\n")
    assert read_cloud(path, units="mm").points.tolist() == [[1, 2, 3], [4, 5, 6]]
    kept = read_cloud(path)
    assert (kept.points + kept.origin).tolist() == [[1000, 2000, 3000], [4000, 5000, 6000]]
    path = made(tmp_path, "a.csv", "X[mm],Y[mm],Z[mm]\n1000,2000,3000\n")
    assert read_cloud(path, units="file").points.tolist() == [[1, 2, 3]]
    file = report(path)
    assert file.unit == "mm"
    assert file.notes == ("the file says that its unit is mm; its numbers are kept: units='file' makes them meters",)
    assert "asked for" in report(path, units="ft").notes[0]
    with pytest.raises(ValueError, match="units: expected one of"):
        read_cloud(path, units="furlong")


def test_intensity_is_kept_and_becomes_gray_where_that_is_asked_for(tmp_path):
    text = "".join(f"{k} 0 0 {k}\n" for k in range(101))
    path = made(tmp_path, "a.txt", text)
    file = report(path)
    assert not file.has_colors
    assert file.intensity.tolist() == list(range(101))
    assert any("intensity=True" in note for note in file.notes)
    gray = report(path, intensity=True)
    assert gray.color_depth == "intensity"
    assert torch.equal(gray.cloud.colors[:, 0], gray.cloud.colors[:, 2])
    np.testing.assert_allclose(gray.cloud.colors[:, 0], np.clip((np.arange(101) - 2) / 96, 0, 1), rtol=0, atol=1e-12)
    assert any("from 2 to 98 is used as gray" in note for note in gray.notes)


@pytest.mark.parametrize("word", ["nan", "NaN", "-nan(ind)", "1.#QNAN", "-1.#IND", "inf"])
def test_rows_that_are_no_numbers_are_dropped(tmp_path, word):
    file = report(made(tmp_path, "a.xyz", f"1 2 3\n{word} 5 6\n7 8 9\n"))
    assert (file.points_in_file, file.dropped_non_finite) == (3, 1)
    assert file.cloud.points.tolist() == [[1, 2, 3], [7, 8, 9]]


def test_colors_that_are_all_black_are_none_and_those_out_of_range_cost_no_points(tmp_path):
    black = report(made(tmp_path, "a.txt", "x y z r g b\n1 2 3 0 0 0\n4 5 6 0 0 0\n"))
    assert not black.has_colors
    assert "all are 0 0 0" in black.notes[0]
    wild = report(made(tmp_path, "a.txt", "x y z r g b\n1 2 3 -1 0 70000\n4 5 6 0 0 0\n"))
    assert not wild.has_colors
    assert "-1 to 70000" in wild.notes[0]
    wide = report(made(tmp_path, "a.txt", "x y z r g b\n1 2 3 65535 0 0\n4 5 6 0 0 0\n"))
    assert wide.cloud.colors[0].tolist() == [1, 0, 0]
    floats = report(made(tmp_path, "a.txt", "x y z r g b\n1 2 3 0.5 0 0\n4 5 6 0 0 1\n"))
    assert floats.cloud.colors.tolist() == [[0.5, 0, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2\n3 4\n", "lines of numbers x y z"),
        ("a b c\n", "lines of numbers x y z"),
        ("2\nwater\nO 0 0 0\nH 0 0 1\n", "lines of numbers x y z"),
        ("1 2 3\n4 5\n", "as many numbers in every line"),
        ("1 2 3\n4 5 six\n", "as many numbers in every line"),
        ("1 2 3\n\0\0\0", "lines of text"),
        ("1" * 70000, "without an end of line"),
        ("x y z r\n", "lines of numbers"),
        ("x y z intensity\n1 2 3\n", "at least 4 columns"),
    ],
)
def test_what_is_no_list_of_points_is_refused(tmp_path, text, words):
    with pytest.raises(CloudFileError, match=r"a\.txt: expected .*, got ") as caught:
        read_cloud(made(tmp_path, "a.txt", text))
    assert words in str(caught.value)


def test_a_bad_line_is_named(tmp_path):
    text = "x y z\n" + "1 2 3\n" * 10 + "4 5 six\n"
    with pytest.raises(CloudFileError, match="at line 12"):
        read_cloud(made(tmp_path, "a.txt", text))


def test_words_in_columns_that_nobody_reads_do_no_harm(tmp_path):
    path = made(tmp_path, "a.csv", "label,x,y,z\ntree,1,2,3\nwall,4,5,6\n")
    assert read_cloud(path).points.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_chunks_make_no_difference(tmp_path, monkeypatch):
    draw = np.random.default_rng(0)
    points = draw.uniform(-5, 5, (1000, 3)).round(3)
    path = made(tmp_path, "a.pts", "1000\n" + "".join(f"{x} {y} {z}\n" for x, y, z in points))
    whole = report(path)
    monkeypatch.setattr("torchreg.io.text.CHUNK_ROWS", 64)
    assert torch.equal(report(path).cloud.points, whole.cloud.points)
    thinned = report(path, voxel=1.0)
    assert thinned.points_in_file == 1000
    assert 100 < len(thinned.cloud.points) < 1000
    assert thinned.voxel == 1.0
