"""E57: what scanners and programs leave out or add, poses, several scans, and damaged files."""

import numpy as np
import pye57
import pytest
import torch
from made_e57 import scaled, write_e57
from real_formats import real_files

import torchreg as tr
from torchreg.errors import CloudFileError
from torchreg.io import Reading, read_cloud, read_cloud_report, read_scans

TURN = np.array([np.cos(0.4), 0, 0, np.sin(0.4)])  # by 0.8 radians about z
R = np.array([[np.cos(0.8), -np.sin(0.8), 0], [np.sin(0.8), np.cos(0.8), 0], [0, 0, 1]])
UTM = np.array([512345.25, 5234567.5, 431.125])
ERRORS = ("corrupt_crc", "bad-crc", "_empty", "ZeroPoints", "InvalidCVHeader", "PinholeImage")


def local(count=40, seed=0):
    return np.random.default_rng(seed).integers(-50000, 50000, (count, 3)) / 10000


def cartesian(points):
    return dict(zip(("cartesianX", "cartesianY", "cartesianZ"), points.T, strict=True))


def colors_of(values):
    return dict(zip(("colorRed", "colorGreen", "colorBlue"), np.asarray(values).T, strict=True))


def made(folder, **scan):
    return write_e57(folder / "a.e57", [scan])


def report(path, **options):
    return read_cloud_report(path, reading=Reading(dtype=torch.float64, **options))


def whole(cloud):
    return cloud.points.numpy() + cloud.origin.numpy()


def test_no_pose_no_invalid_state(tmp_path):
    file = report(made(tmp_path, fields=cartesian(local())))
    assert file.cloud.points.tolist() == local().tolist()
    assert (file.pose, file.scan, file.has_colors, file.has_normals, file.intensity) == (None, None, False, False, None)
    assert file.cloud.viewpoint_assumed.tolist() == [True]


def test_integers_with_a_scale_come_through(tmp_path):
    fields = {name: scaled(values) for name, values in cartesian(local()).items()}
    np.testing.assert_allclose(report(made(tmp_path, fields=fields)).cloud.points.numpy(), local(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("spherical", [False, True])
@pytest.mark.parametrize("translation", [None, UTM])
@pytest.mark.parametrize("rotation", [None, TURN, 3 * TURN])
def test_the_pose_is_applied_and_its_translation_is_the_scanner(tmp_path, rotation, translation, spherical):
    points = local()
    fields = cartesian(points)
    if spherical:
        far = np.linalg.norm(points, axis=1)
        angles = np.arctan2(points[:, 1], points[:, 0]), np.arcsin(points[:, 2] / far)
        fields = {"sphericalRange": far, "sphericalAzimuth": angles[0], "sphericalElevation": angles[1]}
    file = report(made(tmp_path, fields=fields, rotation=rotation, translation=translation, name="hall"))
    expected = points if rotation is None else points @ R.T
    shift = np.zeros(3) if translation is None else translation
    np.testing.assert_allclose(whole(file.cloud), expected + shift, rtol=0, atol=2e-9)
    assert file.scan == "hall"
    if translation is None and rotation is None:
        assert file.pose is None
    else:
        np.testing.assert_allclose(file.pose[:3, :3], np.eye(3) if rotation is None else R, rtol=0, atol=1e-12)
        assert file.pose[:3, 3].tolist() == shift.tolist()
    known = translation is not None or spherical
    assert file.cloud.viewpoint_known.tolist() == [known]
    if known:
        seat = (file.cloud.viewpoint + file.cloud.origin).numpy()[0]
        np.testing.assert_allclose(seat, shift, rtol=0, atol=1e-9)


def test_normals_turn_with_the_pose(tmp_path):
    normals = local(seed=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    fields = cartesian(local()) | dict(zip(("nor:normalX", "nor:normalY", "nor:normalZ"), normals.T, strict=True))
    file = report(made(tmp_path, fields=fields, rotation=TURN))
    np.testing.assert_allclose(file.cloud.normals.numpy(), normals @ R.T, rtol=0, atol=1e-12)


def test_fields_of_other_extensions_are_ignored(tmp_path):
    fields = cartesian(local()) | {"las:pointSourceId": np.arange(40), "rowIndex": np.arange(40)}
    assert len(read_cloud(made(tmp_path, fields=fields)).points) == 40


@pytest.mark.parametrize("whole_numbers", [True, False])
def test_points_marked_as_invalid_are_left_out_and_counted(tmp_path, whole_numbers):
    state = np.arange(40) % 3
    fields = cartesian(local()) | {"cartesianInvalidState": state if whole_numbers else state.astype(float)}
    file = report(made(tmp_path, fields=fields))
    assert file.cloud.points.tolist() == local()[state == 0].tolist()
    assert file.points_in_file == 40
    assert file.notes[0].startswith("26 rows are no points")


@pytest.mark.parametrize(
    ("largest", "maximum", "limits", "white", "depth"),
    [
        (255, 255, 255, 255, "uint8"),
        (200, 255, None, 255, "uint8"),
        (65535, 65535, 65535, 65535, "uint16"),
        (65535, 65535, None, 65535, "uint16"),
        (255, 65535, 255, 255, "uint8"),
        (255, 65535, None, 255, "uint8"),
        (255, 65535, 65535, 255, "uint8"),
        (65535, 65535, 255, 65535, "uint16"),
        (4095, 65535, 4095, 4095, "0 to 4095"),
    ],
)
def test_colors_of_any_depth(tmp_path, largest, maximum, limits, white, depth):
    values = np.random.default_rng(2).integers(0, largest + 1, (40, 3))
    values[0] = largest
    path = made(tmp_path, fields=cartesian(local()) | colors_of(values), limits=limits, maximum=maximum)
    file = report(path)
    np.testing.assert_allclose(file.cloud.colors.numpy(), values / white, rtol=0, atol=1e-12)
    assert file.color_depth == depth


def test_intensity_is_kept_in_its_own_scale(tmp_path):
    for values in (np.arange(40) - 20, np.linspace(-2, 3, 40), scaled(np.arange(40) / 10)):
        file = report(made(tmp_path, fields=cartesian(local()) | {"intensity": values}))
        np.testing.assert_allclose(file.intensity.numpy(), values, rtol=0, atol=1e-9)
        assert report(tmp_path / "a.e57", intensity=True).has_colors


@pytest.fixture
def project(tmp_path):
    """Scans of one file with different fields; the third has no points."""
    colors = np.random.default_rng(2).integers(0, 256, (40, 3))
    return write_e57(
        tmp_path / "project.e57",
        [
            {"fields": cartesian(local()), "name": "hall", "translation": UTM},
            {"fields": cartesian(local(30, 1)) | colors_of(colors[:30]), "name": "yard", "rotation": TURN},
            {"fields": cartesian(local(0)), "name": "empty"},
            {"fields": cartesian(local(20, 2)) | {"intensity": np.arange(20.0)}, "name": "yard"},
        ],
    )


def test_every_scan_of_a_file_has_its_own_fields_pose_and_name(project):
    scans = tr.read_scans(project, dtype=torch.float64)
    assert [scan.scan for scan in scans] == ["hall", "yard", "yard"]
    assert [len(scan.cloud.points) for scan in scans] == [40, 30, 20]
    assert [scan.has_colors for scan in scans] == [False, True, False]
    assert [scan.intensity is not None for scan in scans] == [False, False, True]
    assert [scan.pose is not None for scan in scans] == [True, True, False]
    assert [scan.cloud.viewpoint_known.item() for scan in scans] == [True, False, False]
    assert all("no points: scans 2 of 4" in scan.notes[-1] for scan in scans)
    np.testing.assert_allclose(whole(scans[0].cloud), local() + UTM, rtol=0, atol=1e-9)


def test_one_scan_is_chosen_by_number_or_name(project):
    assert len(read_cloud(project, scan=1).points) == 30
    assert len(read_cloud(project, scan="hall").points) == 40
    assert len(read_cloud(project, scan="3").points) == 20
    listed = r"a file of 4 scans \(0 'hall', 1 'yard', 2 'empty', 3 'yard'\)"
    for scan, words in (
        (None, "one scan, or scan="),
        (4, "a scan 4"),
        ("cellar", "a scan 'cellar'"),
        ("yard", "one scan of"),
    ):
        with pytest.raises(CloudFileError, match=rf"expected {words}.*{listed}"):
            read_cloud(project, scan=scan)
    with pytest.raises(CloudFileError, match="at least one finite point"):
        read_cloud(project, scan=2)


def test_chunks_make_no_difference(tmp_path, monkeypatch):
    path = made(tmp_path, fields=cartesian(local(3000)), rotation=TURN, translation=UTM)
    once = report(path)
    monkeypatch.setattr("torchreg.io.e57.CHUNK_ROWS", 97)
    assert torch.equal(report(path).cloud.points, once.cloud.points)
    seen = []
    thinned = read_cloud_report(path, reading=Reading(voxel=1.0), progress=lambda *rows: seen.append(rows))
    assert 300 < len(thinned.cloud.points) < 1500
    assert seen[0] == (97, 3000)
    assert seen[-1] == (3000, 3000)
    few = report(path, at_most=100).cloud
    assert 10 < len(few.points) <= 100


@pytest.mark.parametrize("keep", [10, 48, 1000, 1024, 2048, 0.5, 0.99])
def test_files_cut_short_are_refused(tmp_path, keep):
    path = made(tmp_path, fields=cartesian(local(500)))
    content = path.read_bytes()
    path.write_bytes(content[: keep if keep > 1 else int(len(content) * keep)])
    with pytest.raises(CloudFileError, match=r"a\.e57: expected .*, got "):
        read_cloud(path)


@pytest.mark.parametrize("place", [0, 24, 48, 100, 2000, -900])
def test_a_changed_byte_is_found(tmp_path, place):
    path = made(tmp_path, fields=cartesian(local(500)))
    content = bytearray(path.read_bytes())
    content[place] ^= 0xFF
    path.write_bytes(bytes(content))
    with pytest.raises(CloudFileError, match=r"a\.e57: expected .*, got "):
        read_cloud(path)


def test_scans_without_coordinates_and_files_without_scans_are_refused(tmp_path):
    with pytest.raises(CloudFileError, match="expected Cartesian or spherical coordinates in scan 0, got cartesianX"):
        read_cloud(made(tmp_path, fields={"cartesianX": np.arange(3.0)}))
    with pytest.raises(CloudFileError, match="expected at least one scan, got none"):
        read_cloud(write_e57(tmp_path / "b.e57", []))
    with pytest.raises(CloudFileError, match="expected a scan with points, got none among 1"):
        read_scans(made(tmp_path, fields=cartesian(local(0))))


def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch):
    path = made(tmp_path, fields=cartesian(local()))
    monkeypatch.setitem(__import__("sys").modules, "pye57", None)
    with pytest.raises(CloudFileError, match=r"expected the package pye57, .* \(pip install pye57\)"):
        read_cloud(path)


@pytest.mark.parametrize("path", real_files(".e57"))
def test_real_files(path):
    if any(word in path.name for word in ERRORS):
        with pytest.raises(CloudFileError, match=r"expected .*, got "):
            read_scans(path)
        return
    with pye57.E57(str(path)) as file:
        for number, scan in enumerate(read_scans(path, dtype=torch.float64)):
            names = file.get_header(number).point_fields
            supported = not any(":" in name or name == "classification" for name in names)
            expected = file.read_scan(number, ignore_missing_fields=True) if supported else None
            assert scan.points_in_file == file.get_header(number).point_count
            if scan.has_colors:
                assert 0 <= float(scan.cloud.colors.min()) <= float(scan.cloud.colors.max()) <= 1
            if expected is not None:
                points = np.stack([expected[name] for name in ("cartesianX", "cartesianY", "cartesianZ")], axis=1)
                np.testing.assert_allclose(whole(scan.cloud), points, rtol=0, atol=1e-9)
