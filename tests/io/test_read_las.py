"""LAS and LAZ: what laspy reads comes through, colors of 8 and 16 bits, units, and damaged files."""

import struct

import laspy
import numpy as np
import pytest
import torch
from laspy.vlrs.known import WktCoordinateSystemVlr
from real_formats import real_files

from torchreg.errors import CloudFileError
from torchreg.io import Reading, read_cloud, read_cloud_report
from torchreg.io.las import _units_of_wkt

BROKEN = ("pdal_simple-laszip-compressor-version-1.2r0.laz", "loaders._pdrf10-1.5.laz")


def made(path, points, colors=None, intensity=None, wkt=None, version="1.4"):
    header = laspy.LasHeader(point_format=2 if version == "1.2" else 7, version=version)
    header.scales, header.offsets = np.full(3, 0.001), np.floor(points.min(axis=0))
    if wkt is not None:
        header.vlrs.append(WktCoordinateSystemVlr(wkt))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    if colors is not None:
        las.red, las.green, las.blue = colors.T
    if intensity is not None:
        las.intensity = intensity
    las.write(path)
    return path


def local(count=50, seed=0):
    return np.random.default_rng(seed).integers(-5000, 5000, (count, 3)) / 1000


def report(path, **options):
    return read_cloud_report(path, reading=Reading(dtype=torch.float64, **options))


@pytest.mark.parametrize("suffix", [".las", ".laz", ".LAZ"])
@pytest.mark.parametrize("version", ["1.2", "1.4"])
@pytest.mark.parametrize("shift", [np.zeros(3), np.array([512345.0, 5234567.0, 431.0])])
def test_points_colors_and_intensity_come_through(tmp_path, suffix, version, shift):
    points, draw = local() + shift, np.random.default_rng(1)
    colors, intensity = draw.integers(0, 65536, (50, 3)), draw.integers(0, 65536, 50)
    colors[0] = 65535
    file = report(made(tmp_path / f"a{suffix}", points, colors, intensity, version=version))
    assert np.abs(file.cloud.points.numpy() + file.cloud.origin.numpy() - points).max() < 1e-9
    np.testing.assert_allclose(file.cloud.colors.numpy(), colors / 65535, rtol=0, atol=1e-15)
    assert file.intensity.tolist() == intensity.tolist()
    assert (file.points_in_file, file.color_depth, file.unit) == (50, "uint16", None)


def test_colors_of_8_bits_in_16_are_said(tmp_path):
    colors = np.random.default_rng(1).integers(0, 256, (50, 3))
    file = report(made(tmp_path / "a.las", local(), colors))
    np.testing.assert_allclose(file.cloud.colors.numpy(), colors / 255, rtol=0, atol=1e-15)
    assert file.color_depth == "uint8"
    assert "taken for 8-bit values" in file.notes[0]


def test_colors_and_intensity_of_zeros_are_none(tmp_path):
    file = report(made(tmp_path / "a.las", local()))
    assert not file.has_colors
    assert file.intensity is None


def projected(unit, size):
    return (
        'PROJCS["a",GEOGCS["b",DATUM["c",SPHEROID["d",6378137,298.2]],UNIT["degree",0.0174532925199433]],'
        f'PROJECTION["e"],UNIT["{unit}",{size}]]'
    )


@pytest.mark.parametrize(
    ("unit", "size", "name", "meters"),
    [
        ("metre", "1", "m", 1),
        ("foot", "0.3048", "ft", 0.3048),
        ("US survey foot", "0.304800609601219", "us-ft", 1200 / 3937),
    ],
)
def test_the_unit_of_the_coordinate_system_is_said_and_used_where_that_is_asked_for(tmp_path, unit, size, name, meters):
    points = local()
    path = made(tmp_path / "a.las", points, wkt=projected(unit, size))
    file = report(path)
    assert file.unit == name
    np.testing.assert_allclose(file.cloud.points.numpy(), points, rtol=0, atol=1e-9)
    assert any(f"its unit is {name}" in note for note in file.notes) == (name != "m")
    np.testing.assert_allclose(report(path, units="file").cloud.points.numpy(), points * meters, rtol=0, atol=1e-9)


def test_units_in_coordinate_systems_as_text():
    version_2 = (
        'COMPOUNDCRS["a",PROJCRS["b",BASEGEOGCRS["c",DATUM["d",ELLIPSOID["e",6378137,298.2,LENGTHUNIT["metre",1]]]],\n'
        'CONVERSION["f",PARAMETER["g",1,LENGTHUNIT["metre",1]]],CS[Cartesian,2],AXIS["E",east],'
        'LENGTHUNIT["US survey foot",0.304800609601219]],VERTCRS["h",CS[vertical,1],LENGTHUNIT["metre",1]]]'
    )
    assert _units_of_wkt(version_2) == ("us-ft", "m")
    both = f'COMPD_CS["a",{projected("metre", 1)},VERT_CS["b",UNIT["foot",0.3048]]]'
    assert _units_of_wkt(both) == ("m", "ft")
    assert _units_of_wkt('GEOGCS["a",UNIT["degree",0.017]]') == (None, None)


def test_heights_in_another_unit_are_said(tmp_path):
    both = f'COMPD_CS["a",{projected("metre", 1)},VERT_CS["b",UNIT["foot",0.3048]]]'
    file = report(made(tmp_path / "a.las", local(), wkt=both))
    assert file.notes[0] == "the file says that its heights are in ft and its other coordinates in m"


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_chunks_make_no_difference(tmp_path, monkeypatch, suffix):
    path = made(tmp_path / f"a{suffix}", local(2000), np.random.default_rng(1).integers(0, 65536, (2000, 3)))
    whole = report(path)
    monkeypatch.setattr("torchreg.io.las.CHUNK_ROWS", 64)
    assert torch.equal(report(path).cloud.points, whole.cloud.points)
    assert torch.equal(report(path).cloud.colors, whole.cloud.colors)
    assert len(report(path, voxel=1.0).cloud.points) < 1100


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("keep", [3, 100, 300, 0.5, 0.9])
def test_files_cut_short_are_refused(tmp_path, suffix, keep):
    path = made(tmp_path / f"a{suffix}", local(500))
    content = path.read_bytes()
    path.write_bytes(content[: keep if keep > 1 else int(len(content) * keep)])
    with pytest.raises(CloudFileError, match=rf"a\{suffix}: expected .*, got "):
        read_cloud(path)


@pytest.mark.parametrize(("place", "size"), [(100, 4), (243, 4), (235, 8)])
def test_records_that_the_file_has_no_room_for_are_refused_before_they_are_read(tmp_path, place, size):
    path = made(tmp_path / "a.las", local())
    content = bytearray(path.read_bytes())
    content[243:247] = b"\1\0\0\0"  # one extended record
    content[place : place + size] = b"\xff" * (size - 1) + b"\x7f"
    path.write_bytes(bytes(content))
    with pytest.raises(CloudFileError, match="records"):
        read_cloud(path)


def test_chunks_that_the_file_has_no_room_for_are_refused_before_they_are_read(tmp_path):
    path = made(tmp_path / "a.laz", local())
    content = bytearray(path.read_bytes())
    table = struct.unpack_from("<q", content, struct.unpack_from("<I", content, 96)[0])[0]
    content[table + 4 : table + 8] = b"\xff\xff\xff\x7f"
    path.write_bytes(bytes(content))
    with pytest.raises(CloudFileError, match="2147483647 chunks of compressed points"):
        read_cloud(path)


def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "laspy", None)
    (tmp_path / "a.las").write_bytes(b"LASF" + bytes(300))
    with pytest.raises(CloudFileError, match=r"expected the package laspy, .* \(pip install 'laspy\[lazrs\]'\)"):
        read_cloud(tmp_path / "a.las")


@pytest.mark.parametrize("path", real_files(".las", ".laz"))
def test_real_files(path):
    if path.name in BROKEN:
        with pytest.raises(CloudFileError, match=r"expected .*, got "):
            read_cloud(path)
        return
    expected, file = laspy.read(path), report(path)
    cloud = file.cloud
    assert file.points_in_file == len(expected.points) == len(cloud.points)
    np.testing.assert_allclose(cloud.points.numpy() + cloud.origin.numpy(), expected.xyz, rtol=0, atol=1e-9)
    if file.has_colors:
        assert 0 <= float(cloud.colors.min()) < float(cloud.colors.max()) <= 1
    colored = "red" in expected.point_format.dimension_names and bool(expected.red.any())
    assert file.has_colors == colored
