"""PTX: poses, no returns, no colors, several scans, and what is refused."""

import numpy as np
import pytest
import torch
from real_formats import real_files

from torchreg.errors import CloudFileError
from torchreg.io import Reading, read_cloud, read_cloud_report, read_scans

R = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
SEAT = np.array([512345.25, 5234567.5, 431.125])
POINTS = np.array([[1.5, 2.25, -3.5], [4, 5, 6], [-7, 8.5, 9], [1, 1, 1]])
COLORS = np.array([[0, 128, 255], [10, 20, 30], [255, 0, 1], [5, 5, 5]])


def scan(points=POINTS, colors=COLORS, T=None, seat=None, transposed=True, size=None, intensity=0.25):
    T = np.eye(4) if T is None else T
    seat = T[:3, 3] if seat is None else seat
    rows = np.concatenate([points, np.full((len(points), 1), intensity), *([] if colors is None else [colors])], axis=1)
    written = [seat, *T[:3, :3].T, *(T.T if transposed else T), *rows]
    body = [" ".join(f"{value:.9g}" if value % 1 else f"{value:.0f}" for value in row) for row in written]
    columns, lines = (len(points), 1) if size is None else size
    return "\n".join([str(columns), str(lines), *body]) + "\n"


def pose(shift=SEAT):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, shift
    return T


def made(folder, text):
    path = folder / "a.ptx"
    path.write_bytes(text.encode())
    return path


def report(path, **options):
    return read_cloud_report(path, reading=Reading(dtype=torch.float64, **options))


def whole(cloud):
    return cloud.points.numpy() + cloud.origin.numpy()


@pytest.mark.parametrize("transposed", [True, False])
def test_the_matrix_is_transposed_and_its_translation_is_the_scanner(tmp_path, transposed):
    file = report(made(tmp_path, scan(T=pose(), transposed=transposed)))
    np.testing.assert_allclose(whole(file.cloud), POINTS @ R.T + SEAT, rtol=0, atol=1e-9)
    np.testing.assert_allclose(file.pose.numpy(), pose(), rtol=0, atol=1e-12)
    assert (file.cloud.viewpoint + file.cloud.origin).tolist() == [SEAT.tolist()]
    assert file.cloud.viewpoint_known.tolist() == [True]
    assert any("not transposed" in note for note in file.notes) == (not transposed)
    np.testing.assert_allclose(file.cloud.colors.numpy(), COLORS / 255, rtol=0, atol=1e-12)


def test_a_position_beside_the_identity_is_known_and_zeros_are_assumed(tmp_path):
    file = report(made(tmp_path, scan(seat=np.array([1.0, 2, 3]))))
    assert file.cloud.viewpoint.tolist() == [[1, 2, 3]]
    assert file.cloud.viewpoint_known.tolist() == [True]
    file = report(made(tmp_path, scan()))
    assert file.cloud.points.tolist() == POINTS.tolist()
    assert file.cloud.viewpoint_known.tolist() == [False]
    file = report(made(tmp_path, scan(T=pose(), seat=SEAT + 2)))
    assert (file.cloud.viewpoint + file.cloud.origin).tolist() == [SEAT.tolist()]
    assert any("3.46 m from the translation" in note for note in file.notes)


def test_beams_without_a_return_are_left_out_before_they_are_moved(tmp_path):
    points = np.concatenate([POINTS, np.zeros((5, 3))])
    colors = np.concatenate([COLORS, np.zeros((5, 3), int)])
    file = report(made(tmp_path, scan(points, colors, T=pose(), size=(3, 3))))
    assert len(file.cloud.points) == 4
    assert (file.points_in_file, file.dropped_non_finite) == (9, 0)
    assert file.notes == ("5 rows are no points (no return, or marked as invalid) and were left out",)


def test_colors_of_zeros_are_none_and_four_numbers_have_none(tmp_path):
    for colors in (np.zeros((4, 3), int), None):
        file = report(made(tmp_path, scan(colors=colors, intensity=0.5).replace(" 0.5", " 0.75", 1)))
        assert not file.has_colors
        assert file.intensity.tolist() == [0.75, 0.5, 0.5, 0.5]


def test_scans_of_a_file_have_their_own_poses_and_colors(tmp_path):
    last = scan(POINTS[:3], COLORS[:3])
    path = made(tmp_path, scan(T=pose()) + scan(POINTS[:2], None, T=pose(np.array([1.0, 0, 0]))) + "\n\n" + last)
    scans = read_scans(path, dtype=torch.float64)
    assert [len(one.cloud.points) for one in scans] == [4, 2, 3]
    assert [one.has_colors for one in scans] == [True, False, True]
    np.testing.assert_allclose(whole(scans[1].cloud), POINTS[:2] @ R.T + [1, 0, 0], rtol=0, atol=1e-12)
    with pytest.raises(CloudFileError, match=r"scan= to choose one, got a file of 3 scans"):
        read_cloud(path)
    assert len(read_cloud(path, scan=1).points) == 2


@pytest.mark.parametrize("end", ["\r\n", "\n"])
def test_ends_of_lines_do_not_matter(tmp_path, end):
    path = made(tmp_path, (scan() + scan()).rstrip("\n").replace("\n", end))
    assert [one.cloud.points.tolist() for one in read_scans(path, dtype=torch.float64)] == 2 * [POINTS.tolist()]


def test_chunks_make_no_difference(tmp_path, monkeypatch):
    points = np.random.default_rng(0).uniform(-5, 5, (900, 3)).round(4)
    points[::7] = 0
    path = made(tmp_path, scan(points, None, T=pose(), size=(30, 30)) + scan())
    once = read_scans(path)
    monkeypatch.setattr("torchreg.io.ptx.CHUNK_ROWS", 13)
    monkeypatch.setattr("torchreg.io.ptx._BLOCK", 100)
    for one, other in zip(once, read_scans(path), strict=True):
        assert torch.equal(one.cloud.points, other.cloud.points)
        assert one.points_in_file == other.points_in_file


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("4\n1\n0 0 0\n", "a header of 10 lines"),
        (scan(size=(5, 1)), "5 rows in scan 0, as it declares, got 4"),
        (scan(size=(10**8, 10**7)), "rows in scan 0, as it declares, got 4"),
        (scan(size=(2, 1)), "a header of 10 lines before scan 1"),
        (scan(size=(2, 1)) + scan(), "number of columns of scan 1"),
        (scan(seat=np.array([1e200, 0, 0])), "lengths in meters"),
        (scan(T=2 * np.eye(4)), "a rigid 4x4 matrix"),
        (scan(T=np.diag([1.0, 1, -1, 1])), "a rigid 4x4 matrix"),
        (scan().replace("1 0 0 0", "1 0 one 0", 1), "4 numbers in a line of a PTX header"),
        (scan()[:-6] + "\n", "as many numbers|4 or 7 numbers"),
        ("x\n" + scan(), "number of columns of scan 0"),
        ("\n\n", "a PTX header of 10 lines"),
    ],
)
def test_what_is_no_ptx_is_refused(tmp_path, text, words):
    with pytest.raises(CloudFileError, match=rf"a\.ptx: expected .*({words})"):
        read_scans(made(tmp_path, text))


@pytest.mark.parametrize("path", real_files(".ptx", ".pts", ".xyz", ".txt"))
def test_real_text_files(path):
    scans = read_scans(path, dtype=torch.float64)
    if path.suffix in (".xyz", ".txt"):
        table = np.loadtxt(path, delimiter="," if path.suffix == ".txt" else None)
        np.testing.assert_allclose(whole(scans[0].cloud), table[:, :3], rtol=0, atol=1e-9)
    if path.suffix == ".pts":
        table = np.loadtxt(path, skiprows=1)
        np.testing.assert_allclose(whole(scans[0].cloud), table[:, :3], rtol=0, atol=1e-9)
        assert scans[0].has_colors == (table.shape[1] == 7)
    assert all(
        0 <= float(one.cloud.colors.min()) <= float(one.cloud.colors.max()) <= 1 for one in scans if one.has_colors
    )
