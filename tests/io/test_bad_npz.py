"""Zip files that lie, unpack into gigabytes, or hold damaged headers are refused before memory is taken."""

import io
import pickle
import tracemalloc
import zipfile

import numpy as np
import pytest

from torchreg.errors import CloudFileError
from torchreg.io import read_cloud, read_cloud_report

POINTS = np.arange(30.0).reshape(10, 3)


def refused(path):
    """The message with which a file is refused, in less than 64 MiB."""
    tracemalloc.start()
    try:
        with pytest.raises(CloudFileError) as caught:
            read_cloud(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 26
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert message.startswith(f"{path}: expected ")
    return message


def member(shape, body, descr="<f8"):
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue() + body


def archive(path, content, packing=zipfile.ZIP_STORED, name="points.npy"):
    with zipfile.ZipFile(path, "w", packing) as file:
        file.writestr(name, content)
    return path


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was loaded",))


def test_npz_never_unpickles(tmp_path):
    objects = np.empty((1, 3), dtype=object)
    objects[:] = Bomb()
    np.savez(tmp_path / "a.npz", points=objects)
    assert "points of real numbers, got object" in refused(tmp_path / "a.npz")
    refused(archive(tmp_path / "b.npz", pickle.dumps(Bomb())))


@pytest.mark.parametrize("shape", [(10**12, 3), (11, 3), (9, 3)])
def test_npz_headers_that_lie(tmp_path, shape):
    assert "as its header declares" in refused(archive(tmp_path / "a.npz", member(shape, POINTS.tobytes())))


@pytest.mark.parametrize("rows", [10**12, 10**6])
def test_a_size_that_header_and_directory_claim_alike(tmp_path, rows):
    content = member((rows, 3), POINTS.tobytes())
    path = archive(tmp_path / "a.npz", content)
    claimed = min(len(content) - POINTS.nbytes + 24 * rows, 2**32 - 2)
    lie = path.read_bytes().replace(len(content).to_bytes(4, "little"), claimed.to_bytes(4, "little"))
    assert lie.count(claimed.to_bytes(4, "little")) == 4  # packed and unpacked, in both places
    path.write_bytes(lie)
    refused(path)


def test_points_that_unpack_into_gigabytes(tmp_path):
    path = tmp_path / "a.npz"
    rows = 40_000_000
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file, file.open("points.npy", "w") as inner:
        inner.write(member((rows, 3), b"", "<i1"))
        for _ in range(rows // 1_000_000):
            inner.write(bytes(3_000_000))
    assert path.stat().st_size < 1_000_000
    assert "points packed at most 100 times, got 120000000 bytes packed into" in refused(path)


def test_colors_of_another_shape_are_not_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("points.npy", member((10, 3), POINTS.tobytes()))
        file.writestr("colors.npy", member((10**8, 3), b"", "<i1") + bytes(1000))
    assert "colors" in refused(tmp_path / "a.npz")


def test_dense_points_are_points(tmp_path):
    points = np.zeros((1 << 20, 3), "f4")
    points[:, 0] = np.arange(1 << 20) % 7
    np.savez_compressed(tmp_path / "a.npz", points=points)
    assert len(read_cloud(tmp_path / "a.npz").points) == 1 << 20


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_packings_that_numpy_does_not_write(tmp_path, packing):
    assert "points stored or deflated" in refused(
        archive(tmp_path / "a.npz", member((10, 3), POINTS.tobytes()), packing)
    )


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (10, 3",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (10, 3)}}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (10, '3')}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-10, -3)}",
        "{'descr': '(2, 3)f8', 'fortran_order': False, 'shape': (10, 3)}",
        "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (10, 3)}",
        "{'descr': '<f8', 'shape': (10, 3)}",
        "{'descr': '\\d', 'fortran_order': False, 'shape': (10, 3)}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (10L, 3L)} \0",
        "(" * 1500,
        "-" * 1500,
        "'''",
        "",
    ],
)
def test_headers_of_arrays(tmp_path, header):
    text = header.encode() + b"\n"
    content = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + POINTS.tobytes()
    refused(archive(tmp_path / "a.npz", content))


@pytest.mark.parametrize("version", [b"\x02\x00", b"\x03\x00", b"\x09\x09"])
def test_a_header_of_gigabytes(tmp_path, version):
    content = b"\x93NUMPY" + version + (2**31).to_bytes(4, "little") + b" " * 10_000_000
    refused(archive(tmp_path / "a.npz", content, zipfile.ZIP_DEFLATED))


@pytest.mark.parametrize("flags", [1, 0x20, 0x40])
def test_members_that_are_encrypted_or_patches(tmp_path, flags):
    path = archive(tmp_path / "a.npz", member((10, 3), POINTS.tobytes()))
    content = path.read_bytes()
    for mark, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = content.index(mark) + place
        content = content[:at] + flags.to_bytes(2, "little") + content[at + 2 :]
    path.write_bytes(content)
    refused(path)


def test_long_doubles_and_far_origins(tmp_path):
    wide = np.full((2, 3), 1, np.longdouble)
    wide[0] = np.longdouble("1e4000")
    np.savez(tmp_path / "a.npz", points=wide, colors=np.where(wide > 1, wide, 0.5), normals=wide)
    report = read_cloud_report(tmp_path / "a.npz")
    assert (report.points_in_file, report.dropped_non_finite) == (2, 1)
    np.savez(tmp_path / "a.npz", points=POINTS, origin=[0, 1e300, 0])
    assert "a finite origin, up to 1e+12 m" in refused(tmp_path / "a.npz")
