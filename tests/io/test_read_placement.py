"""Origins of large coordinates, and where the scanner stood."""

import numpy as np
import pytest
import torch
from hand_made_files import PCD_ENCODINGS, PLY_ENCODINGS, named, write_pcd, write_ply
from hypothesis import given, settings
from hypothesis import strategies as st

from torchreg.io import read_cloud, read_cloud_report
from torchreg.io.placement import choose_origin

XYZ = ("x", "y", "z")
UTM = np.array([512345.0, 5234567.0, 431.0])


def local(count=200, seed=0, size=8.0):
    return np.random.default_rng(seed).uniform(-size, size, (count, 3))


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
def test_utm_coordinates_in_ply_keep_a_micrometer(tmp_path, encoding):
    points = local() + UTM
    cloud = read_cloud(write_ply(tmp_path / "a.ply", named(XYZ, points, "f8"), encoding))
    assert cloud.points.dtype == torch.float32
    assert np.abs(cloud.points.double().numpy() + cloud.origin.numpy() - points).max() < 1e-6
    assert cloud.viewpoint is None


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
def test_utm_coordinates_in_pcd_keep_a_micrometer(tmp_path, encoding):
    points = local() + UTM
    cloud = read_cloud(write_pcd(tmp_path / "a.pcd", named(XYZ, points, "f8"), encoding))
    assert np.abs(cloud.points.double().numpy() + cloud.origin.numpy() - points).max() < 1e-6


def test_origin_is_whole_meters_and_zero_for_ordinary_scans():
    assert choose_origin(local() + UTM).tolist() == np.round(np.median(local() + UTM, axis=0)).tolist()
    assert choose_origin(local(size=999)).tolist() == [0, 0, 0]


@settings(max_examples=50, deadline=None)
@given(st.floats(-1e7, 1e7), st.integers(0, 99))
def test_few_wild_points_do_not_move_the_origin(shift, wild):
    points = local(201) + shift
    moved = points.copy()
    moved[wild] = 1e30
    assert np.abs(choose_origin(moved) - choose_origin(points)).max() <= 16 or abs(shift) < 1100


def plain_file(folder, kind):
    """A file that says nothing of its scanner."""
    path = folder / f"a{kind}"
    if kind == ".npz":
        np.savez(path, points=local())
        return path
    return {".ply": write_ply, ".pcd": write_pcd}[kind](path, named(XYZ, local(), "f4"))


@pytest.mark.parametrize("kind", [".ply", ".pcd", ".npz"])
def test_the_zero_of_an_ordinary_scan_is_assumed_and_known_where_it_is_asked_for(tmp_path, kind):
    path = plain_file(tmp_path, kind)
    for viewpoint, ends in (("auto", "assumed"), ("origin", "as asked for")):
        report = read_cloud_report(path, viewpoint=viewpoint)
        assert report.cloud.viewpoint.tolist() == [[0, 0, 0]]
        assert report.cloud.viewpoint_known.tolist() == [viewpoint == "origin"]
        assert report.cloud.viewpoint_assumed.tolist() == [viewpoint == "auto"]
        assert report.viewpoint_source == f"the origin of the file's frame, {ends}"
    assert read_cloud(path, viewpoint=(1, 2, 3)).viewpoint_known.tolist() == [True]
    assert read_cloud(path, viewpoint=None).viewpoint_known.tolist() == [False]


@pytest.mark.parametrize("kind", [".ply", ".pcd", ".npz"])
def test_what_the_file_says_is_known(tmp_path, kind):
    path = tmp_path / f"a{kind}"
    if kind == ".npz":
        np.savez(path, points=local(), viewpoint=[1.0, 2.0, 3.0])
    elif kind == ".pcd":
        write_pcd(path, named(XYZ, local(), "f4"), viewpoint="1 2 3 1 0 0 0")
    else:
        plain = write_ply(path, named(XYZ, local(), "f4")).read_bytes()
        path.write_bytes(plain.replace(b"element", b"comment viewpoint 1 2 3\nelement", 1))
    report = read_cloud_report(path)
    assert report.cloud.viewpoint.tolist() == [[1, 2, 3]]
    assert report.cloud.viewpoint_known.tolist() == [True]
    assert report.viewpoint_source == "the file"


def test_the_zero_counts_up_to_ten_diagonals_away(tmp_path):
    box = np.array([[0, 0, 0], [3, 4, 0]])  # diagonal 5
    near = write_ply(tmp_path / "near.ply", named(XYZ, box + np.array([0, 0, 50]), "f4"))
    far = write_ply(tmp_path / "far.ply", named(XYZ, box + np.array([0, 0, 50.01]), "f4"))
    assert read_cloud(near).viewpoint is not None
    report = read_cloud_report(far)
    assert report.cloud.viewpoint is None
    assert report.cloud.viewpoint_assumed.tolist() == [False]
    assert report.viewpoint_source == "none: the frame's origin is 50 m from points that span 5.0 m"
    mirrored = write_ply(tmp_path / "mirrored.ply", named(XYZ, -box - [0, 0, 50.01], "f4"))
    assert read_cloud(mirrored).viewpoint is None


def test_viewpoint_of_a_pcd_header(tmp_path):
    path = write_pcd(tmp_path / "a.pcd", named(XYZ, local(), "f4"), viewpoint="1 2 3 1 0 0 0")
    report = read_cloud_report(path)
    assert report.cloud.viewpoint.tolist() == [[1, 2, 3]]
    assert report.viewpoint_source == "the file"
    assert read_cloud(path, viewpoint="origin").viewpoint.tolist() == [[0, 0, 0]]
    assert read_cloud(path, viewpoint=None).viewpoint is None


@pytest.mark.parametrize("viewpoint", [tuple(UTM + 1), torch.from_numpy(UTM + 1), (UTM + 1).tolist()])
def test_given_viewpoints_are_in_the_frame_of_the_file(tmp_path, viewpoint):
    cloud = read_cloud(write_ply(tmp_path / "a.ply", named(XYZ, local() + UTM, "f8")), viewpoint=viewpoint)
    np.testing.assert_allclose((cloud.viewpoint.double() + cloud.origin).numpy()[0], UTM + 1, atol=1e-6)


def test_npz_positions_are_relative_to_its_origin(tmp_path):
    points = local().astype("f4")
    np.savez(tmp_path / "a.npz", points=points, origin=UTM, viewpoint=[1.0, 2.0, 3.0])
    cloud = read_cloud(tmp_path / "a.npz")
    np.testing.assert_array_equal(cloud.points.numpy(), points)
    assert cloud.origin.tolist() == [UTM.tolist()]
    assert cloud.viewpoint.tolist() == [[1, 2, 3]]
    np.savez(tmp_path / "b.npz", points=points, origin=[[0.0, 0.0, 5.0]])
    cloud = read_cloud(tmp_path / "b.npz")
    assert cloud.viewpoint.tolist() == [[0, 0, -5]]
    assert cloud.viewpoint_assumed.tolist() == [True]


def test_npz_with_large_points_gets_an_origin(tmp_path):
    np.savez(tmp_path / "a.npz", points=local() + UTM, origin=[1.0, 0.0, 0.0], viewpoint=UTM)
    cloud = read_cloud(tmp_path / "a.npz")
    shifted = UTM + np.array([1, 0, 0])
    assert np.abs((cloud.points.double() + cloud.origin).numpy() - local() - shifted).max() < 1e-6
    np.testing.assert_allclose((cloud.viewpoint.double() + cloud.origin).numpy()[0], shifted, atol=1e-6)
